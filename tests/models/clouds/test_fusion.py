"""Merging of views against voxel means computed by a plain loop."""

import copy

import numpy as np
import pytest

from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.smoothing import register_view
from feasigrasp.models.clouds.view_image import free_distance
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points

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


def pear_view(camera, noise=0.0, seed=0):
    """What a camera sees of a smooth body without symmetry, by its exact normals."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(4000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    radius = 0.04 * (1 + 0.25 * u[:, :1] + 0.2 * u[:, 1:2] * u[:, 2:] + 0.15 * u[:, 2:] ** 2)
    points = radius * u
    to_camera = camera - points
    facing = np.einsum("ij,ij->i", u, to_camera) / np.linalg.norm(to_camera, axis=1) > 0.3
    along = to_camera[facing] / np.linalg.norm(to_camera[facing], axis=1, keepdims=True)
    return points[facing] + rng.normal(scale=noise, size=(facing.sum(), 1)) * along


def pear_error(points):
    """Radial distance to the body above."""
    length = np.linalg.norm(points, axis=1, keepdims=True)
    u = points / length
    radius = 0.04 * (1 + 0.25 * u[:, :1] + 0.2 * u[:, 1:2] * u[:, 2:] + 0.15 * u[:, 2:] ** 2)
    return (length - radius)[:, 0]


def surface(cloud):
    return cloud.points, cloud.normals


FRONT, SIDE = np.array([0.0, 0.0, 0.5]), np.array([0.35, 0.0, 0.36])


def test_smoothing_takes_the_noise_and_leaves_the_shape():
    view = pear_view(FRONT, noise=1.5e-3)
    plain = FusedCloud.empty(0.003).merged(view, FRONT)
    smooth = FusedCloud.empty(0.003, smooth=True).merged(view, FRONT)
    assert np.abs(pear_error(smooth.points)).mean() < 0.5 * np.abs(pear_error(plain.points)).mean()
    exact = FusedCloud.empty(0.003, smooth=True).merged(pear_view(FRONT), FRONT)
    assert np.abs(pear_error(exact.points)).mean() < 2e-4


def test_normals_are_those_of_the_body():
    fused = FusedCloud.empty(0.003, smooth=True).merged(pear_view(FRONT, noise=1e-3), FRONT)
    h = 1e-6
    gradient = np.stack(
        [(pear_error(fused.points + h * e) - pear_error(fused.points - h * e)) for e in np.eye(3)],
        axis=1,
    )
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", gradient, fused.normals)
    assert np.rad2deg(np.arccos(np.median(cosine))) < 8.0
    np.testing.assert_allclose(np.linalg.norm(fused.normals, axis=1), 1.0)


def test_a_badly_tracked_view_is_brought_back():
    error = se3.exp(np.array([0.015, -0.02, 0.01, 0.002, -0.0015, 0.002]))
    first, second = pear_view(FRONT, 5e-4), pear_view(SIDE, 5e-4, seed=1)
    moved, camera = second @ error[:3, :3].T + error[:3, 3], error[:3, :3] @ SIDE + error[:3, 3]
    one = FusedCloud.empty(0.003, smooth=True).merged(first, FRONT)
    correction = register_view(
        *surface(FusedCloud.empty(0.003, smooth=True).merged(moved, camera)), *surface(one)
    )
    before = np.abs(pear_error(moved)).mean()
    after = np.abs(pear_error(moved @ correction[:3, :3].T + correction[:3, 3])).mean()
    assert before > 1.2e-3
    assert after < 0.5 * before
    assert one.merged(moved, camera).views == 2


def test_a_well_tracked_view_stays_where_it_is():
    """What noise alone would gain is not worth a correction."""
    nothing = FusedCloud.empty(0.003, smooth=True)
    one = nothing.merged(pear_view(FRONT), FRONT)
    other = nothing.merged(pear_view(SIDE, seed=1), SIDE)
    np.testing.assert_array_equal(register_view(*surface(other), *surface(one)), np.eye(4))
    both = one.merged(pear_view(SIDE, seed=1), SIDE)
    assert np.abs(pear_error(both.points)).mean() < 3e-4


def test_a_view_of_something_else_is_not_dragged_along():
    one = FusedCloud.empty(0.003, smooth=True).merged(pear_view(FRONT), FRONT)
    far = pear_view(SIDE, seed=1) + [0.0, 0.2, 0.0]
    normals = np.tile([0.0, 0.0, 1.0], (len(far), 1))
    np.testing.assert_array_equal(register_view(far, normals, *surface(one)), np.eye(4))


def test_the_sides_of_a_thin_wall_stay_apart():
    rng = np.random.default_rng(5)
    sheet = np.column_stack([rng.uniform(-0.03, 0.03, (3000, 2)), np.full(3000, 0.001)])
    fused = FusedCloud.empty(0.01, smooth=True).merged(sheet, FRONT)
    fused = fused.merged(sheet * [1, 1, -1], -FRONT)
    np.testing.assert_allclose(np.abs(fused.points[:, 2]), 0.001, atol=1e-5)
    np.testing.assert_array_equal(np.sign(fused.points[:, 2]), np.sign(fused.normals[:, 2]))


def error_of_noisy_views(noises):
    """Mean error of what views of so much noise each make, without any registration [m]."""
    cloud = FusedCloud.empty(0.003, smooth=True)
    for seed, noise in enumerate(noises):
        cloud = cloud.merged(pear_view(FRONT, noise, seed), FRONT, register=False)
    return np.abs(pear_error(cloud.points)).mean()


def test_more_views_of_much_noise_give_a_better_surface():
    """And not a thicker one, of a layer for every view."""
    assert error_of_noisy_views([6e-3] * 6) < 0.9 * error_of_noisy_views([6e-3])


def test_a_sure_view_outweighs_many_that_are_not():
    noisy = error_of_noisy_views([6e-3] * 4)
    assert error_of_noisy_views([6e-3] * 4 + [3e-4]) < 0.7 * noisy


def test_a_view_whose_place_is_unsure_weighs_little():
    cloud = FusedCloud.empty(0.003, smooth=True).merged(pear_view(FRONT), FRONT)
    beside = pear_view(FRONT, seed=1) + 1e-3 * FRONT / np.linalg.norm(FRONT)

    def way(deviation):
        """How far the points have moved towards the camera."""
        after = cloud.merged(beside, FRONT, register=False, deviation=deviation)
        moved = after.points[: len(cloud.points)] - cloud.points
        return np.median(moved @ FRONT) / np.linalg.norm(FRONT)

    assert way(0.0) > 1e-4
    assert way(3e-3) < 0.2 * way(0.0)


def half_hidden():
    """A pear seen whole, and then from nearly there while a hand hides half of it."""
    whole = FusedCloud.empty(0.003, smooth=True).merged(pear_view(FRONT), FRONT)
    camera = np.array([0.1, 0.0, 0.49])
    half = pear_view(camera, seed=1)
    return whole, whole.merged(half[half[:, 1] > 0.0], camera), camera


def test_of_a_picture_that_ends_in_the_object_only_the_front_counts():
    whole, after, camera = half_hidden()
    assert [image.whole for image in whole.images] == [True]
    assert [image.whole for image in after.images] == [True, False]
    np.testing.assert_allclose(after.images[0].X_OC, whole.images[0].X_OC, atol=5e-3)
    surface = pear_view(camera)
    hidden, shown = surface[surface[:, 1] < -0.01], surface[surface[:, 1] > 0.01]
    part = after.images[1:]
    assert free_distance(part, hidden).max() <= 0.0  # hidden is not free
    before = shown + 0.2 * (camera - shown)
    assert np.mean(free_distance(part, before) > 0.05) > 0.95


def test_a_picture_that_sees_through_the_object_is_forgotten():
    """A view of it 5 cm farther away, whose picture is newer and has the same direction."""
    whole, _, _ = half_hidden()
    behind = pear_view(FRONT) - [0.0, 0.0, 0.05]
    after = whole.merged(behind, FRONT, register=False)
    assert [image is whole.images[0] for image in after.images] == [True]


def ball_seen_from(angle, radius=0.04):
    """The half of a ball that faces a camera, which has gone round it by an angle."""
    camera = 0.5 * np.array([np.cos(angle), np.sin(angle), 0.3])
    points = radius * sphere_points(4000, 1.0)
    return points[points @ camera > 1.2 * radius**2], camera


def test_of_too_many_pictures_those_that_differ_most_are_kept():
    """Six of nine all round, so that every direction has one within one step of it."""
    fused = FusedCloud.empty(0.004, smooth=True)
    for k in range(9):
        fused = fused.merged(*ball_seen_from(k * np.deg2rad(40.0)))
    assert len(fused.images) == 6
    towards = -np.array([image.X_OC[:3, 2] for image in fused.images])
    angles = np.sort(np.arctan2(towards[:, 1], towards[:, 0]))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    assert gaps.max() < np.deg2rad(85.0)


@pytest.mark.parametrize(("step", "kept"), [(5.0, 1), (40.0, 3)])
def test_one_picture_is_kept_for_every_direction_and_the_latest_of_them(step, kept):
    fused = FusedCloud.empty(0.004, smooth=True)
    for k in range(3):
        points, camera = ball_seen_from(k * np.deg2rad(step))
        fused = fused.merged(points, camera)
    assert len(fused.images) == kept
    np.testing.assert_allclose(fused.images[-1].X_OC[:3, 3], camera, atol=0.01)


def far_and_near_sides():
    """A cloud from one view of a box's top, and that view: points (n, 3) and the camera."""
    rng = np.random.default_rng(3)
    top = np.c_[rng.uniform(-0.03, 0.03, (4000, 2)), rng.normal(0.0, 2e-4, 4000)]
    camera = np.array([0.0, 0.0, 0.4])
    return FusedCloud.empty(0.003, smooth=True).merged(top, camera), top, camera


