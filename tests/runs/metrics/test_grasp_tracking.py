"""When a hand has settled, and when it has changed its grasp, from ways made by hand."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.runs.metrics.run_metrics import tracking_metrics

PERIOD = 0.1
HERE = np.eye(4)


def pose(x=0.0, turn=0.0):
    return se3.make_pose(se3.so3_exp([0.0, turn, 0.0]), [x, 0.0, 0.0])


def judge(position, *, angle=0.0, X_OH=HERE, following=True):
    n = len(position)
    return tracking_metrics(
        np.array(position, dtype=float),
        np.broadcast_to(angle, n).astype(float),
        np.broadcast_to(X_OH, (n, 4, 4)),
        np.broadcast_to(following, n),
        PERIOD,
    )


FAR, NEAR = 0.1, 0.01


def test_a_hand_settles_when_it_stays():
    way = [FAR] * 4 + [NEAR] * 2 + [FAR] * 2 + [NEAR] * 30
    found = judge(way)
    assert found["settling_time_s"] == pytest.approx(0.8)  # not 0.4: it left again
    assert found["tracked_percent"] == 100.0  # all that is later than 2 s
    assert found["grasp_switches"] == 0.0


@pytest.mark.parametrize(("position", "angle"), [(0.016, 0.0), (0.0, 0.15), (np.nan, np.nan)])
def test_near_is_fifteen_millimetres_and_eight_degrees(position, angle):
    found = judge([position] * 30, angle=angle)
    assert found == {"tracked_percent": 0.0, "settling_time_s": None, "grasp_switches": 0.0}
    assert judge([0.014] * 30, angle=0.13)["tracked_percent"] == 100.0


def test_the_share_is_that_of_the_time_after_two_seconds():
    assert judge([FAR] * 20 + [NEAR] * 30 + [FAR] * 10)["tracked_percent"] == 75.0
    assert judge([NEAR] * 20)["tracked_percent"] is None


def test_only_the_approach_counts():
    following = np.arange(40) < 30
    found = judge([FAR] * 25 + [NEAR] * 15, following=following)
    assert found["tracked_percent"] == 50.0
    # Half a second or not: it settled, since it closed its fingers.
    short = judge([FAR] * 28 + [NEAR] * 12, following=following)
    assert short["settling_time_s"] == pytest.approx(2.8)
    assert judge([FAR] * 28 + [NEAR] * 2 + [FAR] * 10)["settling_time_s"] is None


@pytest.mark.parametrize(
    ("other", "switches"),
    [
        (pose(0.02), 0.0),
        (pose(0.04), 1.0),
        (pose(0.0, np.deg2rad(25.0)), 0.0),
        (pose(0.0, np.deg2rad(35.0)), 1.0),
        (pose(0.0, np.pi), 1.0),  # the other way round is another way to stand
    ],
)
def test_another_place_on_the_object_is_another_grasp(other, switches):
    way = [NEAR] * 10 + [FAR] * 5 + [NEAR] * 10
    X_OH = np.array([HERE] * 12 + [other] * 13)
    assert judge(way, X_OH=X_OH)["grasp_switches"] == switches


def test_there_and_back_are_two_switches_and_passing_by_is_none():
    three = [NEAR] * 10 + [FAR] * 2 + [NEAR] * 10 + [FAR] * 2 + [NEAR] * 10
    X_OH = np.array([HERE] * 11 + [pose(0.1)] * 12 + [HERE] * 11)
    assert judge(three, X_OH=X_OH)["grasp_switches"] == 2.0
    passing = [NEAR] * 10 + [FAR] * 2 + [NEAR] * 3 + [FAR] * 9 + [NEAR] * 10
    assert judge(passing, X_OH=X_OH)["grasp_switches"] == 0.0


def test_a_grasp_that_is_taken_again_is_the_same():
    way = [NEAR] * 10 + [FAR] * 30 + [NEAR] * 10
    assert judge(way)["grasp_switches"] == 0.0


def test_a_slow_drift_over_the_object_counts_once_it_has_gone_far():
    X_OH = np.array([pose(0.001 * k) for k in range(50)])
    assert judge([NEAR] * 50, X_OH=X_OH)["grasp_switches"] == 1.0
