"""The compiled loops of the distance field against dense NumPy."""

import numpy as np
import pytest
from numba import njit
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from feasigrasp.errors import PointCloudError
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.numerics.fast_math import MAX_EXPONENT, exp2_of_minus, rough_inverse_sqrt
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import fit_field, fit_gpdf
from feasigrasp.models.shape.node_sums import MIN_OCCUPANCY, TILE
from feasigrasp_lab.paper.field import PAPER

LENGTH_SCALE = 0.15


def ball(rng, count, radius=0.08):
    u = rng.normal(size=(count, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True) * rng.uniform(0.0, radius, (count, 1))


def fitted(nodes, targets, noise=0.01, length_scale=LENGTH_SCALE):
    return fit_field(
        nodes,
        targets,
        points=nodes,
        bounds=np.stack([nodes.min(axis=0), nodes.max(axis=0)]),
        length_scale=length_scale,
        noise_variance=noise,
    )


def dense(nodes, targets, noise, x, length_scale=LENGTH_SCALE):
    """Distance, gradient and variance as the formulas say."""
    K = np.exp(-cdist(nodes, nodes) / length_scale) + np.diag(np.broadcast_to(noise, len(nodes)))
    alpha = np.linalg.solve(K, targets)
    r = cdist(x, nodes)
    k = np.exp(-r / length_scale)
    o = k @ alpha
    weights = np.divide(k * alpha, r, out=np.zeros_like(r), where=r > 0)
    gradient = np.einsum("mn,mni->mi", weights, x[:, None] - nodes) / o[:, None]
    variance = 1.0 - np.einsum("ij,ji->i", k, np.linalg.solve(K, k.T))
    return -length_scale * np.log(o), gradient, variance


@njit
def on_all(x):
    e, s = np.empty_like(x), np.empty_like(x)
    for i in range(len(x)):
        e[i], s[i] = exp2_of_minus(x[i]), rough_inverse_sqrt(x[i])
    return e, s


@pytest.mark.parametrize("vectorised", [False, True])
def test_vector_math_matches_numpy(vectorised):
    near_halves = np.arange(20)[:, None] + 0.5 + np.array([-1e-15, 0.0, 1e-15])
    x = np.concatenate(
        [np.linspace(1e-12, 3.0, 4001), near_halves.ravel(), np.linspace(3.0, MAX_EXPONENT, 4001)]
    )
    one_by_one = np.array([(exp2_of_minus(v), rough_inverse_sqrt(v)) for v in x]).T
    exponential, root = on_all(x) if vectorised else one_by_one
    np.testing.assert_allclose(exponential, np.exp2(-x), rtol=2e-14)
    np.testing.assert_allclose(root, 1.0 / np.sqrt(x), rtol=2.7e-8)
    tiny, huge = np.array([1e-30, 1e-12]), np.array([1e6, 1e12])
    for far in (tiny, huge):
        np.testing.assert_allclose(on_all(far)[1], 1.0 / np.sqrt(far), rtol=2.7e-8)


@pytest.mark.parametrize("count", [1, 8, TILE - 1, TILE, TILE + 1, 3 * TILE - 7])
def test_sums_equal_dense_formulas_for_any_number_of_nodes(count):
    rng = np.random.default_rng(count)
    nodes = ball(rng, count) + [0.5, -0.3, 1.0]
    targets, noise = rng.uniform(0.9, 1.1, count), rng.uniform(0.005, 0.02, count)
    x = np.concatenate([ball(rng, 50, 0.3) + [0.5, -0.3, 1.0], nodes[:5]])
    field = fitted(nodes, targets, noise)
    distance, gradient, variance = dense(nodes, targets, noise, x)
    np.testing.assert_allclose(field.distance(x), distance, atol=1e-11)
    value, slope = field.distance_and_gradient(x)
    np.testing.assert_allclose(value, distance, atol=1e-11)
    np.testing.assert_allclose(slope, gradient, atol=1e-10)
    np.testing.assert_allclose(field.variance(x), variance, atol=1e-10)


def test_gradient_at_a_node_leaves_out_that_node():
    nodes = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    field = fitted(nodes, np.ones(3))
    value, gradient = field.distance_and_gradient(nodes)
    expected = dense(nodes, np.ones(3), 0.01, nodes)
    np.testing.assert_allclose(value, expected[0], atol=1e-12)
    np.testing.assert_allclose(gradient, expected[1], atol=1e-12)


@pytest.mark.parametrize("far", [30.0, 1e3, 1e9, 1e200])
def test_underflow_far_away_gives_the_largest_distance(far):
    field = fitted(ball(np.random.default_rng(0), 40), np.ones(40))
    value, gradient = field.distance_and_gradient([[far, 0.0, 0.0], [0.0, -far, far]])
    np.testing.assert_allclose(value, -LENGTH_SCALE * np.log(MIN_OCCUPANCY), rtol=1e-12)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-12)
    np.testing.assert_allclose(field.variance([[far, 0.0, 0.0]]), 1.0, atol=1e-12)


