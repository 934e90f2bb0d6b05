"""``feasigrasp evaluate dynamic``: what it runs, and that it goes on where it was."""

import argparse
import csv
import json

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.evaluation.runs import isolated
from feasigrasp.evaluation.runs import run as run_module
from feasigrasp.evaluation.runs.plan import STUDIES, plan
from feasigrasp.evaluation.runs.run import crash_record
from feasigrasp.evaluation.studies import dynamic
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.resources import model_path
from feasigrasp.results import finished, rows
from feasigrasp.results.arguments import select_objects

#: Where the revision is asked for.
REVISION = (dynamic, finished, rows, run_module)


@pytest.fixture
def fake_runs(monkeypatch):
    """Replaces the simulation; gives the list of what ran."""
    ran = []

    def run(scenario, name, filename, *, replay=None):
        ran.append(filename.stem)
        made = crash_record(scenario, name, "") | {"error": None}
        made["metrics"]["grasp_held"] = scenario.random_seed % 2 == 0
        made["timings"]["wall_s"] = 1.0
        filename.write_text(json.dumps(made))
        return made

    monkeypatch.setattr(isolated, "run_isolated", run)
    # A commit while the tests run must not change what they see.
    for module in REVISION:
        monkeypatch.setattr(module, "git_revision", lambda: "57f3f21b0c4e")
    return ran


def evaluate(out, *arguments):
    arguments = ("--jobs", "1", "--objects", "mug,ball", *arguments)
    return cli.main(["evaluate", "dynamic", "--out", str(out), *arguments])


def rows_of(out):
    summary = json.loads((out / "summary.json").read_text())
    return {(row["preset"], row["name"]): row for row in summary["rows"]}


def test_it_runs_every_combination_and_sums_up(fake_runs, tmp_path):
    scenarios = ("--scenarios", "ReachLinear,PaperLinear", "--mode", "safe", "--seeds", "3")
    assert evaluate(tmp_path, *scenarios) == 0
    assert len(set(fake_runs)) == len(fake_runs) == 2 * 2 * 2 * 3
    assert "PaperLinear-ball-joint-safe-2" in fake_runs

    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {"command", "git", "seed", "versions", "machine", "rows"} <= set(summary)
    assert "--objects mug,ball" in summary["command"]
    row = rows_of(tmp_path)["all/all/safe", "dynamic.held_percent"]
    assert set(row) == {"name", "preset", "value", "low", "high", "unit", "n"}
    assert row["value"] == pytest.approx(200.0 / 3.0) and row["n"] == 24

    with (tmp_path / "runs.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 24
    assert {line["object"] for line in lines} == {"mug", "ball"}
    assert {line["grasp_held"] for line in lines} == {"True", "False"}


def test_the_seed_option_shifts_the_repeats(fake_runs, tmp_path):
    evaluate(tmp_path, "--scenarios", "ReachLinear", "--controllers", "task", "--seed", "10")
    assert sorted(fake_runs) == [
        f"ReachLinear-{o}-task-safe-{k}" for o in ("ball", "mug") for k in (10, 11, 12)
    ]


def test_quick_is_one_object_and_one_seed(fake_runs, tmp_path):
    evaluate(tmp_path, "--quick", "--study", "reach")
    assert len(fake_runs) == 3 * 2
    assert all("-mug-" in name and name.endswith("-0") for name in fake_runs)
    assert json.loads((tmp_path / "summary.json").read_text())["quick"] is True


def planned(*arguments):
    parser = argparse.ArgumentParser()
    dynamic.add_arguments(parser)
    return plan(parser.parse_args(arguments))


def test_without_options_it_is_the_whole_study():
    """{Circular, Linear, Sinusoidal} x {task, joint} x {paper, safe} x 5 seeds x 3 objects; grasps
    of at least ten objects x 3 seeds at friction 0.6; and the wall."""
    runs = planned()
    by_study = {
        name: [run for run in runs if run.name in study.scenarios]
        for name, study in STUDIES.items()
    }
    assert sum(map(len, by_study.values())) == len({run.id for run in runs}) == len(runs)
    assert len(by_study["paper"]) == 3 * 2 * 2 * 5 * 3
    assert len(by_study["reach"]) >= 3 * 2 * 10 * 3
    assert {run.scenario.control.mode for run in by_study["reach"]} == {"safe"}
    assert {run.scenario.object.friction for run in by_study["reach"]} == {0.6}
    for run in by_study["paper"]:
        assert run.scenario.simulation_duration == pytest.approx(3 * 2 * np.pi / 0.3)
    assert all(run.scenario.scene.enabled for run in by_study["obstacle"])


def test_the_papers_object_has_the_papers_size_and_the_others_are_larger():
    names = STUDIES["paper"].objects.split(",")
    sizes = [np.ptp(load_object(name).vertices, axis=0) for name in names]
    np.testing.assert_allclose(np.sort(sizes[0]), [0.041, 0.054, 0.058], atol=0.0015)
    for size in sizes[1:]:
        assert np.prod(size) > 1.2 * np.prod(sizes[0])


def test_options_change_every_study():
    runs = planned("--scenarios", "PaperLinear,ReachLinear", "--mode", "paper", "--seeds", "1",
                   "--objects", "mug", "--controllers", "joint")  # fmt: skip
    assert [run.id for run in runs] == [
        "PaperLinear-mug-joint-paper-0",
        "ReachLinear-mug-joint-paper-0",
    ]


def test_a_quick_study_is_short():
    runs = planned("--quick")
    assert len(runs) == 3 * 2 * 2 + 3 * 2 + 2
    follows = [run.scenario for run in runs if not run.scenario.grasp.close]
    assert len(follows) == 12 and all(s.simulation_duration <= 10.0 for s in follows)


def test_finished_runs_are_not_repeated(fake_runs, tmp_path, capsys):
    arguments = ("--scenarios", "ReachLinear", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    first = rows_of(tmp_path)
    fake_runs.clear()
    evaluate(tmp_path, *arguments)
    assert fake_runs == []
    assert "4 of 4 are finished already" in capsys.readouterr().out
    assert rows_of(tmp_path) == first

    evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "2")
    assert sorted(name[-1] for name in fake_runs) == ["1"] * 4


def test_a_commit_in_the_middle_is_told(fake_runs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_module, "git_revision", lambda: "later")
    evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "1")
    assert "some runs are of later, not 57f3f21b0c4e" in capsys.readouterr().out
    assert json.loads((tmp_path / "summary.json").read_text())["git"] == "57f3f21b0c4e"


