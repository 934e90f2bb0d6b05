"""Merging of views against voxel means computed by a plain loop."""

import copy

import numpy as np
import pytest

from feasigrasp.models import se3
from feasigrasp.models.view_fusion import FusedCloud

VOXEL = 0.01


def plain_means(points, voxel_size):
    """Mean point of every voxel, by a dictionary."""
    voxels = {}
    for p in points:
        voxels.setdefault(tuple(np.floor(p / voxel_size).astype(int)), []).append(p)
    return np.array([np.mean(members, axis=0) for members in voxels.values()])


def ordered(points):
    return points[np.lexsort(points.T)]


@pytest.fixture
def cloud():
    return np.random.default_rng(0).uniform(-0.04, 0.04, (2000, 3))


def test_one_view_is_its_voxel_means(cloud):
    fused = FusedCloud.empty(VOXEL).merged(cloud, [0, 0, 1])
    expected = plain_means(cloud, VOXEL)
    assert len(expected) < 600  # several points share a voxel
    np.testing.assert_allclose(ordered(fused.points), ordered(expected), atol=1e-12)
    assert fused.views == 1


def test_a_second_view_counts_as_much_as_the_first(cloud):
    """However many pixels it has; voxels seen only once keep their point."""
    rng = np.random.default_rng(1)
    few = cloud[:300] + rng.normal(scale=1e-3, size=(300, 3))
    fused = FusedCloud.empty(VOXEL).merged(cloud, [0, 0, 1]).merged(few, [1, 0, 0])
    both = np.concatenate([plain_means(cloud, VOXEL), plain_means(few, VOXEL)])
    np.testing.assert_allclose(ordered(fused.points), ordered(plain_means(both, VOXEL)), atol=1e-12)
    assert fused.views == 2


def test_directions_point_to_the_camera(cloud):
    camera = np.array([0.3, -0.2, 0.6])
    fused = FusedCloud.empty(VOXEL).merged(cloud, camera)
    expected = camera - fused.points
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(fused.directions, axis=1), 1.0)
    # The mean of the pixels' directions, not the direction of the mean.
    assert np.einsum("ij,ij->i", fused.directions, expected).min() > np.cos(0.01)


def test_the_same_view_again_changes_nothing(cloud):
    once = FusedCloud.empty(VOXEL).merged(cloud, [0, 0, 1])
    twice = once.merged(cloud, [0, 0, 1])
    np.testing.assert_allclose(twice.points, once.points, atol=1e-12)
    np.testing.assert_allclose(twice.directions, once.directions, atol=1e-6)


def test_an_object_that_moves_with_its_cloud_gives_the_same_cloud(cloud):
    """Merging happens in the object frame, wherever object and camera are in the world."""
    rng = np.random.default_rng(2)
    reference = FusedCloud.empty(VOXEL).merged(cloud, [0, 0, 1]).merged(cloud[:500], [1, 0, 0])
    fused = FusedCloud.empty(VOXEL)
    for points, p_OC in ((cloud, [0, 0, 1, 1]), (cloud[:500], [1, 0, 0, 1])):
        X_WO = se3.random_pose(rng, 1)[0]
        p_WC = X_WO @ p_OC
        points_W = points @ X_WO[:3, :3].T + X_WO[:3, 3]
        X_OW = se3.inverse(X_WO)
        back = points_W @ X_OW[:3, :3].T + X_OW[:3, 3]
        fused = fused.merged(back, (X_OW @ p_WC)[:3])
    np.testing.assert_allclose(fused.points, reference.points, atol=1e-9)
    np.testing.assert_allclose(fused.directions, reference.directions, atol=1e-9)


def test_shifting_by_whole_voxels_shifts_the_result(cloud):
    shift = np.array([7, -3, 12]) * VOXEL
    fused = FusedCloud.empty(VOXEL).merged(cloud, [0, 0, 1])
    moved = FusedCloud.empty(VOXEL).merged(cloud + shift, np.array([0, 0, 1]) + shift)
    assert len(moved.points) == len(fused.points)
    np.testing.assert_allclose(moved.points, fused.points + shift, atol=1e-9)


def test_a_view_without_points_only_counts(cloud):
    once = FusedCloud.empty(VOXEL).merged(cloud, [0, 0, 1])
    after = once.merged(np.zeros((0, 3)), [0, 0, 1])
    np.testing.assert_array_equal(after.points, once.points)
    assert after.views == 2
    assert FusedCloud.empty(VOXEL).merged(np.zeros((0, 3)), [0, 0, 1]).points.shape == (0, 3)


def test_it_is_immutable(cloud):
    fused = FusedCloud.empty(VOXEL).merged(cloud, [0, 0, 1])
    assert copy.deepcopy(fused) is fused
    with pytest.raises(ValueError, match="read-only"):
        fused.points[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        fused.directions[0] = 0.0
    before = fused.points.copy()
    fused.merged(cloud + 0.1, [0, 0, 1])
    np.testing.assert_array_equal(fused.points, before)
