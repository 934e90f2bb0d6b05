"""``feasigrasp run``, ``scenarios``, ``objects`` and ``perceive``, as somebody types them."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.commands import run
from feasigrasp.errors import ScenarioError
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.resources import diagram_path
from feasigrasp.runs.results.arguments import output
from feasigrasp.scenario.files import dump_scenario, load_scenario, scenario_names

FILE = diagram_path("dynamic.scenarios.yaml")


@pytest.fixture
def own_file(tmp_path):
    """A file with one scenario: the shared parts of the packaged ones, and what uses them."""
    file = tmp_path / "own.scenarios.yaml"
    shared = FILE.read_text().split("\nReachCircular:")[0]
    file.write_text(f"{shared}\nMine:\n  <<: *reach\n  random_seed: 7\n")
    return file


def asked(*argv):
    parser = cli.command_parser("feasigrasp run", "test")
    run.add_arguments(parser)
    return run.load(parser.parse_args(argv))


# ------------------------------------------------------------------------------------------ run


def test_options_change_the_scenario():
    name, scenario = asked(
        *("--seed", "5", "ReachLinearMocap", "--object", "mug", "--controller", "joint"),
        *("--mode", "corrected", "--duration", "0.5", "--scenario-text", "{random_seed: 4}"),
    )
    assert name == "ReachLinearMocap" and scenario.random_seed == 5
    assert (scenario.object.model, scenario.simulation_duration) == ("mug", 0.5)
    assert (scenario.control.controller, scenario.control.mode) == ("joint", "corrected")
    assert scenario.motion.amplitude == [0.0, 0.18, 0.0]


def test_without_options_a_scenario_is_as_it_is_written():
    name, scenario = asked("PaperLinear")
    assert name == "PaperLinear"
    assert dump_scenario(scenario) == dump_scenario(load_scenario(FILE, name))
    assert asked()[0] == run.DEFAULT_SCENARIO


def test_a_file_with_one_scenario_needs_no_name(own_file):
    name, scenario = asked("--scenario-file", str(own_file))
    assert name == "Mine" and scenario.random_seed == 7


def test_a_file_with_several_asks_for_one(own_file):
    with pytest.raises(ScenarioError, match=r"\d+ scenarios: ReachCircular, .*; name one"):
        asked("--scenario-file", str(FILE))
    own_file.write_text("{}")
    with pytest.raises(ScenarioError, match="has no scenario"):
        asked("--scenario-file", str(own_file))


def test_a_reader_that_goes_away_loses_nothing(tmp_path):
    """As with ``| head -1``: no traceback, and the record is written."""
    command = [sys.executable, "-m", "feasigrasp.cli", "run", "ReachLinearMocap"]
    command += ["--duration", "0.1", "--object", "soup_can", "--results", "r.json"]
    environment = os.environ | {"PYTHONPATH": str(FILE.parents[1])}
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, stdout=writing, stderr=subprocess.PIPE, text=True
    )
    os.close(writing)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr and "BrokenPipe" not in done.stderr
    assert json.loads((tmp_path / "r.json").read_text())["scenario"] == "ReachLinearMocap"


def test_it_runs_in_an_empty_folder(tmp_path, monkeypatch, capfd):
    """No terminal: the verdict comes first, and there is no line to write over."""
    monkeypatch.chdir(tmp_path)
    options = ("--duration", "0.1", "--object", "soup_can", "--results", "out/r.json")
    options += ("--log", "out/log.npz")
    assert cli.main(["run", "ReachLinearMocap", *options]) == 0
    said = capfd.readouterr().out
    lines = said.splitlines()
    assert lines[0].startswith("not held: no")
    assert lines[-2:] == ["wrote out/r.json", "wrote out/log.npz"]
    assert "\r" not in said and "\x1b" not in said
    record = json.loads((tmp_path / "out" / "r.json").read_text())
    assert record["scenario"] == "ReachLinearMocap" and record["object"] == "soup_can"
    with np.load("out/log.npz") as log:  # without pickle, which it refuses by default
        assert {name: log[name].shape for name in ("time", "q", "X_WO")} == {
            "time": (21,),
            "q": (21, 7),
            "X_WO": (21, 4, 4),
        }
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_on_a_terminal_it_says_how_far_it_is(own_file, monkeypatch):
    ours, theirs = pty.openpty()
    with open(theirs, "w") as terminal:
        monkeypatch.setattr(sys, "stdout", terminal)
        assert cli.main(["run", "--scenario-file", str(own_file), "--duration", "0.1"]) == 0
    said = os.read(ours, 1 << 16).decode()
    os.close(ours)
    before, _, after = said.partition("not held")
    assert "\rsimulating" in before and "x real time" in before
    assert before.endswith("\r\x1b[K") and "Mine, task space" in after


# -------------------------------------------------------------------------------- what there is


def test_scenarios_are_listed_with_what_they_are(capsys):
    assert cli.main(["scenarios"]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == scenario_names(FILE)
    assert last == f"from {FILE}"
    said = dict(line.split(maxsplit=1) for line in lines)
    # amplitude times rate of the straight motion: 0.18 m * 0.628 rad/s
    assert said["ReachLinearMocap"] == "mustard_bottle at up to 11 cm/s, grasped and lifted; 30 s"
    assert "duck" in said["PaperLinear"] and "open gripper" in said["PaperLinear"]


def test_scenarios_of_a_file_are_listed(own_file, capsys):
    assert cli.main(["scenarios", "--scenario-file", str(own_file)]) == 0
    assert capsys.readouterr().out.startswith("Mine  mustard_bottle at ")
    assert cli.main(["scenarios", "--scenario-file", "nowhere.yaml"]) == 2
    assert "no scenario file nowhere.yaml" in capsys.readouterr().err


def test_objects_are_listed_with_size_and_mass(capsys):
    assert cli.main(["objects"]) == 0
    _, *lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == builtin_objects()
    for line in lines:
        name, *rest = line.replace(" x ", " ").split()
        mesh = load_object(name).mesh
        sides = 100.0 * np.ptp(mesh.vertices, axis=0)
        np.testing.assert_allclose([float(side) for side in rest[:3]], sides, atol=0.051)
        assert float(rest[3]) == pytest.approx(1000.0 * load_object(name).mass, abs=0.5)


# ----------------------------------------------------------------------------------- perceive


@pytest.mark.parametrize(
    ("argv", "status", "says"),
    [
        (["--cloud", "nowhere.ply"], 2, "error: "),
        (["--cloud", "nowhere.ply", "--picture", "/proc/a/b.png"], 2, "--picture: nothing can be"),
    ],
)
def test_perceive_refuses_what_is_not_there(argv, status, says, capsys):
    assert cli.main(["perceive", *argv]) == status
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        ("perceive --sample --voxel 0", "--voxel: 0: give a finite number above zero"),
        ("perceive --sample --mass inf", "--mass: inf: give a finite number above zero"),
        ("perceive --sample --label 0", "--label: 0 is less than 1"),
        (
            "perceive --sample --sampler foo",
            "--sampler: invalid choice: 'foo' (choose from 'network', 'antipodal'",
        ),
        ("perceive --sample --grasps g.txt", "--grasps: g.txt: end it in .json or .npz or .npy"),
        ("perceive --sample --grasps g", "--grasps: g: end it in .json"),
        ("perceive --sample --picture x.txt", "--picture: x.txt: end it in .eps"),
        ("perceive --sample --picture .", "--picture: '.' names no file"),
        ("perceive --sample --html x.txt", "--html: x.txt: end it in .html"),
        ("track --folder a --poses=", "--poses: '' names no file"),
        ("track --folder a --poses /", "--poses: '/' names no file"),
        ("track --folder a --shape s.pcd", "--shape: s.pcd: end it in .ply"),
        ("track --folder=", "--folder: '' names no file or folder"),
        ("record --out=", "--out: '' names no file or folder"),
        ("run --replay r.gif", "--replay: r.gif: end it in .html"),
        ("run --results r.csv", "--results: r.csv: end it in .json"),
        ("run --log l.npy", "--log: l.npy: end it in .npz"),
        ("sim --results r.csv", "--results: r.csv: end it in .json"),
        ("feasible --grasps g.npz --verdicts v.csv", "--verdicts: v.csv: end it in .json"),
    ],
)
def test_what_no_option_can_be_is_refused_before_any_work(argv, says, capsys):
    with pytest.raises(SystemExit):
        cli.main(argv.split())
    assert f": error: argument {says}" in capsys.readouterr().err


def test_an_output_without_a_suffix_is_of_the_only_format():
    assert output(".html", "")("/dev/stdout") == Path("/dev/stdout")
    assert output(".html", "")("A.HTML") == Path("A.HTML")
