"""The figures of a run, from samples made by hand whose answers are known."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.runs.metrics.handling import ObjectTruth
from feasigrasp.runs.metrics.motion_limits import limit_metrics
from feasigrasp.runs.metrics.run_metrics import summarize
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.systems.metrics import SAMPLE_NAMES, Metrics

A, C, L, S, H, D = (int(phase) for phase in Phase)


def samples(n, **columns):
    """Samples of a run in which nothing is wrong, except where a column says so."""
    usual = dict.fromkeys(SAMPLE_NAMES, 0.0) | {
        "limit_margin": 0.5,
        "velocity_ratio": 0.2,
        "manipulability": 0.1,
        "sampled_grasps": 60.0,
        "reachable_grasps": 20.0,
    }
    assert set(columns) <= set(usual)
    return np.array([np.broadcast_to((usual | columns)[name], n) for name in SAMPLE_NAMES], float)


def test_every_metric_of_the_table_is_there_and_no_other():
    assert list(summarize(samples(4), closes=False)) == list(METRICS)


def test_shares_count_samples():
    result = summarize(
        samples(
            8,
            limit_margin=[0.1, -0.01, 0.0, 0.2, 0.3, -1e-9, -3.0, 0.1],
            velocity_ratio=[0.5, 1.0, 1.1, 0.0, 0.0, 0.0, 0.0, 0.0],
            grasp_position_error=[np.nan, np.nan, 0, 0, 0, 0, 0, 0],
        ),
        closes=False,
    )
    assert result["joint_limit_violation_percent"] == 37.5
    assert result["velocity_limit_violation_percent"] == 12.5
    assert result["no_grasp_percent"] == 25.0
    assert result["limit_margin_min_deg"] == pytest.approx(np.degrees(-3.0))


def test_distances_and_manipulability_in_their_units():
    result = summarize(
        samples(
            4,
            p_HO_x=[0.0, 0.03, 0.0, 0.3],
            p_HO_y=[0.0, 0.04, 0.02, 0.0],
            p_HO_z=[0.01, 0.0, 0.0, 0.4],
            manipulability=[0.1, 0.2, 0.1, 0.2],
            p_WO_x=[0, 0, 0, 0.5],
            p_WO_y=[0, 0, 0, -0.1],
            p_WO_z=[0, 0, 0, 0.7],
        ),
        closes=False,
    )
    assert result["gripper_object_distance_cm_mean"] == pytest.approx((1 + 5 + 2 + 50) / 4)
    assert result["gripper_object_distance_cm_median"] == pytest.approx(3.5)
    assert result["manipulability_mean"] == pytest.approx(0.15)
    assert [result[f"object_end_{axis}_m"] for axis in "xyz"] == [0.5, -0.1, 0.7]


def test_grasp_errors_are_those_of_the_approach():
    """Samples without a grasp, and those with fingers on the object, do not count."""
    result = summarize(
        samples(
            6,
            phase=[A, A, A, A, C, L],
            grasp_position_error=[np.nan, 0.05, 0.01, 0.002, 0.0, 0.0],
            grasp_angle_error=[np.nan, 0.3, 0.2, 0.1, 0.0, 0.0],
            tracked_position_error=[np.nan, 0.003, 0.002, 0.001, 0.1, 0.1],
        ),
        closes=True,
    )
    assert result["grasp_position_error_mm_median"] == pytest.approx(10.0)
    assert result["grasp_angle_error_deg_median"] == pytest.approx(np.degrees(0.2))
    assert result["tracked_position_error_mm_median"] == pytest.approx(2.0)


def test_without_any_grasp_there_is_no_error_to_report():
    nan = [np.nan] * 3
    result = summarize(samples(3, grasp_position_error=nan, grasp_angle_error=nan), closes=True)
    assert result["grasp_position_error_mm_median"] is None
    assert result["grasp_angle_error_deg_median"] is None
    assert result["no_grasp_percent"] == 100.0
    assert result["grasp_held"] is False
    assert result["cause"] == "never_settled"
    assert result["slip_mm"] is None and result["lift_cm"] is None


PHASES = [A, C, L, S, H, H, D]


@pytest.mark.parametrize(
    ("p_HO_x", "phase", "held", "slip"),
    [
        # The way to the object and the squeeze are not slip.
        ([0.5, 0.1, 0.010, 0.011, 0.010, 0.010, 0.010], PHASES, True, 1.0),
        ([0.0, 0.0, 0.0, 0.0, 0.009, 0.0, 0.0], PHASES, True, 9.0),
        ([0.0, 0.0, 0.0, 0.0, 0.011, 0.0, 0.0], PHASES, False, 11.0),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.6], PHASES, False, 600.0),
        # The run ended before the hold did.
        ([0.0] * 7, [A, C, C, C, L, S, H], False, 0.0),
        ([0.0] * 7, [A, A, A, A, C, C, C], False, None),
        # Fingers that closed on nothing, and the second try.
        ([0.5, 0.4, 0.5, 0.0, 0.001, 0.002, 0.0], [A, C, A, C, L, H, D], True, 1.0),
    ],
)
def test_held_is_done_and_within_a_centimetre(p_HO_x, phase, held, slip):
    result = summarize(samples(7, p_HO_x=p_HO_x, phase=phase), closes=True)
    assert result["grasp_held"] is held
    assert result["slip_mm"] == (None if slip is None else pytest.approx(slip))
    assert (result["cause"] is None) is held


def test_what_is_not_given_is_not_told():
    result = summarize(samples(3), closes=False)
    for name in ("acceleration_limit_violation_percent", "obstacle_distance_min_mm"):
        assert result[name] is None
    assert result["self_collision_percent"] is None and result["torque_peak_percent"] is None
    velocity = np.zeros((3, 7))
    velocity[1, 2] = 2.0 * IIWA_7.velocity_limits[2]
    result = summarize(
        samples(3),
        closes=False,
        limits=limit_metrics(0.005 * np.cumsum(velocity, axis=0), velocity, 0.005, 0.005),
        obstacle_distance=np.array([0.3, 0.02, 0.1]),
    )
    assert result["velocity_limit_violation_percent"] == pytest.approx(100.0 / 3.0)
    # Up in one tick, down in the next.
    assert result["acceleration_limit_violation_percent"] == pytest.approx(200.0 / 3.0)
    assert result["obstacle_distance_min_mm"] == pytest.approx(20.0)
    nothing = summarize(samples(3), closes=False, obstacle_distance=np.full(3, np.inf))
    assert nothing["obstacle_distance_min_mm"] is None


def test_the_hand_on_the_object_tells_a_switch_of_grasp():
    """A hand at a grasp that stands 4 cm beside where it stood before."""
    n = 200
    y = np.where(np.arange(n) < 120, 0.0, 0.04)
    turned = {"r_OH_z": np.pi / 2}  # so that the hand's y is the object's -x
    result = summarize(samples(n, p_HO_y=y, **turned), closes=False)
    assert result["grasp_switches"] == 1.0
    assert result["tracked_percent"] == 100.0 and result["settling_time_s"] == 0.0
    turning = np.where(np.arange(n) < 120, 0.0, np.deg2rad(40.0))
    assert summarize(samples(n, r_OH_x=turning), closes=False)["grasp_switches"] == 1.0


def test_slip_is_the_way_in_space_not_the_change_of_distance():
    """An object that goes round the contact centre at a constant distance has slipped too."""
    result = summarize(
        samples(3, phase=[L, H, D], p_HO_x=[0.03, 0.0, 0.0], p_HO_y=[0.0, 0.03, 0.03]), closes=True
    )
    assert result["slip_mm"] == pytest.approx(30.0 * np.sqrt(2.0))
    assert result["grasp_held"] is False


def test_a_turn_in_the_hand_is_no_hold():
    """The object's origin stays where it is, and the object turns about it."""
    turned = np.where(np.arange(7) < 4, 0.0, np.deg2rad([16.0] * 7))
    result = summarize(samples(7, phase=PHASES, r_OH_y=turned), closes=True)
    assert result["turn_deg"] == pytest.approx(16.0)
    assert result["slip_mm"] == pytest.approx(0.0, abs=1e-9)
    assert result["grasp_held"] is False and result["cause"] == "dropped"
    in_hand = truth(7, touched=True)
    result = summarize(samples(7, phase=PHASES, r_OH_y=turned), closes=True, truth=in_hand)
    assert result["cause"] == "slipped"


