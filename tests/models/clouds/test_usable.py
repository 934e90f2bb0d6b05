"""What of a view can be used, beside what was seen before."""

import numpy as np
import pytest

from feasigrasp.models.clouds.usable import ViewFault, usable_points
from feasigrasp.models.geometry.points import sphere_points

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
