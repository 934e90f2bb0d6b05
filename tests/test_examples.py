"""Every example runs, draws something, and is named in the documentation."""

import runpy
import sys
from pathlib import Path

import matplotlib.image
import matplotlib.pyplot as plt
import pytest

REPOSITORY = Path(__file__).parents[1]
EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_runs_and_draws(script, tmp_path, monkeypatch, capsys):
    """In a folder of its own, but in this process: to import takes longer than most of them do."""
    picture = tmp_path / "pictures" / "example.png"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script), str(picture)])
    runpy.run_path(str(script), run_name="__main__")
    plt.close("all")
    assert capsys.readouterr().out.count("\n") >= 2
    pixels = matplotlib.image.imread(picture)
    assert pixels[..., :3].std() > 0.03  # not an empty page


def test_there_are_ten_short_ones():
    lines = {script.name: len(script.read_text().splitlines()) for script in EXAMPLES}
    assert len(lines) == 10
    assert all(20 <= count <= 65 for count in lines.values()), lines
    page = (REPOSITORY / "docs" / "own_parts.md").read_text()
    assert not [name for name in lines if f"`{name}`" not in page]
