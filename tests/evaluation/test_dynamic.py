"""``feasigrasp evaluate dynamic``: figures against hand-computed ones, resuming, failures."""

import argparse
import csv
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.evaluation import dynamic, isolated
from feasigrasp.evaluation import run as run_module
from feasigrasp.evaluation.arguments import select_objects
from feasigrasp.evaluation.dynamic_plan import STUDIES, plan
from feasigrasp.evaluation.dynamic_summary import format_table, summary_rows
from feasigrasp.evaluation.run import crash_record
from feasigrasp.evaluation.statistics import mean, proportion
from feasigrasp.models.rigid_object import builtin_objects, load_object
from feasigrasp.resources import diagram_path, model_path
from feasigrasp.scenario import Scenario, load_scenario

# ---------------------------------------------------------------------------------- intervals


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_as_published(successes, n, low, high):
    """Newcombe (1998), Statistics in Medicine 17, table I, method 3."""
    estimate = proportion(successes, n)
    assert estimate.value == pytest.approx(successes / n)
    assert (round(estimate.low, 4), round(estimate.high, 4)) == (low, high)


@pytest.mark.parametrize("n", [1, 2, 7, 36])
def test_wilson_interval_is_symmetric_and_holds_its_value(n):
    none, all_of_them = proportion(0, n), proportion(n, n)
    assert (none.low, all_of_them.high) == (0.0, 1.0)
    assert none.high == pytest.approx(1.0 - all_of_them.low)


def test_student_interval_of_three():
    """Mean 2, deviation 1: 2 +- 4.302653/sqrt(3), t_0.975 with 2 degrees of freedom."""
    estimate = mean([1.0, 2.0, 3.0])
    half = 4.302652729911275 / np.sqrt(3.0)
    assert (estimate.value, estimate.n) == (2.0, 3)
    np.testing.assert_allclose([estimate.low, estimate.high], [2.0 - half, 2.0 + half])
    cut = mean([1.0, 2.0, 3.0], lower=0.0, upper=4.0)
    assert (cut.low, cut.high) == (0.0, 4.0)
    assert mean([5.0]).low is None and mean([5.0]).high is None


# -------------------------------------------------------------------------------- aggregation


def record(scenario, controller, held, *, limits=0.0, distance=5.0, slip=None, error=None):
    made = crash_record(Scenario(), scenario, "")
    made |= {"controller": controller, "error": error}
    made["metrics"] |= {
        "grasp_held": held,
        "joint_limit_violation_percent": limits,
        "gripper_object_distance_cm_mean": distance,
        "slip_mm": slip,
    }
    return made


RECORDS = [
    record("ReachLinear", "task", True, distance=4.0, slip=0.5),
    record("ReachLinear", "task", False, distance=6.0, limits=10.0),
    record("ReachLinear", "joint", True, distance=3.0, slip=1.5),
    record("ReachCircular", "task", True, distance=8.0),
    record("PaperLinear", "task", None, distance=2.0),
    record("PaperLinear", "joint", None, distance=None, error="broke"),
]


@pytest.fixture(scope="module")
def found():
    return {(row.preset, row.name.removeprefix("dynamic.")): row for row in summary_rows(RECORDS)}


@pytest.mark.parametrize(
    ("preset", "name", "value", "n"),
    [
        ("ReachLinear/task/safe", "held_percent", 50.0, 2),
        ("ReachLinear/joint/safe", "held_percent", 100.0, 1),
        ("all/task/safe", "held_percent", 200.0 / 3.0, 3),
        ("all/joint/safe", "held_percent", 100.0, 1),
        ("all/all/safe", "held_percent", 75.0, 4),
        ("ReachLinear/task/safe", "joint_limit_violation_percent", 5.0, 2),
        ("all/all/safe", "joint_limit_violation_percent", 10.0 / 6.0, 6),
        ("all/task/safe", "gripper_object_distance_cm_mean", 5.0, 4),
        ("all/all/safe", "gripper_object_distance_cm_mean", 23.0 / 5.0, 5),
        ("all/all/safe", "slip_mm", 1.0, 2),
        ("all/all/safe", "failed_percent", 100.0 / 6.0, 6),
        ("PaperLinear/joint/safe", "failed_percent", 100.0, 1),
    ],
)
def test_figures_are_those_computed_by_hand(found, preset, name, value, n):
    row = found[preset, name]
    assert row.value == pytest.approx(value)
    assert row.n == n


@pytest.mark.parametrize(
    ("preset", "name"),
    [
        ("PaperLinear/task/safe", "held_percent"),
        ("PaperLinear/joint/safe", "gripper_object_distance_cm_mean"),
        ("all/all/safe", "manipulability_mean"),
        ("all/all/safe", "object_end_x_m"),
        ("all/all/safe", "grasp_held"),
    ],
)
def test_figures_that_no_run_has_are_left_out(found, preset, name):
    assert (preset, name) not in found


def test_intervals_are_in_the_unit_of_the_row(found):
    row = found["all/all/safe", "held_percent"]
    expected = proportion(3, 4)
    assert (row.low, row.high, row.unit) == (100 * expected.low, 100 * expected.high, "%")
    # 10/6 +- t would go below 0.
    assert found["all/all/safe", "joint_limit_violation_percent"].low == 0.0
    assert found["ReachLinear/joint/safe", "slip_mm"].low is None


