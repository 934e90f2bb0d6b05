"""Every example runs, draws something, and stands in the documentation as it is."""

import runpy
import sys
from pathlib import Path

import matplotlib.image
import matplotlib.pyplot as plt
import pytest

from tools.make_docs import api_page, examples_page, faces

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


def test_there_are_nine_short_ones():
    lines = {script.name: len(script.read_text().splitlines()) for script in EXAMPLES}
    assert len(lines) == 9
    assert all(20 <= count <= 65 for count in lines.values()), lines


def test_the_examples_page_shows_them():
    page = REPOSITORY / "docs" / "examples.md"
    assert page.read_text() == examples_page(), "stale: run python tools/make_docs.py"
    for script in EXAMPLES:
        assert (page.parent / "images" / "examples" / f"{script.stem}.png").is_file()


def test_the_page_of_public_names_is_that_of_the_code():
    page = (REPOSITORY / "docs" / "api.md").read_text()
    assert page == api_page(), "stale: run python tools/make_docs.py"
    assert len(faces()) >= 10
