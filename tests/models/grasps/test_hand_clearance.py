"""Whether hands are free: what was seen is never left to the network, what was invented is."""

import numpy as np
import pytest

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.hand_clearance import (
    FAR,
    HOPEFUL,
    MARGIN,
    hand_freedom,
    observed_clearance,
)
from feasigrasp.models.grasps.success_probability import UNOBSERVED_CLEARANCE, odds, probability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.completion import complete_shape

RADIUS = 0.025
CAMERA = np.array([0.0, 0.0, 0.5])
#: The palm is so near to the middle between the pads that it is inside the ball.
GRIPPER = ParallelGripper(heel=-0.02)


@pytest.fixture(scope="module")
def field():
    """A ball that was seen from +z alone."""
    points = RADIUS * sphere_points(4000, 1.0)
    front = points[points @ CAMERA > 1.2 * RADIUS**2]
    return complete_shape(FusedCloud.empty(0.003, smooth=True).merged(front, CAMERA))


def grasp(approach):
    """At the ball's middle, with the palm in front of or behind it."""
    x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, approach])
    X_OG = np.eye(4)
    X_OG[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return X_OG


def judged(field, approach, contact, learned):
    grasps = GraspSet(grasp(approach)[None], [2 * RADIUS], [contact])
    free, certain = hand_freedom(field, grasps, np.array([learned]), GRIPPER, 0)
    return bool(free[0]), float(certain[0])


def test_a_hand_in_invented_surface_is_left_to_the_network(field):
    free, certain = judged(field, 1.0, 0.95, 0.95)
    assert free
    assert certain == probability(UNOBSERVED_CLEARANCE, odds(np.array([0.95])))
    assert judged(field, 1.0, 0.95, 0.97)[1] > certain


@pytest.mark.parametrize(
    ("contact", "learned"),
    [(0.95, np.nan), (0.95, 0.9 * HOPEFUL), (0.9 * HOPEFUL, 0.95)],
    ids=["no opinion", "hand not free", "no contact"],
)
def test_without_hope_it_collides(field, contact, learned):
    assert not judged(field, 1.0, contact, learned)[0]


def test_surface_that_was_seen_is_there_whatever_the_network_says(field):
    assert not judged(field, -1.0, 0.99, 0.99)[0]


def test_surface_counts_as_far_where_nothing_was_seen_near_it(field):
    X_OG = np.stack([grasp(1.0), grasp(-1.0)])
    everything, seen = (observed_clearance(field, X_OG, GRIPPER, d) for d in (np.inf, 0.01))
    assert everything.max() < 0.0
    assert seen[1] < 0.0 < MARGIN < seen[0] <= FAR