def test_presets_go_from_single_to_all(found):
    presets = list(dict.fromkeys(preset for preset, _ in found))
    assert presets == [
        "ReachLinear/task/safe",
        "ReachLinear/joint/safe",
        "ReachCircular/task/safe",
        "PaperLinear/task/safe",
        "PaperLinear/joint/safe",
        "all/task/safe",
        "all/joint/safe",
        "all/all/safe",
    ]


def test_objects_have_rows_of_their_own_if_there_are_several(found):
    assert not any(preset.count("/") == 3 for preset, _ in found)
    two = [
        record("PaperLinear", "task", None, distance=distance) | {"object": model}
        for model, distance in [("duck", 1.0), ("duck", 2.0), ("/meshes/vase.obj", 6.0)]
    ]
    rows = {(row.preset, row.name): row for row in summary_rows(two)}
    name = "dynamic.gripper_object_distance_cm_mean"
    assert rows["PaperLinear/task/safe", name].value == 3.0
    assert rows["PaperLinear/task/safe/duck", name].value == 1.5
    assert rows["PaperLinear/task/safe/vase", name].n == 1
    assert len(format_table(list(rows.values())).splitlines()) == 4


def test_the_table_has_a_line_per_preset():
    lines = format_table(summary_rows(RECORDS)).splitlines()
    assert len(lines) == 9
    line = next(line for line in lines if line.startswith("all/all/safe"))
    assert "75 [30, 95]" in line and line.endswith(" 6")
    assert next(line for line in lines if line.startswith("PaperLinear/task")).split()[1] == "-"


# ------------------------------------------------------------------------------------ the command


@pytest.fixture
def fake_runs(monkeypatch):
    """Replaces the simulation; gives the list of what ran."""
    ran = []

    def run(scenario, name, filename):
        ran.append(filename.stem)
        made = crash_record(scenario, name, "") | {"error": None}
        made["metrics"]["grasp_held"] = scenario.random_seed % 2 == 0
        made["timings"]["wall_s"] = 1.0
        filename.write_text(json.dumps(made))
        return made

    monkeypatch.setattr(dynamic, "run_isolated", run)
    # A commit while the tests run must not change what they see.
    for module in (dynamic, run_module):
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
    rows = rows_of(tmp_path)
    fake_runs.clear()
    evaluate(tmp_path, *arguments)
    assert fake_runs == []
    assert "4 of 4 runs are finished already" in capsys.readouterr().out
    assert rows_of(tmp_path) == rows

    evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "2")
    assert sorted(name[-1] for name in fake_runs) == ["1"] * 4


def test_a_commit_in_the_middle_is_told(fake_runs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_module, "git_revision", lambda: "later")
    evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "1")
    assert "some runs are of later, not 57f3f21b0c4e" in capsys.readouterr().out
    assert json.loads((tmp_path / "summary.json").read_text())["git"] == "57f3f21b0c4e"


def test_uncommitted_changes_are_told(fake_runs, tmp_path, monkeypatch, capsys):
    for module in (dynamic, run_module):
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
    run = dynamic.run_isolated

    def interrupted(scenario, name, filename):
        if len(fake_runs) == 3:
            raise KeyboardInterrupt
        return run(scenario, name, filename)

    monkeypatch.setattr(dynamic, "run_isolated", interrupted)
    arguments = ("--scenarios", "ReachLinear", "--seeds", "2")
    assert evaluate(tmp_path, *arguments) == 130
    assert not (tmp_path / "summary.json").exists()
    monkeypatch.setattr(dynamic, "run_isolated", run)
    assert evaluate(tmp_path, *arguments) == 0
    assert len(fake_runs) == len(set(fake_runs)) == 8


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


# ------------------------------------------------------------------------------- real processes


def test_real_runs_in_real_processes(tmp_path):
    text = "{simulation_duration: 0.06}"
    status = evaluate(
        tmp_path, "--objects", "soup_can", "--scenarios", "ReachLinear", "--seeds", "1",
        "--jobs", "2", "--scenario_text", text,
    )  # fmt: skip
    assert status == 0
    rows = rows_of(tmp_path)
    assert rows["all/all/safe", "dynamic.failed_percent"]["value"] == 0.0
    assert rows["all/all/safe", "dynamic.joint_limit_violation_percent"]["n"] == 2
    assert rows["all/all/safe", "dynamic.held_percent"]["value"] == 0.0


def test_an_exception_in_the_process_becomes_its_record(tmp_path):
    scenario = load_scenario(
        diagram_path("dynamic.scenarios.yaml"), "ReachLinear", "{object: {model: teapot}}"
    )
    file = tmp_path / "run.json"
    record = isolated.run_isolated(scenario, "Mine", file)
    assert "MeshError: 'teapot' is neither" in record["error"]
    assert record["metrics"]["grasp_held"] is False
    assert json.loads(file.read_text()) == record


def run_out_of_memory(*arguments):
    Path(arguments[-1]).write_text("out of memory")
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_process_becomes_its_record(tmp_path, monkeypatch):
    monkeypatch.setattr(isolated, "_run_to_file", run_out_of_memory)
    file = tmp_path / "run.json"
    file.write_text("an old result")
    record = isolated.run_isolated(Scenario(), "Mine", file)
    assert record["error"] == "the process ended with status -9: out of memory"
    assert json.loads(file.read_text()) == record


def test_a_process_repeats_what_a_run_in_this_one_gives(tmp_path):
    text = "{simulation_duration: 0.3, object: {model: ball}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinear", text)
    record = isolated.run_isolated(scenario, "Mine", tmp_path / "run.json")
    assert record["metrics"] == run_module.run(scenario, "Mine").record["metrics"]