def truth(n, path=None, contact=(0.0, 0.0, 0.0, 0.0), *, touched=False, broke_off=False):
    path = np.tile(np.eye(4), (n, 1, 1)) if path is None else path
    return ObjectTruth(path, np.array(contact), 0.08, touched, broke_off)


def test_pushed_is_told_from_the_path_and_names_the_cause():
    n = 40
    path = np.tile(np.eye(4), (n, 1, 1))
    path[:, 0, 3] = 0.5
    x = np.where(np.arange(n) < 30, 0.5, 0.5 - 0.06)
    turn = np.where(np.arange(n) < 30, 0.0, 0.3)
    run = samples(n, phase=A, p_WO_x=x, r_WO_z=turn)
    result = summarize(run, closes=True, truth=truth(n, path, [0.8, 0.2, 7.0, 0.9]))
    assert result["pushed_mm"] == pytest.approx(60.0)
    assert result["pushed_deg"] == pytest.approx(np.rad2deg(0.3))
    assert result["contact_force_peak_n"] == 7.0
    assert result["contact_time_percent"] == pytest.approx(25.0)
    assert result["cause"] == "pushed_away"
    assert summarize(run, closes=False)["pushed_mm"] is None


def test_a_simulation_that_broke_off_held_nothing():
    held = summarize(samples(7, phase=PHASES), closes=True, truth=truth(7, touched=True))
    assert held["grasp_held"] is True and held["cause"] is None
    broken = summarize(samples(7, phase=PHASES), closes=True, truth=truth(7, broke_off=True))
    assert broken["grasp_held"] is False and broken["cause"] == "broke_off"
    follows = summarize(samples(7, phase=A), closes=False, truth=truth(7, broke_off=True))
    assert follows["cause"] is None


