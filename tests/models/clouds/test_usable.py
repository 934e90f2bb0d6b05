"""What of a view can be used, beside what was seen before."""

import numpy as np
import pytest

from feasigrasp.models.clouds.checks import ViewFault, of_one_depth, usable_points
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.geometry.se3 import make_pose, so3_exp

P_OC = np.array([0.0, 0.0, 0.35])
KNOWN = sphere_points(800, 0.04)
CAP = KNOWN[KNOWN[:, 2] > 0.0]


def wall(distance: float, size: float = 0.6, n: int = 60) -> np.ndarray:
    """Points of a plane across the line of sight, so far behind O."""
    x, y = np.meshgrid(np.linspace(-size / 2, size / 2, n), np.linspace(-size / 2, size / 2, n))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -distance)])


def test_background_in_the_mask_is_left_out():
    kept, fault, _ = usable_points(np.concatenate([CAP, wall(0.2, 0.15, 15)]), P_OC, 30, KNOWN)
    assert fault is None
    assert kept[:, 2].min() >= 0.0 and len(kept) >= 0.9 * len(CAP)


def test_nothing_but_background_is_no_view_and_says_so():
    kept, fault, detail = usable_points(wall(0.3), P_OC, 30, KNOWN)
    assert fault is ViewFault.BACKGROUND
    assert "the object has 0.13" in detail


@pytest.mark.parametrize("away", [0.05, 0.3])
def test_an_object_that_is_elsewhere_is_seen_there(away):
    """It is for others to say that the pose is wrong; near or far, it must not be lost."""
    moved = CAP + [away, 0.0, 0.0]
    kept, fault, _ = usable_points(moved, P_OC, 30, KNOWN)
    assert fault is None
    assert kept[:, 0].mean() == pytest.approx(away, abs=0.01)


def test_of_a_first_view_nothing_is_left_out():
    kept, fault, _ = usable_points(CAP + [0.3, 0.0, 0.0], P_OC, 30, np.empty((0, 3)))
    assert fault is None and len(kept) >= 0.95 * len(CAP)


def test_points_in_the_camera_are_no_object_that_is_elsewhere():
    """Depths that are all zero contradict nothing."""
    black = np.tile(P_OC, (500, 1)) + 1e-7 * np.random.default_rng(0).standard_normal((500, 3))
    for known in (KNOWN, np.empty((0, 3))):
        assert usable_points(black, P_OC, 30, known)[1] is ViewFault.NO_SURFACE


def test_one_depth_everywhere_is_not_measured_but_a_plane_may_be():
    X_WC = make_pose(so3_exp(np.array([0.4, -2.0, 0.3])), np.array([0.3, -0.1, 0.8]))
    plane_C = wall(0.0, 0.1, 20) + [0.0, 0.0, 0.4]
    noise = 5e-4 * np.random.default_rng(1).standard_normal(len(plane_C))
    tilted = plane_C @ so3_exp(np.array([0.01, 0.0, 0.0])).T
    noisy = plane_C * (1.0 + noise / 0.4)[:, None]
    for points_C, one in ((plane_C, True), (tilted, False), (noisy, False)):
        points_W = (points_C @ X_WC[:3, :3].T + X_WC[:3, 3]).astype(np.float32)
        assert of_one_depth(points_W, X_WC) is one
    assert not of_one_depth(np.empty((0, 3)), X_WC)
