"""What the README shows does run."""

import re

import pytest
import yaml

from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion


@pytest.fixture(scope="module")
def readme(repository):
    return (repository / "README.md").read_text()


def block(text, language):
    found = re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
    assert len(found) == 1, f"README has {len(found)} {language} blocks, one expected"
    return found[0]


def test_diagram_example_finds_grasps_from_any_folder(readme, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(block(readme, "python"), "README.md", "exec"), names)
    assert len(names["grasps"]) > 0
    assert "grasps; dropped" in capsys.readouterr().out


def test_scenario_example_is_valid(readme, tmp_path):
    file = tmp_path / "own.scenarios.yaml"
    file.write_text(block(readme, "yaml"))
    (name,) = yaml.load(file.read_text(), Loader=yaml.BaseLoader)
    scenario = load_scenario(file, name)
    assert make_motion(scenario).pose(0.0)[:3, 3] == pytest.approx([0.5, 0.0, 0.55])
    assert scenario.object.model == "mug"


def test_files_that_the_readme_links_to_exist(readme, repository):
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", readme)
    assert links
    missing = [link for link in links if not (repository / link).exists()]
    assert not missing
