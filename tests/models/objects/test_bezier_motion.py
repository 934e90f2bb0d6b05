"""Bezier motions against finite differences, and what they promise: a box, a speed, rests."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.motion import ACCELERATION, BezierMotion, bezier_legs

CENTER, SIZE = np.array([0.5, 0.0, 0.55]), np.array([0.2, 0.36, 0.16])
TIMES = np.linspace(0.0, 40.0, 4001)


def motion(speed=0.3, stop=0.5, seed=0, **changes):
    legs = bezier_legs(np.random.default_rng(seed), CENTER, SIZE)
    about = {"spin_axis": np.array([1.0, -2.0, 0.5]), "spin": 0.7}
    return BezierMotion(legs, speed, stop, **{**about, **changes})


@pytest.fixture(scope="module")
def states():
    m = motion()
    return [m.state(t) for t in TIMES]


def test_velocity_and_acceleration_by_finite_differences():
    m, h = motion(R_WO=se3.so3_exp([0.3, 0.9, -1.4])), 1e-6
    jumps = 0
    for t in TIMES[1:-1:31]:
        before, after = m.pose(t - h), m.pose(t + h)
        V, a = m.velocity(t), m.state(t)[2]
        np.testing.assert_allclose(V[3:], (after - before)[:3, 3] / (2 * h), atol=1e-5)
        angular = se3.so3_log(after[:3, :3] @ before[:3, :3].T) / (2 * h)
        np.testing.assert_allclose(V[:3], angular, atol=1e-6)
        # The acceleration jumps where gaining speed ends, and where braking begins and ends.
        change = (m.velocity(t + h) - m.velocity(t - h))[3:] / (2 * h)
        jumps += not np.allclose(a, change, atol=1e-3)
    assert jumps <= 1


def test_the_path_stays_in_its_box_and_uses_it(states):
    p = np.array([X[:3, 3] for X, _, _ in states])
    assert (np.abs(p - CENTER) <= 0.5 * SIZE + 1e-5).all()
    assert (np.ptp(p, axis=0) > 0.5 * SIZE).all()


@pytest.mark.parametrize("speed", [0.05, 0.3, 0.6])
def test_the_speed_is_reached_kept_and_never_exceeded(speed):
    m = motion(speed)
    speeds = np.array([np.linalg.norm(m.velocity(t)[3:]) for t in TIMES[::4]])
    assert speeds.max() == pytest.approx(speed, rel=2e-3)
    assert np.mean(speeds > 0.98 * speed) > (0.15 if speed > 0.5 else 0.5)


def test_it_rests_between_legs_and_goes_on_another_way(states):
    still = np.array([np.linalg.norm(V[3:]) < 1e-9 for _, V, _ in states])
    begin = np.flatnonzero(still[1:] & ~still[:-1]) + 1
    end = np.flatnonzero(~still[1:] & still[:-1])
    rests = (end[end > begin[0]][: len(begin)] - begin[: len(end[end > begin[0]])]) * TIMES[1]
    assert len(rests) > 10
    np.testing.assert_allclose(rests, 0.5, atol=2.1 * TIMES[1])
    turned = []
    for first, last in zip(begin, end[end > begin[0]], strict=False):
        v_in, v_out = states[first - 3][1][3:], states[last + 3][1][3:]
        turned.append(v_in @ v_out / np.linalg.norm(v_in) / np.linalg.norm(v_out))
    assert np.median(turned) < 0.0  # back rather than on


def test_along_the_path_it_gains_and_loses_speed_evenly():
    m, dt = motion(0.6, 0.5), 1e-3
    speeds = np.array([np.linalg.norm(m.velocity(t)[3:]) for t in np.arange(0.0, 10.0, dt)])
    change = np.diff(speeds) / dt
    assert np.abs(change).max() == pytest.approx(ACCELERATION, rel=1e-2)


def test_the_seed_decides_the_path():
    np.testing.assert_array_equal(motion(seed=3).legs, motion(seed=3).legs)
    assert np.abs(motion(seed=3).legs - motion(seed=4).legs).max() > 0.01


def test_it_is_closed():
    legs = motion().legs
    np.testing.assert_array_equal(legs[:, 3], np.roll(legs[:, 0], -1, axis=0))