def test_uncommitted_changes_are_told(fake_runs, tmp_path, monkeypatch, capsys):
    for module in REVISION:
        monkeypatch.setattr(module, "git_revision", lambda: "57f3f21b0c4e-dirty")
    for _ in range(2):
        evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "1")
    assert len(fake_runs) == 4
    assert "uncommitted changes cannot be told apart" in capsys.readouterr().out


@pytest.mark.parametrize(
    "change",
    [
        {"git": "0123456789ab"},
        {"versions": {"drake": "0.1"}},
        {"scenario_yaml": "{}"},
        {"timings": {"wall_s": None}},
        None,
    ],
    ids=["revision", "versions", "scenario", "crashed", "half a file"],
)
def test_runs_of_another_state_are_repeated(fake_runs, tmp_path, capsys, change):
    arguments = ("--scenarios", "ReachLinear", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    file = tmp_path / "runs" / "ReachLinear-mug-task-safe-0.json"
    text = file.read_text()
    file.write_text(text[:40] if change is None else json.dumps(json.loads(text) | change))
    fake_runs.clear()
    evaluate(tmp_path, *arguments)
    assert fake_runs == [file.stem]
    assert "1 results are from another revision or setting, or crashed" in capsys.readouterr().out


def test_a_changed_setting_repeats_its_runs(fake_runs, tmp_path):
    arguments = ("--scenarios", "ReachLinear", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    fake_runs.clear()
    evaluate(tmp_path, *arguments, "--scenario_text", "{object: {friction: 0.3}}")
    assert len(fake_runs) == 4


def test_an_interruption_keeps_what_is_finished(fake_runs, tmp_path, monkeypatch):
    run = isolated.run_isolated

    def interrupted(scenario, name, filename, **options):
        if len(fake_runs) == 3:
            raise KeyboardInterrupt
        return run(scenario, name, filename)

    monkeypatch.setattr(isolated, "run_isolated", interrupted)
    arguments = ("--scenarios", "ReachLinear", "--seeds", "2")
    assert evaluate(tmp_path, *arguments) == 130
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["partial"] is True and summary["rows"][0]["n"] <= 3
    monkeypatch.setattr(isolated, "run_isolated", run)
    assert evaluate(tmp_path, *arguments) == 0
    assert len(fake_runs) == len(set(fake_runs)) == 8
    assert "partial" not in json.loads((tmp_path / "summary.json").read_text())


def test_objects_come_from_names_files_and_folders(tmp_path):
    assert list(select_objects("builtin")) == builtin_objects()
    mug = str(model_path("objects", "mug.obj"))
    assert select_objects(f"ball, {mug}") == {"ball": "ball", "mug": mug}
    (tmp_path / "b.obj").write_bytes(model_path("objects", "ball.obj").read_bytes())
    (tmp_path / "a.obj").write_bytes(model_path("objects", "mug.obj").read_bytes())
    assert select_objects(str(tmp_path)) == {
        "a": str(tmp_path / "a.obj"),
        "b": str(tmp_path / "b.obj"),
    }


def test_objects_of_the_ycb_layout(shared_data):
    assert len(select_objects(str(shared_data / "ycb"))) == 40


def test_real_runs_in_real_processes(tmp_path):
    text = "{simulation_duration: 0.06}"
    status = evaluate(
        tmp_path, "--objects", "soup_can", "--scenarios", "ReachLinear", "--seeds", "1",
        "--jobs", "2", "--scenario_text", text,
    )  # fmt: skip
    assert status == 0
    found = rows_of(tmp_path)
    assert found["all/all/safe", "dynamic.failed_percent"]["value"] == 0.0
    assert found["all/all/safe", "dynamic.joint_limit_violation_percent"]["n"] == 2
    assert found["all/all/safe", "dynamic.held_percent"]["value"] == 0.0
