"""Pursuit of a strand: in time with the slowest joint, and round the object on the way."""

import numpy as np
import pytest

from feasigrasp.models.control.task.pursuit import PursuitOptions, pursuit_velocity
from feasigrasp.models.control.task.reference import CandidateReference
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

X_FG = ParallelGripper().X_FG
OPTIONS = PursuitOptions()
#: The hand's distance from the object's origin [m].
DISTANCE = 0.3


def hand(q):
    return forward_kinematics(q, X_FG)[:3, 3]


def reference(q, radius, direction, qd=None):
    """A reference whose hand pose is this far from the object's origin."""
    X_OT = se3.make_pose(se3.so3_exp([0.3, -2.0, 0.5]), radius * direction)
    return CandidateReference(q, np.zeros(7) if qd is None else qd, X_OT, False)


def scenes(count, seed=0):
    """A configuration, an object at `DISTANCE` from the hand, its twist, and a direction."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        # Away from the limits, stretched arms and wrists, where any velocity can be had.
        q = rng.uniform(-0.5, 0.5, 7) + [0.0, 0.6, 0.0, -1.4, 0.0, 1.0, 0.0]
        unit = rng.normal(size=(2, 3))
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        X_WO = se3.make_pose(se3.so3_exp(rng.normal(size=3)), hand(q) + DISTANCE * unit[0])
        yield q, X_WO, rng.normal(scale=0.1, size=6), unit[1]


def approach_speed(q, qd, X_WO, V_WO):
    """How fast the hand comes nearer to the object's origin [m/s], by a central difference."""
    step = 1e-6
    before, after = (
        np.linalg.norm(hand(q + s * qd) - X_WO[:3, 3] - s * V_WO[3:]) for s in (-step, step)
    )
    return (before - after) / (2 * step)


@pytest.mark.parametrize(
    ("radius", "expected"),
    [(0.0, 0.5), (0.1, 0.5), (0.25, 0.3), (0.3, 0.0), (0.35, -0.3), (0.5, -0.5)],
)
def test_a_hand_with_time_goes_to_the_sphere_of_its_reference_from_either_side(radius, expected):
    """The last joint has a long way, the others none: the hand is free to move."""
    asked = np.clip(OPTIONS.gain * (DISTANCE - radius), -OPTIONS.speed, OPTIONS.speed)
    assert expected == pytest.approx(asked)
    for q, X_WO, V_WO, direction in scenes(20):
        q_ref = q + [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.5]
        to = reference(q_ref, radius, direction)
        qd = pursuit_velocity(q, to, X_WO, V_WO, X_FG, OPTIONS)
        speed = approach_speed(q, qd, X_WO, V_WO)
        # Not quite, since joint motion has a price, and the object's own has to be followed.
        assert speed == pytest.approx(expected, abs=0.1)
        assert qd[6] > 0.5 * OPTIONS.speed_share * IIWA_7.velocity_limits[6]


def test_only_the_distance_counts_not_where_on_the_sphere_the_reference_is():
    for q, X_WO, V_WO, direction in scenes(5, seed=1):
        q_ref = q + [0.0, 1.5, 0.0, 0.0, 0.0, 0.0, -2.0]
        commands = [
            pursuit_velocity(q, reference(q_ref, 0.15, d), X_WO, V_WO, X_FG, OPTIONS)
            for d in (direction, -direction)
        ]
        np.testing.assert_allclose(commands[0], commands[1], atol=1e-9)


@pytest.mark.parametrize("time", [0.29, 0.2, 0.1, 1e-3])
def test_short_ways_are_the_synchronised_motion_exactly(time):
    """All joints arrive together, wherever the object is."""
    limit = OPTIONS.speed_share * IIWA_7.velocity_limits
    rng = np.random.default_rng(2)
    for q, X_WO, V_WO, direction in scenes(10, seed=2):
        way = limit * rng.uniform(-1.0, 1.0, 7)
        way *= time / np.max(np.abs(way) / limit)
        qd_ref = rng.uniform(-0.1, 0.1, 7)
        to = reference(q + way, 0.1, direction, qd_ref)
        qd = pursuit_velocity(q, to, X_WO, V_WO, X_FG, OPTIONS)
        np.testing.assert_allclose(qd - qd_ref, way * min(OPTIONS.gain, 1.0 / time), atol=1e-9)


def test_the_hand_goes_round_the_object_and_arrives_in_time():
    """From one side to the other; straight in the joints, it would go through the middle."""
    start = np.array([-0.35, 0.6, 0.0, -1.4, 0.0, 1.0, -1.2])
    end = start * [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0]
    X_WO = se3.make_pose(np.eye(3), 0.5 * (hand(start) + hand(end)))

    def distance(q):
        return np.linalg.norm(hand(q) - X_WO[:3, 3])

    to = reference(end, distance(end), np.array([1.0, 0.0, 0.0]))
    least = np.max(np.abs(end - start) / (OPTIONS.speed_share * IIWA_7.velocity_limits))
    q, step, way = start.copy(), 0.005, []
    for _ in range(round((least + 0.5) / step)):
        q = q + step * pursuit_velocity(q, to, X_WO, np.zeros(6), X_FG, OPTIONS)
        way.append(distance(q))
    straight = [distance(start + share * (end - start)) for share in np.linspace(0.0, 1.0, 100)]
    assert min(straight) < 0.05
    assert min(way) > 0.15
    np.testing.assert_allclose(q, end, atol=0.02)