def test_of_grasps_that_nobody_knows_nothing_is_told():
    unknown = dict.fromkeys(
        ("sampled_grasps", "reachable_grasps", "view_age"), np.nan
    ) | dict.fromkeys(("grasp_position_error", "grasp_angle_error"), np.nan)
    result = summarize(samples(200, phase=A, **unknown), closes=True)
    told = ("no_grasp_percent", "tracked_percent", "settling_time_s", "grasp_switches")
    assert [result[name] for name in (*told, "grasp_age_s_mean")] == [None] * 5
    assert (result["grasp_held"], result["cause"]) == (False, "never_settled")


def test_the_age_is_that_of_grasps_in_the_approach():
    """Not without grasps, not without a view, not after the fingers closed."""
    age = [9.0, np.nan, 0.2, 0.3, 0.7, 5.0]
    reachable = [0, 3, 3, 3, 3, 1]
    run = samples(6, phase=[A, A, A, A, A, C], view_age=age, reachable_grasps=reachable)
    result = summarize(run, closes=True)
    assert result["grasp_age_s_mean"] == pytest.approx(0.4)
    assert result["grasp_age_s_max"] == 0.7
    nothing = summarize(samples(3, view_age=np.nan), closes=True)
    assert nothing["grasp_age_s_mean"] is nothing["grasp_age_s_max"] is None


def test_lift_is_the_rise_since_the_object_was_let_go():
    result = summarize(
        samples(5, phase=[A, C, L, H, D], p_WO_z=[0.3, 0.5, 0.55, 0.6, 0.64]), closes=True
    )
    assert result["lift_cm"] == pytest.approx(9.0)


def test_an_open_gripper_holds_nothing_and_drops_nothing():
    result = summarize(samples(3), closes=False)
    assert [result[name] for name in ("grasp_held", "cause", "slip_mm", "lift_cm")] == [None] * 4


@pytest.mark.parametrize(("closes", "held"), [(True, False), (False, None)])
def test_no_samples_give_no_figures(closes, held):
    result = summarize(np.empty((len(SAMPLE_NAMES), 0)), closes=closes)
    assert list(result) == list(METRICS)
    assert result.pop("grasp_held") is held
    assert result.pop("cause") == ("broke_off" if closes else None)
    assert set(result.values()) == {None}


# --------------------------------------------------------------------------- the samples themselves


def sample(q, v=None, grasps=None, X_WO=None):
    dut = Metrics(ParallelGripper())
    context = dut.CreateDefaultContext()
    v = np.zeros(7) if v is None else v
    dut.GetInputPort("state").FixValue(context, np.concatenate([q, v]))
    dut.GetInputPort("object_pose").FixValue(context, X_WO or RigidTransform([0.5, 0.0, 0.5]))
    dut.GetInputPort("phase").FixValue(context, [0.0])
    dut.GetInputPort("grasps").FixValue(context, grasps or GraspSet.empty())
    dut.GetInputPort("sampled_grasps").FixValue(context, GraspSet.empty())
    return dict(zip(SAMPLE_NAMES, dut.get_output_port().Eval(context), strict=True))


READY = np.deg2rad([0, 30, 0, -60, 0, 90, 0])


def test_a_harmless_posture_is_harmless():
    x = sample(READY)
    assert x["limit_margin"] == pytest.approx(np.min(IIWA_7.upper - np.abs(READY)))
    assert x["velocity_ratio"] == 0.0
    assert np.isnan(x["grasp_position_error"])
    assert [x[f"p_WO_{axis}"] for axis in "xyz"] == [0.5, 0.0, 0.5]


def test_speeds_are_measured_against_their_own_limits():
    v = 0.1 * IIWA_7.velocity_limits
    v[4] = -1.5 * IIWA_7.velocity_limits[4]
    assert sample(READY, v)["velocity_ratio"] == pytest.approx(1.5)
