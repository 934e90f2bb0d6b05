"""An object stays in the camera's image while the arm moves."""

import numpy as np
import pytest

from feasigrasp.models.control.planning.in_view import velocity_in_view
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

X_FG = ParallelGripper().X_FG
#: A camera beside the palm that leans towards the pads.
X_HC = se3.make_pose(se3.so3_exp([np.deg2rad(25.0), 0.0, 0.0]), [0.0, 0.085, -0.105])
RADIUS, RATE, STEP = 0.05, 3.0, 1e-6


def camera(q):
    return forward_kinematics(q, X_FG) @ X_HC


def room_in_view(X_WC, p_W, radius):
    """Angle from the object's middle to the edge of the cone, as the module says, [rad]."""
    x, y, z, _ = se3.inverse(X_WC) @ [*p_W, 1.0]
    apparent = np.rad2deg(np.arcsin(min(1.0, radius / np.linalg.norm([x, y, z]))))
    edge = 22.0 + 0.8 * max(apparent - 18.0, 0.0)
    return np.deg2rad(edge) - np.arctan2(np.hypot(x, y), z)


def some(seed):
    """A configuration, an object somewhere before the camera, its velocity, and a wish."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, IIWA_7.joints)
    X_WC = camera(q)
    p_W = X_WC[:3, 3] + X_WC[:3, :3] @ [*(0.12 * rng.standard_normal(2)), 0.3]
    return q, p_W, 0.1 * rng.standard_normal(3), 0.5 * rng.standard_normal(IIWA_7.joints)


def rate_of_room(q, qd, p_W, v_W):
    """How the room in view changes, by differences."""
    after, before = (room_in_view(camera(q + h * qd), p_W + h * v_W, RADIUS) for h in (STEP, -STEP))
    return (after - before) / (2.0 * STEP)


def kept(q, qd, p_W, v_W):
    return velocity_in_view(qd, q, X_FG, camera(q), p_W, v_W, RADIUS)


@pytest.mark.parametrize("seed", range(20))
def test_the_edge_is_approached_no_faster_than_its_distance_allows(seed):
    q, p_W, v_W, qd = some(seed)
    v_W *= 0.29 / np.linalg.norm(v_W)  # not quick
    room = room_in_view(camera(q), p_W, RADIUS)
    after = kept(q, qd, p_W, v_W)
    least = min(-RATE * room, 1.0)
    wanted = rate_of_room(q, qd, p_W, v_W)
    if wanted >= least:
        np.testing.assert_array_equal(after, qd)
    else:
        assert rate_of_room(q, after, p_W, v_W) == pytest.approx(least, abs=1e-5)


@pytest.mark.parametrize(("speed", "wider"), [(0.2, 0.0), (0.3, 0.0), (0.4, 6.0), (0.6, 12.0)])
def test_a_quick_object_may_be_nearer_to_the_edge(speed, wider):
    q, p_W, v_W, qd = some(1)
    v_W *= speed / np.linalg.norm(v_W)
    qd = -50.0 * qd  # whatever is wanted, it is too much
    if rate_of_room(q, qd, p_W, v_W) > 0.0:
        qd = -qd
    room = room_in_view(camera(q), p_W, RADIUS) + np.deg2rad(wider)
    least = min(-RATE * room, 1.0)
    assert rate_of_room(q, qd, p_W, v_W) < least
    assert rate_of_room(q, kept(q, qd, p_W, v_W), p_W, v_W) == pytest.approx(least, abs=1e-5)


def test_it_is_the_nearest_such_velocity_in_units_of_the_speed_limits():
    q, p_W, v_W, qd = some(0)
    after = kept(q, qd, p_W, v_W)
    change = (after - qd) / IIWA_7.velocity_limits
    least = rate_of_room(q, after, p_W, v_W)
    assert np.linalg.norm(change) > 0.01
    # Any other velocity that is as good is farther away.
    rng, others = np.random.default_rng(1), []
    rows = np.array([rate_of_room(q, e, p_W, np.zeros(3)) for e in np.eye(IIWA_7.joints)])
    for _ in range(50):
        aside = rng.standard_normal(IIWA_7.joints)
        aside -= (aside @ rows) / (rows @ rows) * rows
        other = after + 0.1 * aside
        assert rate_of_room(q, other, p_W, v_W) == pytest.approx(least, abs=1e-4)
        others.append(np.linalg.norm((other - qd) / IIWA_7.velocity_limits))
    assert min(others) > np.linalg.norm(change)


def test_a_near_object_may_be_farther_off_the_axis():
    """Moving on outwards is kept from the far one, and the near one goes on as it was."""
    q, qd = some(0)[0], np.zeros(IIWA_7.joints)
    X_WC, angle = camera(q), np.deg2rad(28.0)
    n = X_WC[:3, :3] @ [np.sin(angle), 0.0, np.cos(angle)]
    far, near = (X_WC[:3, 3] + distance * n for distance in (0.6, 0.1))
    assert np.abs(kept(q, qd, far, np.zeros(3))).max() > 0.01
    np.testing.assert_array_equal(kept(q, qd, near, np.zeros(3)), qd)


def test_what_is_on_the_axis_or_unknown_changes_nothing():
    q, _, v_W, qd = some(0)
    X_WC = camera(q)
    np.testing.assert_array_equal(kept(q, qd, X_WC[:3, 3] + 0.3 * X_WC[:3, 2], v_W), qd)
    np.testing.assert_array_equal(kept(q, qd, np.full(3, np.nan), v_W), qd)
