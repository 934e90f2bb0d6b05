"""``feasigrasp evaluate faults``: what it runs, and what it counts."""

import argparse
import csv
import json

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.errors import ScenarioError
from feasigrasp.models.control.status import StatusCode
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.cause import Cause
from feasigrasp.runs.run import crash_record
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.protocols.fault_table import FAULTS, LOST
from feasigrasp_lab.report.tables import faults_report
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.runs import isolated
from feasigrasp_lab.runs.fault_plan import (
    FaultRun,
    false_alarm,
    faulty_runs,
    nominal_runs,
    outcome,
)
from feasigrasp_lab.runs.studies import STUDIES
from feasigrasp_lab.studies import faults

FILE = diagram_path("dynamic.scenarios.yaml")
MOTIONS = STUDIES["mocap"].scenarios


def options(*arguments):
    parser = argparse.ArgumentParser()
    faults.add_arguments(parser)
    return parser.parse_args(["--objects", "ball,mug", *arguments])


def record(scenario, *, simulated=12.0, **metrics):
    made = crash_record(scenario, "", "") | {"error": None}
    made["timings"] |= {"simulated_s": simulated, "wall_s": 1.0}
    made["metrics"] |= {"grasp_held": True, "obstacle_distance_min_mm": 50.0} | metrics
    return made


# ------------------------------------------------------------------------------------------ plan


def test_every_fault_meets_every_object_controller_and_instant():
    nominal = nominal_runs(options("--instants", "5"))
    runs = faulty_runs(nominal, [record(run.scenario) for run in nominal], list(FAULTS), 0)
    assert len(nominal) == 2 * 2 * 6
    assert len({run.id for run in runs}) == len(runs) == len(FAULTS) * len(nominal) >= 300
    assert {run.name for run in runs} == set(MOTIONS)
    assert {run.fault for run in runs} == set(FAULTS)


def test_runs_have_their_controller():
    for controller in ("task", "joint"):
        for run in nominal_runs(options("--controllers", controller, "--instants", "2")):
            assert run.scenario.control.controller == controller


def test_the_study_has_the_faults_that_it_must_have():
    """Camera 8 (outliers of three shares), mask 5, pose 7, late, object 7, controller 3."""
    assert len(FAULTS) == 8 + 5 + 7 + 1 + 7 + 3
    held = {name for name, fault in FAULTS.items() if fault.held}
    assert held == {
        "outliers_5",
        "mask_shifted",
        "mask_eroded",
        "mask_dilated",
        "pose_nan_short",
        "pose_late",
        "perception_late",
    }


def test_what_names_a_fault_is_a_status_or_a_cause():
    words = {str(word) for word in (*StatusCode, *Cause)}
    assert {name for fault in FAULTS.values() for name in fault.named} <= words


@pytest.mark.parametrize("camera", [True, False])
def test_a_pose_is_rightly_lost_with_the_image_by_the_camera_alone(camera):
    scenario = load_scenario("ReachLinear" if camera else "ReachLinearMocap")
    for name in ("camera_gone", "mask_empty", "object_out_of_reach", "object_fast"):
        assert ("looking_for_object" in FAULTS[name].words(scenario)) == camera
    for name in ("object_stops", "perception_late", "controller_nan", "object_pulled"):
        assert not {*LOST} & {*FAULTS[name].words(scenario)}


def test_by_the_camera_alone_pose_and_mask_are_not_given():
    for run in nominal_runs(options("--camera", "--instants", "2")):
        assert run.scenario.tracker.kind == "camera"
        assert run.scenario.perception.segmentation == "depth"


def test_faults_begin_in_the_approach_of_the_run_without_them_or_in_its_lift():
    """With a run of 12 s: approach until 6 s, fingers until 7 s, lift until 8.5 s, shake, hold."""
    nominal = nominal_runs(options("--instants", "40", "--controllers", "task"))
    records = [record(run.scenario) for run in nominal]
    for name, first, last in (("pose_nan", 0.0, 6.0), ("object_pulled", 7.0, 8.5)):
        runs = faulty_runs(nominal, records, [name], 0)
        starts = np.array([run.start for run in runs])
        assert {run.start for run in runs if run.instant == 0} == {first}
        drawn = np.array([run.start for run in runs if run.instant > 0])
        assert starts.min() >= first and starts.max() <= last
        assert drawn.mean() == pytest.approx(0.5 * (first + last), rel=0.15)
        assert drawn.std() == pytest.approx((last - first) / np.sqrt(12), rel=0.2)
        for run in runs:
            (fault,) = run.scenario.faults
            assert fault.start == run.start
            assert run.scenario.simulation_duration == Scenario().simulation_duration
            if run.instant < 3:  # to write and to read takes long, and is the same for all
                assert parse_scenario(dump_scenario(run.scenario)).faults == [fault]


