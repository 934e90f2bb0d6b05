"""``feasigrasp evaluate dynamic``: what it sums up, and that it goes on where it was."""

import csv
import json

import pytest

from feasigrasp import cli
from feasigrasp.resources import model_path
from feasigrasp.runs import run as run_module
from feasigrasp_lab.results import finished, rows, workers
from feasigrasp_lab.runs import isolated, run_plan

#: Where the revision is asked for.
REVISION = (run_plan, finished, rows, run_module, workers)


@pytest.fixture
def fake_runs(monkeypatch, fake_simulation):
    """Even seeds hold. A commit while the tests run must not change what they see."""
    for module in REVISION:
        monkeypatch.setattr(module, "git_revision", lambda: "57f3f21b0c4e")
    return fake_simulation(lambda scenario, name: scenario.random_seed % 2 == 0, wall_s=1.0)


def evaluate(out, *arguments):
    arguments = ("--jobs", "1", "--objects", "mug,ball", *arguments)
    return cli.main(["evaluate", "dynamic", "--out", str(out), *arguments])


def rows_of(out):
    summary = json.loads((out / "summary.json").read_text())
    return {(row["preset"], row["name"]): row for row in summary["rows"]}


def test_it_runs_every_combination_and_sums_up(fake_runs, tmp_path):
    scenarios = ("--scenarios", "ReachLinearMocap,PaperLinear", "--mode", "safe", "--seeds", "3")
    assert evaluate(tmp_path, *scenarios) == 0
    assert len(set(fake_runs)) == len(fake_runs) == 2 * 2 * 2 * 3
    assert "PaperLinear-ball-joint-safe-2" in fake_runs

    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {"command", "git", "seed", "versions", "machine", "rows"} <= set(summary)
    assert "--objects mug,ball" in summary["command"]
    row = rows_of(tmp_path)["all/all/safe", "dynamic.held_percent"]
    assert set(row) == {"name", "preset", "value", "low", "high", "unit", "n", "tuned"}
    assert row["tuned"] is True  # constants were chosen on built-in objects
    assert row["value"] == pytest.approx(200.0 / 3.0) and row["n"] == 24

    with (tmp_path / "runs.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 24
    assert {line["object"] for line in lines} == {"mug", "ball"}
    assert {line["grasp_held"] for line in lines} == {"True", "False"}


def test_the_seed_option_shifts_the_repeats(fake_runs, tmp_path):
    evaluate(tmp_path, "--scenarios", "ReachLinearMocap", "--controllers", "task", "--seed", "10")
    assert sorted(fake_runs) == [
        f"ReachLinearMocap-{o}-task-safe-{k}" for o in ("ball", "mug") for k in (10, 11, 12)
    ]


def test_quick_is_one_object_and_one_seed(fake_runs, tmp_path):
    evaluate(tmp_path, "--quick", "--study", "reach")
    assert len(fake_runs) == 3 * 2
    assert all("-mug-" in name and name.endswith("-0") for name in fake_runs)
    assert json.loads((tmp_path / "summary.json").read_text())["quick"] is True


def test_a_mesh_that_cannot_be_used_is_left_out_with_the_reason(fake_runs, tmp_path, capsys):
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "good.obj").write_bytes(model_path("objects", "ball.obj").read_bytes())
    (meshes / "open.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n")
    out, scenario = tmp_path / "out", ("--scenarios", "ReachLinearMocap", "--seeds", "1")
    assert evaluate(out, "--objects", str(meshes), *scenario) == 0
    assert {name.split("-")[1] for name in fake_runs} == {"good"}
    found = json.loads((out / "summary.json").read_text())["conditions"]
    assert found["objects"] == ["good"] and list(found["left_out"]) == ["open"]
    assert f"left out: open ({found['left_out']['open']})" in capsys.readouterr().out
    # Asked for by name, it is an error.
    assert evaluate(out, "--objects", str(meshes / "open.obj"), *scenario) == 2


def test_a_controller_of_ones_own_runs_once_and_under_its_name(fake_runs, tmp_path, monkeypatch):
    """Whatever ``--controllers`` says: it replaces every one of them."""
    (tmp_path / "my_driver.py").write_text("class Mine: ...")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    text = "{parts: {controller: {name: 'my_driver:Mine'}}}"
    scenario = ("--scenarios", "ReachLinearMocap", "--seeds", "1", "--scenario-text", text)
    assert evaluate(tmp_path / "out", *scenario, "--controllers", "task,joint") == 0
    assert sorted(fake_runs) == [
        f"ReachLinearMocap-{o}-my_driver.Mine-safe-0" for o in ("ball", "mug")
    ]
    presets = {preset for preset, _ in rows_of(tmp_path / "out")}
    assert "all/my_driver:Mine/safe" in presets and "all/task/safe" not in presets


