"""What is wider than the hand in every direction, by the side of it that a camera sees."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from feasigrasp.models.grasps.filter import is_wider

RNG = np.random.default_rng(0)
OPENING, AWAY = 0.08, 0.5
SIDES = RNG.integers(0, 3, 4000)
FACING = np.eye(3)[SIDES]
BOX = RNG.uniform(-0.5, 0.5, (4000, 3)) * (1 - FACING) + 0.5 * FACING  # three faces


def ball(radius):
    """Points and normals where these face a camera at (AWAY, 0, 0)."""
    normals = RNG.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = normals[normals[:, 0] > radius / AWAY]
    return radius * normals + RNG.normal(0.0, 5e-4, normals.shape), normals


def bowl(radius):
    """The same shell open to the camera: its inside."""
    points, normals = ball(radius)
    return points * [-1.0, 1.0, 1.0], normals * [1.0, -1.0, -1.0]


def box(*sides):
    return BOX * sides, FACING


def dented():
    points, normals = ball(0.15)
    points[:200] *= 0.6
    return points, normals


@pytest.mark.parametrize("surface, wider", [
    (ball(0.15), True),
    (ball(0.12), True),  # 9 cm deep, 23 cm across
    (ball(0.05), False),
    (bowl(0.15), False),
    (dented(), False),
    (box(0.2, 0.2, 0.2), True),
    (box(0.2, 0.2, 0.07), False),
    (box(0.3, 0.3, 0.005), False),
    ((np.zeros((50, 3)), np.eye(3)[[0] * 50]), False),
    ((BOX[:5], FACING[:5]), False)])  # fmt: skip
def test_wider(surface, wider):
    points, normals = surface
    for turn in Rotation.random(3, random_state=1).as_matrix():
        assert is_wider(points @ turn.T + 1.0, normals @ turn.T, OPENING) is wider
