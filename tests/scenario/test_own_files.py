"""What a run depends on beside the package: the user's files."""

import hashlib

import pytest
import trimesh

from feasigrasp.runs.results.provenance import own_files
from feasigrasp.scenario.cell import DistractorConfig
from feasigrasp.scenario.parts import PartConfig
from feasigrasp.scenario.schema import ObjectConfig, Scenario


@pytest.fixture
def scenario(tmp_path, monkeypatch):
    """One with a mesh, a hand and a sampler of one's own, in the folder of the command."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    trimesh.creation.box((0.05, 0.05, 0.1)).export("mine.obj")
    (tmp_path / "hand.yaml").write_text("max_opening: 0.1")
    (tmp_path / "my_files_part.py").write_text("class Few: ...")
    return Scenario(
        object=ObjectConfig(model="mine.obj"),
        gripper="hand.yaml",
        parts={"sampler": PartConfig("my_files_part:Few")},
    )


def test_every_file_of_ones_own_is_known_by_what_it_holds(scenario, tmp_path):
    names = {"object": "mine.obj", "gripper": "hand.yaml", "parts.sampler": "my_files_part.py"}
    assert own_files(scenario) == {
        key: hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
        for key, name in names.items()
    }
    for key, name in names.items():
        before = own_files(scenario)
        file = tmp_path / name
        file.write_text(file.read_text() + "# changed\n")
        after = own_files(scenario)
        assert {k for k in before if before[k] != after[k]} == {key}


def test_the_file_of_an_arm_and_a_distractor_are_the_users(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.05, 0.05, 0.1)).export("other.obj")
    (tmp_path / "own.arm").write_text("")
    scenario = Scenario(distractor=DistractorConfig("other.obj"))
    scenario.arm = "own.arm"
    assert set(own_files(scenario)) == {"arm", "distractor"}


def test_an_object_of_a_folders_catalogue_is_its_mesh(scenario, tmp_path):
    (tmp_path / "things").mkdir()
    (tmp_path / "mine.obj").rename(tmp_path / "things" / "m.obj")
    listed = '{"objects": [{"name": "thing", "mesh": "m.obj"}]}'
    (tmp_path / "things" / "catalogue.json").write_text(listed)
    content = (tmp_path / "things" / "m.obj").read_bytes()
    scenario.object.model = "things/thing"
    assert own_files(scenario)["object"] == hashlib.sha256(content).hexdigest()


def test_what_the_package_brings_is_not_the_users():
    assert own_files(Scenario()) == {}


def test_what_is_not_there_is_left_to_the_run_to_complain_of():
    missing = {"tracker": PartConfig("no_such_module_at_all:Own")}
    scenario = Scenario(object=ObjectConfig(model="teapot"), gripper="none.yaml", parts=missing)
    assert own_files(scenario) == {}
