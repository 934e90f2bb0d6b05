"""Paths of a scenario start at its file, wherever it is run from; what was valid stays so."""

from pathlib import Path

import pytest
import trimesh

from feasigrasp.errors import FeasigraspError
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.runs.results.provenance import own_files
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.systems.station.directives import cell_directives

TEXT = """
Own:
  directives:
  - add_directives: {file: package://feasigrasp/iiwa/cell.dmd.yaml}
  - add_model: {name: lamp, file: models/lamp.urdf}
  - add_directives: {file: more.dmd.yaml}
  cameras: {wrist_camera: {depth: true}}
  gripper: hand.yaml
  object: {model: models/mine.obj}
  distractor: {model: models/mine.obj}
  cell: {meshes: {bin: {file: models/mine.obj, position: [1.0, 0.0, 0.0]}}}
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A scenario in a folder of its own; the working directory is another one."""
    folder, elsewhere = tmp_path / "own", tmp_path / "elsewhere"
    (folder / "models").mkdir(parents=True)
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    (folder / "own.yaml").write_text(TEXT)
    (folder / "hand.yaml").write_text("max_opening: 0.1")
    (folder / "more.dmd.yaml").write_text("directives: []")
    (folder / "models" / "lamp.urdf").write_text('<robot name="lamp"><link name="lamp"/></robot>')
    trimesh.creation.box((0.05, 0.05, 0.1)).export(folder / "models" / "mine.obj")
    return folder / "own.yaml"


def paths(scenario):
    directives = [d.add_model or d.add_directives for d in scenario.directives]
    bodies = (scenario.object.model, scenario.distractor.model, scenario.cell.meshes["bin"].file)
    return [*(d.file for d in directives), scenario.gripper, *bodies]


def test_all_paths_start_at_the_file(file):
    scenario, mine = load_scenario(file, "Own"), str(file.parent / "models/mine.obj")
    assert paths(scenario) == [
        "package://feasigrasp/iiwa/cell.dmd.yaml",
        f"file://{file.parent}/models/lamp.urdf",
        f"file://{file.parent}/more.dmd.yaml",
        str(file.parent / "hand.yaml"),
        *[mine] * 3,
    ]
    # A record's scenario can be read from anywhere, and says which files it was.
    assert paths(parse_scenario(dump_scenario(scenario))) == paths(scenario)
    given = {"object", "distractor", "gripper", "cell.meshes.bin"}
    assert given | {"directives[1]", "directives[2]"} == set(own_files(scenario))
    assert [d.add_model.name for d in cell_directives(scenario) if d.add_model][-1] == "bin"


def test_what_is_put_on_top_starts_at_the_working_directory(file, tmp_path):
    trimesh.creation.box((0.02, 0.02, 0.02)).export("other.obj")
    text = "{object: {model: other.obj}, cell: {meshes: {bin: {file: other.obj}}}}"
    scenario = load_scenario(file, "Own", text)
    assert scenario.cell.meshes["bin"].file == str(tmp_path / "elsewhere/other.obj")
    assert scenario.object.model == str(tmp_path / "elsewhere/other.obj")
    assert scenario.gripper == str(file.parent / "hand.yaml")


@pytest.mark.parametrize("key", ["object: {model: %s}", "distractor: {model: %s}", "gripper: %s"])
@pytest.mark.parametrize("name", ["other.obj", "models/other.obj"])
def test_a_file_that_the_folder_lacks_is_not_that_of_the_working_directory(file, key, name):
    Path("models").mkdir()
    trimesh.creation.box((0.02, 0.02, 0.02)).export(name)
    file.write_text(f"Own: {{based_on: ReachLinear, {key % name}}}")
    with pytest.raises(FeasigraspError, match=f"{file.parent}/{name}.*no (such )?file"):
        scenario = load_scenario(file)
        load_scenario_object(scenario)
        load_object(scenario.distractor.model)


def test_a_name_stays_a_name(file):
    for model in ("mug", "things"):
        assert load_scenario(file, "Own", f"{{object: {{model: {model}}}}}").object.model == model


def test_an_unknown_material_of_a_catalogue_is_named(file):
    listed = '{"objects": [{"name": "a", "mesh": "models/mine.obj", "material": "gold"}]}'
    (file.parent / "objects.json").write_text(listed)
    scenario = load_scenario("ReachLinear", f"{{object: {{model: {file.parent}/a}}}}")
    with pytest.raises(FeasigraspError, match="own/a .objects.json. is 'gold'; choose one of matt"):
        load_scenario_object(scenario)