def test_instants_are_drawn_from_the_seed():
    nominal = nominal_runs(options())
    records = [record(run.scenario) for run in nominal]

    def starts(seed):
        return [run.start for run in faulty_runs(nominal, records, ["pose_nan"], seed)]

    assert starts(0) == starts(0) != starts(1)


def test_one_instant_comes_at_another_time_to_every_fault_object_and_controller():
    nominal = nominal_runs(options("--instants", "1"))
    records = [record(run.scenario) for run in nominal]
    runs = [run for run in faulty_runs(nominal, records, list(FAULTS), 0) if run.instant == 1]
    starts = np.array([run.start for run in runs if not FAULTS[run.fault].while_lifting])
    assert len(set(starts)) >= 0.95 * len(starts)
    counts = np.histogram(starts, bins=4, range=(0.0, 6.0))[0]
    assert counts.min() >= 0.6 * counts.mean()
    motions = {each: {run.name for run in nominal if run.instant == each} for each in (0, 1)}
    assert motions == {0: {*MOTIONS[:2]}, 1: {*MOTIONS[1:]}}


def test_what_is_always_so_is_told_to_the_tracker():
    nominal = nominal_runs(options("--instants", "1"))
    records = [record(run.scenario) for run in nominal]
    for run in faulty_runs(nominal, records, ["pose_late"], 0):
        tracker = run.scenario.tracker
        assert run.scenario.faults == []
        assert (tracker.latency, tracker.position_noise) == (0.1, 0.005)
        assert np.degrees(tracker.rotation_noise) == pytest.approx(3.0)


def test_an_unknown_fault_is_refused():
    with pytest.raises(ScenarioError, match="no fault pose_lost; there are camera_gone"):
        faulty_runs([], [], ["pose_lost"], 0)


# --------------------------------------------------------------------------------------- outcome


def came_of(status=(), fault="pose_nan", error=None, **metrics):
    scenario = load_scenario(FILE, "ReachLinearMocap")
    run = FaultRun("ReachLinearMocap", "ball", scenario, fault=fault, instant=1, start=3.0)
    made = record(scenario, **{"grasp_held": False} | metrics)
    made |= {"status": [list(entry) for entry in status], "error": error}
    return outcome(run, made)


def test_a_status_names_a_fault_if_it_is_right_and_not_from_before():
    wrong = came_of([(0.0, "following", ""), (3.5, "waiting", "")])
    assert not wrong["named"] and wrong["noticed_s"] is None
    right = came_of([(0.0, "following", ""), (3.5, "pose_lost", "")])
    assert right["named"] and right["noticed_s"] == pytest.approx(0.5)
    earlier = came_of([(1.0, "pose_lost", ""), (2.0, "following", "")])
    assert not earlier["named"]
    lasting = came_of([(0.0, "following", ""), (1.0, "pose_lost", "")])
    assert lasting["named"] and lasting["noticed_s"] == 0.0
    assert came_of(grasp_held=True)["named"]
    assert came_of(cause="pose_lost")["named"] and not came_of(cause="timeout")["named"]
    assert not came_of()["named"]


def test_what_names_where_the_object_is_names_one_fault():
    """And an arm that waits for the object to come into reach names none."""
    named = [word for fault in FAULTS.values() for word in fault.named]
    for code in (StatusCode.OUT_OF_REACH, StatusCode.BLOCKED_BY_TABLE):
        assert named.count(code) == 1
    assert not {StatusCode.WAITING, StatusCode.FOLLOWING, StatusCode.TOUCHED} & {*named}