def test_nodes_hundreds_of_length_scales_apart_are_refused():
    nodes = ball(np.random.default_rng(1), 40)
    with pytest.raises(PointCloudError, match="length_scale"):
        fitted(nodes, np.ones(40), length_scale=1e-4)
    nodes[3, 1] = np.nan
    with pytest.raises(PointCloudError, match="NaN"):
        fitted(nodes, np.ones(40))


def test_farthest_points_equal_the_definition():
    rng = np.random.default_rng(3)
    cloud = rng.normal(size=(301, 3))
    expected = [int(np.linalg.norm(cloud - cloud.mean(axis=0), axis=1).argmax())]
    while len(expected) < 40:
        expected.append(int(cdist(cloud, cloud[expected]).min(axis=1).argmax()))
    np.testing.assert_array_equal(farthest_points(cloud, 40), expected)
    np.testing.assert_array_equal(np.sort(farthest_points(cloud, 301)), np.arange(301))


@pytest.mark.parametrize("count", [64, 320])
def test_selection_keeps_the_corners_of_a_box(count):
    rng = np.random.default_rng(4)
    cloud, half = rng.uniform(-1.0, 1.0, (2000, 3)), np.array([0.03, 0.045, 0.075])
    row, face = np.arange(len(cloud)), np.arange(len(cloud)) % 3
    cloud[row, face] = np.sign(cloud[row, face])
    cloud *= half
    corners = half * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    possible = cdist(corners, cloud).min(axis=1)
    kept = fit_gpdf(cloud, max_points=count, surface_offset=None).points
    gap = cdist(corners, kept).min(axis=1)
    assert (gap < possible + 0.0025).all()
    plain = cloud[farthest_points(cloud, count)]
    assert gap.mean() < 0.7 * cdist(corners, plain).min(axis=1).mean()
    # The rest of the cloud is covered as well as without the corners' privilege.
    assert cdist(cloud, kept).min(axis=1).max() < 1.1 * cdist(cloud, plain).min(axis=1).max()


def plain_touches(field, poses, body, margin):
    """Which bodies come closer than a margin, told at every point, none cleared by another."""
    x = (poses[:, None, :3, :3] @ body[:, :, None])[..., 0] + poses[:, None, :3, 3]
    x = x.reshape(-1, 3)
    distance = field.distance(x)
    close = (distance >= 0.0) & (distance < margin)
    refined, p = np.zeros(close.sum()), x[close]
    for _ in range(2):
        d, gradient = field.distance_and_gradient(p)
        slope = np.linalg.norm(gradient, axis=1)
        step = np.clip(d / np.maximum(slope, 0.2), -2.5 * np.abs(d), 2.5 * np.abs(d))
        refined += step
        p = p - (step / slope)[:, None] * gradient
    distance[close] = refined
    return (distance.reshape(len(poses), -1) < margin).any(axis=1)


@pytest.mark.parametrize("shape", ["box", "can", "bottle"])
@pytest.mark.parametrize("preset", [{}, PAPER], ids=["default", "paper"])
def test_pruning_does_not_change_which_bodies_touch(true_shapes, shape, preset):
    rng = np.random.default_rng(5)
    cloud, to_camera = true_shapes[shape].views(1, rng)
    field = fit_gpdf(cloud, viewpoint=to_camera, **preset)
    poses = np.tile(np.eye(4), (400, 1, 1))
    poses[:, :3, :3] = Rotation.random(400, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.uniform(-0.15, 0.15, (400, 3)) + cloud.mean(axis=0)
    hand = ParallelGripper().surface_points(0.08)
    expected = plain_touches(field, poses, hand, 0.003)
    np.testing.assert_array_equal(field.clearance(poses, hand, 0.003, 0.003)[0] < 0.003, expected)
    assert 0.05 < expected.mean() < 0.95


@pytest.mark.parametrize("preset", [{}, PAPER], ids=["default", "paper"])
def test_refinement_takes_the_steps_it_says(sphere_cloud, preset):
    field = fit_gpdf(sphere_cloud(), **preset, max_points=512)
    start = ball(np.random.default_rng(6), 30, 0.2)
    x, travelled = start.copy(), np.zeros(30)
    for _ in range(5):
        d, gradient = field.distance_and_gradient(x)
        slope = np.linalg.norm(gradient, axis=1)
        newton = np.clip(d / np.maximum(slope, 0.2), -2.5 * np.abs(d), 2.5 * np.abs(d))
        step = newton if field.damped else d
        travelled, x = travelled + step, x - (step / slope)[:, None] * gradient
    distance, ends, normals = field.refine(start, steps=5)
    assert field.damped is (preset == {})
    np.testing.assert_allclose(distance, travelled, atol=1e-8)
    np.testing.assert_allclose(ends, x, atol=1e-8)
    np.testing.assert_allclose(normals, field.normals(x), atol=1e-6)


def test_queries_are_not_changed(sphere_cloud):
    x = ball(np.random.default_rng(7), 20)
    before = x.copy()
    field = fit_gpdf(sphere_cloud())
    for ask in (field.distance, field.distance_and_gradient, field.variance, field.refine):
        ask(x)
    np.testing.assert_array_equal(x, before)
    transposed = np.asfortranarray(x)
    np.testing.assert_array_equal(field.distance(transposed), field.distance(x))
    np.testing.assert_allclose(field.distance(x.tolist()), field.distance(x))
