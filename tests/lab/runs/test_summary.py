"""Rows of the dynamic test against figures computed by hand."""

import pytest

from feasigrasp.runs.run import crash_record
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.results.statistics import proportion
from feasigrasp_lab.runs.summary import format_table, summary_rows


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
    record("ReachLinearMocap", "task", True, distance=4.0, slip=0.5),
    record("ReachLinearMocap", "task", False, distance=6.0, limits=10.0),
    record("ReachLinearMocap", "joint", True, distance=3.0, slip=1.5),
    record("ReachCircularMocap", "task", True, distance=8.0),
    record("PaperLinear", "task", None, distance=2.0),
    record("PaperLinear", "joint", None, distance=None, error="broke"),
]


@pytest.fixture(scope="module")
def found():
    return {(row.preset, row.name.removeprefix("dynamic.")): row for row in summary_rows(RECORDS)}


@pytest.mark.parametrize(
    ("preset", "name", "value", "n"),
    [
        ("ReachLinearMocap/task/safe", "held_percent", 50.0, 2),
        ("ReachLinearMocap/joint/safe", "held_percent", 100.0, 1),
        ("all/task/safe", "held_percent", 200.0 / 3.0, 3),
        ("all/joint/safe", "held_percent", 100.0, 1),
        ("all/all/safe", "held_percent", 75.0, 4),
        ("ReachLinearMocap/task/safe", "joint_limit_violation_percent", 5.0, 2),
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
    assert found["ReachLinearMocap/joint/safe", "slip_mm"].low is None


def test_presets_go_from_single_to_all(found):
    presets = list(dict.fromkeys(preset for preset, _ in found))
    assert presets == [
        "ReachLinearMocap/task/safe",
        "ReachLinearMocap/joint/safe",
        "ReachCircularMocap/task/safe",
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
        for model, distance in [("duck", 1.0), ("duck", 2.0), ("/meshes/mug.obj", 6.0)]
    ]
    rows = {(row.preset, row.name): row for row in summary_rows(two)}
    name = "dynamic.gripper_object_distance_cm_mean"
    # Each object once: (1.5 + 6) / 2.
    assert rows["PaperLinear/task/safe", name].value == 3.75
    assert rows["PaperLinear/task/safe/duck", name].value == 1.5
    assert rows["PaperLinear/task/safe/mug", name].n == 1
    assert len(format_table(list(rows.values())).splitlines()) == 4


def measured(model, held, **metrics):
    made = record("ReachLinearMocap", "task", held) | {"object": model}
    made["metrics"] |= metrics
    return made


HANDLED = [
    measured("mug", True, pushed_mm=2.0, contact_force_peak_n=0.0, cause=None, friction=0.6),
    measured("mug", True, pushed_mm=5.0, contact_force_peak_n=0.0, cause=None, friction=0.6),
    measured("ball", False, pushed_mm=890.0, contact_force_peak_n=31.0, cause="pushed away"),
    measured("ball", False, pushed_mm=5.1, contact_force_peak_n=2.0, cause="slipped"),
    measured("cup", None, cause=None),
]
HANDLED[0]["metrics"] |= {"planning_ms_worst": 12.0, "planning_ms_median": 1.0}
HANDLED[1]["metrics"] |= {"planning_ms_worst": 31.0, "planning_ms_median": 3.0}
HANDLED[2]["metrics"] |= {"planning_ms_worst": 8.0, "planning_ms_median": 2.0}
HANDLED[3]["metrics"] |= {"obstacle_distance_min_mm": -56.0}
HANDLED[0]["metrics"] |= {"obstacle_distance_min_mm": 100.0}


@pytest.mark.parametrize(
    ("name", "value", "n"),
    [
        ("held_percent", 50.0, 4),
        ("pushed_percent", 50.0, 4),
        ("pushed_mm_max", 890.0, 4),
        ("contact_before_closing_percent", 50.0, 4),
        ("cause.pushed away_percent", 25.0, 4),
        ("cause.slipped_percent", 25.0, 4),
        ("planning_ms.worst", 31.0, 3),
        ("planning_ms.median", 2.0, 3),
        ("obstacle_distance_min_mm.least", -56.0, 2),
        ("obstacle_distance_min_mm", 22.0, 2),
    ],
)
def test_what_a_mean_would_hide(name, value, n):
    rows = {row.name: row for row in summary_rows(HANDLED) if row.preset == "all/all/safe"}
    row = rows[f"dynamic.{name}"]
    assert (row.value, row.n) == (pytest.approx(value), n)
    assert "dynamic.cause" not in rows and "dynamic.planning_ms_worst" not in rows


def test_intervals_come_from_the_objects():
    """Two of two balls not held: the interval is that of 2 of 3 objects, not of 4 of 6 runs."""
    runs = [measured(model, model != "ball") for model in ("mug", "ball", "cup") for _ in range(2)]
    rows = {row.preset: row for row in summary_rows(runs) if row.name == "dynamic.held_percent"}
    expected = proportion(2, 3)
    assert rows["all/all/safe"].low == pytest.approx(100 * expected.low)
    assert rows["all/all/safe"].high == pytest.approx(100 * expected.high)
    one = rows["ReachLinearMocap/task/safe/ball"]
    assert (one.value, one.high) == (0.0, pytest.approx(100 * proportion(0, 2).high))


def test_a_study_that_changes_its_scenarios_has_rows_of_its_own():
    both = [
        record("ReachLinearMocap", "task", True),
        record("ReachLinearMocap-ideal", "task", False),
    ]
    held = {row.preset: row.value for row in summary_rows(both) if "held" in row.name}
    assert held["ReachLinearMocap/task/safe"] == held["all/all/safe"] == 100.0
    assert held["ReachLinearMocap-ideal/task/safe"] == held["all-ideal/all/safe"] == 0.0


def test_points_of_curves_are_of_one_mode():
    runs = [
        record("ReachCircularMocap-at-0.3", "task", held) | {"mode": mode}
        for mode, held in (("safe", True), ("corrected", False), ("corrected", False))
    ]

    def point(records):
        return next(row for row in summary_rows(records) if row.preset == "circle/0.3")

    assert (point(runs).value, point(runs).n) == (100.0, 1)
    assert (point(runs[1:]).value, point(runs[1:]).n) == (0.0, 2)


def test_the_table_has_a_line_per_preset():
    lines = format_table(summary_rows(RECORDS)).splitlines()
    assert len(lines) == 9
    line = next(line for line in lines if line.startswith("all/all/safe"))
    assert "75 [30, 95]" in line and line.endswith(" 6")
    assert next(line for line in lines if line.startswith("PaperLinear/task")).split()[1] == "-"
