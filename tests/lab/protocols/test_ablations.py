"""Ablations against differences taken by hand."""

import pytest

from feasigrasp.runs.run import crash_record
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.protocols.ablations import ablation_rows, controller_rows
from feasigrasp_lab.runs.summary import summary_rows


def record(name, thing, held, time=None, controller="task", seed=0):
    made = crash_record(Scenario(), name, "") | {
        "controller": controller,
        "object": thing,
        "seed": seed,
        "error": None,
    }
    made["metrics"] |= {"grasp_held": held, "held_after_s": time}
    return made


RECORDS = [
    record("ReachLinearMocap-full", "mug", True, 3.0),
    record("ReachLinearMocap-full", "mug", True, 4.0, seed=1),
    record("ReachLinearMocap-full", "ball", True, 2.0),
    record("ReachLinearMocap-full", "ball", True, 6.0, controller="joint"),
    record("ReachLinearMocap-no-score", "mug", False),
    record("ReachLinearMocap-no-score", "mug", True, 5.0, seed=1),
    record("ReachLinearMocap-no-score", "ball", True, 2.5),
    record("ReachLinearMocap-no-score", "ball", True, 5.0, controller="joint"),
    # Without a counterpart, and of another study.
    record("ReachLinearMocap-no-score", "cup", False),
    record("ReachLinearMocap", "mug", False),
]


def found(records=RECORDS):
    return {(r.preset, r.name.removeprefix("dynamic.")): r for r in ablation_rows(records)}


@pytest.mark.parametrize(
    ("preset", "name", "value", "n"),
    [
        ("all-no-score/task/safe", "held_change_percent", -25.0, 3),
        ("all-no-score/task/safe", "held_after_change_s", 0.75, 2),
        ("all-no-score/joint/safe", "held_change_percent", 0.0, 1),
        ("all-no-score/joint/safe", "held_after_change_s", -1.0, 1),
        ("all-no-score/all/safe", "held_change_percent", -25.0, 4),
    ],
)
def test_runs_are_compared_with_their_own_counterparts(preset, name, value, n):
    """The mug holds in one of two, the ball always; every object counts once."""
    row = found()[preset, name]
    assert row.value == pytest.approx(value)
    assert row.n == n


def test_there_is_nothing_else_and_no_change_of_the_whole():
    assert {preset.split("/")[0] for preset, _ in found()} == {"all-no-score"}
    assert found(RECORDS[4:]) == {}


def test_they_stand_beside_the_figures_of_each_ablation():
    rows = {(r.preset, r.name): r.value for r in summary_rows(RECORDS)}
    assert rows["all-full/task/safe", "dynamic.held_percent"] == 100.0
    assert rows["all-no-score/task/safe", "dynamic.held_change_percent"] == pytest.approx(-25.0)
    assert rows["all/task/safe", "dynamic.held_percent"] == 0.0


def test_controllers_are_compared_with_task_on_the_same_runs():
    """Of two paired runs of the mug, one is lost; a scenario or seed of one's own has no pair."""
    records = [
        record("ReachLinearMocap", "mug", True, 3.0),
        record("ReachLinearMocap", "mug", True, 4.0, seed=1),
        record("ReachLinearMocap", "mug", False, controller="nearest"),
        record("ReachLinearMocap", "mug", True, 2.0, controller="nearest", seed=1),
        record("ReachLinearMocap", "mug", False, controller="nearest", seed=2),
        record("ReachCircularMocap", "mug", False, controller="nearest"),
    ]
    rows = {r.name: r for r in controller_rows(records)}
    assert {r.preset for r in rows.values()} == {"ReachLinearMocap/nearest/safe"}
    assert rows["dynamic.held_change_percent"].value == pytest.approx(-50.0)
    assert rows["dynamic.held_change_percent"].n == 2
    assert rows["dynamic.held_after_change_s"].value == pytest.approx(-2.0)