@pytest.mark.parametrize("along", [[0.0, 0.0, -0.04], [0.0, 0.0, 0.04], [0.05, 0.0, 0.0]])
def test_a_view_of_an_object_that_is_elsewhere_contradicts(along):
    """Farther away, where the old surface would hide it; nearer; and aside."""
    cloud, top, camera = far_and_near_sides()
    assert cloud.contradicted(top + along, camera) > 0.5


def test_a_view_of_a_part_contradicts_nothing():
    """A hand hides the rest, or the picture ends."""
    cloud, top, camera = far_and_near_sides()
    assert cloud.contradicted(top[top[:, 0] > 0.0], camera) == 0.0
    assert cloud.contradicted(top + [0.002, 0.0, 0.002], camera) < 0.1
    assert cloud.contradicted(top[:5], camera) == 0.0


def test_a_part_that_had_no_depth_contradicts_nothing_when_it_is_seen():
    """The stem between the two parts of a tool, too steep at first."""
    rng = np.random.default_rng(5)
    at = np.c_[rng.uniform(-0.06, 0.06, 6000), rng.uniform(-0.02, 0.02, 6000), np.zeros(6000)]
    camera, stem = np.array([0.0, 0.0, 0.4]), np.abs(at[:, 0]) < 0.03
    nothing = FusedCloud.empty(0.003, smooth=True)
    unclear = Outline(at[stem] - camera, [])
    for outline, least, most in ((None, 0.3, 1.0), (unclear, 0.0, 0.01)):
        cloud = nothing.merged(at[~stem], camera, outline=outline)
        assert least <= cloud.contradicted(at, camera) <= most
        assert cloud.contradicted(at + [0.0, 0.08, 0.0], camera) > 0.5  # aside


def test_what_is_too_near_for_the_camera_is_not_seen_through():
    """A near plate before a far one: from close by only the far one is measured."""
    rng = np.random.default_rng(6)
    near = np.c_[rng.uniform(-0.03, 0.0, 2000), rng.uniform(-0.02, 0.02, 2000), np.full(2000, 0.05)]
    far = np.c_[rng.uniform(-0.03, 0.03, (4000, 1)), rng.uniform(-0.02, 0.02, 4000), np.zeros(4000)]
    camera, close = np.array([0.0, 0.0, 0.5]), np.array([-0.05, 0.0, 0.18])
    cloud = FusedCloud.empty(0.003, smooth=True).merged(np.concatenate([near, far]), camera)
    assert cloud.contradicted(far, close) > 0.2
    assert cloud.contradicted(far, close, Outline(near - close, [])) < 0.1
