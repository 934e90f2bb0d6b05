"""Rows of the dynamic test against figures computed by hand."""

import pytest

from feasigrasp.evaluation.runs.run import crash_record
from feasigrasp.evaluation.runs.summary import format_table, summary_rows
from feasigrasp.results.statistics import proportion
from feasigrasp.scenario.schema import Scenario


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