@pytest.mark.parametrize(
    ("status", "alarm"),
    [
        ([(0.0, "nothing_seen", ""), (0.1, "following", ""), (3.0, "waiting", "table")], False),
        ([(0.0, "following", ""), (3.0, "out_of_reach", "")], True),
    ],
)
def test_a_fault_that_is_named_without_one_is_a_false_alarm(status, alarm):
    assert false_alarm({"status": status}) is alarm


@pytest.mark.parametrize(
    ("metrics", "broken"),
    [
        ({}, False),
        ({"joint_limit_violation_percent": 0.1}, True),
        ({"velocity_limit_violation_percent": 0.1}, True),
        ({"acceleration_limit_violation_percent": 0.1}, True),
        ({"torque_limit_violation_percent": 0.1}, True),
        ({"self_collision_percent": 0.1}, True),
        ({"obstacle_distance_min_mm": -0.1}, True),
        ({"obstacle_distance_min_mm": None}, False),
    ],
)
def test_any_limit_counts(metrics, broken):
    came = came_of(**metrics)
    assert came["broken"] is broken and bool(came["worst"]) is broken
    if broken:
        assert next(iter(metrics)) in came["worst"]


def test_rows_count_and_share():
    outcomes = [
        came_of([(3.25, "pose_lost", "")]),
        came_of(grasp_held=True),
        came_of(error="boom", self_collision_percent=2.0),
        came_of(fault="mask_empty", grasp_held=True),
    ]
    rows = {(row.preset, row.name): row for row in faults.outcome_rows(outcomes)}
    for name, value in (("crashes", 1), ("limits_broken", 1), ("noticed_s", 0.25)):
        assert rows["pose_nan", f"faults.{name}"].value == value
    assert rows["pose_nan", "faults.named_percent"].value == pytest.approx(200 / 3)
    assert rows["pose_nan", "faults.held_percent"].value == pytest.approx(100 / 3)
    assert rows["all", "faults.held_percent"].value == 50.0
    assert rows["all", "faults.crashes"].n == 4
    assert ("mask_empty", "faults.noticed_s") not in rows
    text = faults_report([*rows.values(), Row.plain("faults.truth_leaks", "all", 0, "1", 8)])
    lines = [line for line in text.splitlines() if line.startswith("| `pose_nan`")]
    assert len(lines) == 1 and "| 33 | 67 | 0.25 | 1 | 1 | 3 |" in lines[0]
    assert "0 of 8 pairs" in text


# --------------------------------------------------------------------------------------- command


@pytest.fixture
def fake_runs(monkeypatch):
    """Replaces simulation and probes; gives the list of what ran."""
    ran = []

    def run(scenario, name, filename, *, replay=None):
        ran.append(filename.stem)
        made = record(scenario) | {"scenario": name}
        filename.write_text(json.dumps(made))
        return made

    def probe(name, item):
        ran.append(name)
        if "pair" in item:
            return [{"leaks": "joint" in name}]
        return [{"rest_s": item["lost_at"], "rest_pushed_s": item["lost_at"] + 1.0}]

    monkeypatch.setattr(isolated, "run_isolated", run)
    monkeypatch.setattr(faults, "probe", probe)
    return ran


def test_it_runs_and_goes_on_where_it_was(fake_runs, tmp_path):
    chosen = ("--objects", "ball", "--faults", "pose_nan,mask_empty", "--instants", "1")
    line = ["evaluate", "faults", "--out", str(tmp_path), "--jobs", "1", *chosen]
    assert cli.main(line) == 0
    assert len(set(fake_runs)) == len(fake_runs) == 4 + 8 + 8 + 4
    summary = json.loads((tmp_path / "summary.json").read_text())
    rows = {(row["preset"], row["name"]): row for row in summary["rows"]}
    assert rows["mask_empty", "faults.held_percent"]["value"] == 100.0
    assert rows["all", "faults.truth_leaks"]["value"] == 4.0
    assert rows["all", "faults.truth_leaks"]["n"] == 8
    with (tmp_path / "runs.csv").open() as file:
        lines = list(csv.DictReader(file))
    starts = [float(each["start_s"]) for each in lines if each["fault"] == "pose_nan"]
    assert rows["all", "faults.rest_s"]["value"] == max(starts) > 0.0
    assert rows["all", "faults.rest_pushed_s"]["value"] == max(starts) + 1.0
    fake_runs.clear()
    assert cli.main(line) == 0 and fake_runs == []