def test_conditions_are_printed_and_stored(fake_runs, tmp_path, capsys):
    evaluate(tmp_path, "--scenarios", "ReachLinearMocap", "--seeds", "1")
    found = json.loads((tmp_path / "summary.json").read_text())["conditions"]
    assert found["objects"] == ["mug", "ball"] and found["seeds"] == [0]
    assert "Conditions: development split" in capsys.readouterr().out


def test_finished_runs_are_not_repeated(fake_runs, tmp_path, capsys):
    arguments = ("--scenarios", "ReachLinearMocap", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    first = rows_of(tmp_path)
    fake_runs.clear()
    evaluate(tmp_path, *arguments)
    assert fake_runs == []
    assert "4 of 4 are finished already" in capsys.readouterr().out
    assert rows_of(tmp_path) == first

    evaluate(tmp_path, "--scenarios", "ReachLinearMocap", "--seeds", "2")
    assert sorted(name[-1] for name in fake_runs) == ["1"] * 4


def test_a_commit_in_the_middle_is_told(fake_runs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_module, "git_revision", lambda: "later")
    evaluate(tmp_path, "--scenarios", "ReachLinearMocap", "--seeds", "1")
    assert "some runs are of later, not 57f3f21b0c4e" in capsys.readouterr().out
    assert json.loads((tmp_path / "summary.json").read_text())["git"] == "57f3f21b0c4e"


def test_uncommitted_changes_are_told(fake_runs, tmp_path, monkeypatch, capsys):
    for module in REVISION:
        monkeypatch.setattr(module, "git_revision", lambda: "57f3f21b0c4e-dirty")
    for _ in range(2):
        evaluate(tmp_path, "--scenarios", "ReachLinearMocap", "--seeds", "1")
    assert len(fake_runs) == 4
    assert "uncommitted changes cannot be distinguished" in capsys.readouterr().out


@pytest.mark.parametrize(
    "change",
    [
        {"git": "0123456789ab"},
        {"versions": {"drake": "0.1"}},
        {"scenario_yaml": "{}"},
        {"files": {"object": "another mesh"}},
        {"timings": {"wall_s": None}},
        None,
    ],
    ids=["revision", "versions", "scenario", "mesh", "crashed", "half a file"],
)
def test_runs_of_another_state_are_repeated(fake_runs, tmp_path, capsys, change):
    arguments = ("--scenarios", "ReachLinearMocap", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    file = tmp_path / "runs" / "ReachLinearMocap-mug-task-safe-0.json"
    text = file.read_text()
    file.write_text(text[:40] if change is None else json.dumps(json.loads(text) | change))
    fake_runs.clear()
    evaluate(tmp_path, *arguments)
    assert fake_runs == [file.stem]
    assert "1 results are from another revision or setting, or crashed" in capsys.readouterr().out


def test_a_changed_setting_repeats_its_runs(fake_runs, tmp_path):
    arguments = ("--scenarios", "ReachLinearMocap", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    fake_runs.clear()
    evaluate(tmp_path, *arguments, "--scenario-text", "{object: {friction: 0.3}}")
    assert len(fake_runs) == 4


def test_an_interruption_keeps_what_is_finished(fake_runs, tmp_path, monkeypatch):
    run = isolated.run_isolated

    def interrupted(scenario, name, filename, **options):
        if len(fake_runs) == 3:
            raise KeyboardInterrupt
        return run(scenario, name, filename)

    monkeypatch.setattr(isolated, "run_isolated", interrupted)
    arguments = ("--scenarios", "ReachLinearMocap", "--seeds", "2")
    assert evaluate(tmp_path, *arguments) == 130
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["partial"] is True and summary["rows"][0]["n"] <= 3
    monkeypatch.setattr(isolated, "run_isolated", run)
    assert evaluate(tmp_path, *arguments) == 0
    assert len(fake_runs) == len(set(fake_runs)) == 8
    assert "partial" not in json.loads((tmp_path / "summary.json").read_text())


def test_real_runs_in_real_processes(tmp_path):
    text = "{simulation_duration: 0.06}"
    status = evaluate(
        tmp_path, "--objects", "soup_can", "--scenarios", "ReachLinearMocap", "--seeds", "1",
        "--jobs", "2", "--scenario-text", text,
    )  # fmt: skip
    assert status == 0
    found = rows_of(tmp_path)
    assert found["all/all/safe", "dynamic.failed_percent"]["value"] == 0.0
    assert found["all/all/safe", "dynamic.joint_limit_violation_percent"]["n"] == 2
    assert found["all/all/safe", "dynamic.held_percent"]["value"] == 0.0
