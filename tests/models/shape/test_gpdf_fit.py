"""The distance field against closed forms, dense algebra, differences and invariances."""

import copy

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from feasigrasp.errors import PointCloudError
from feasigrasp.models.clouds.checks import MIN_POINTS
from feasigrasp.models.numerics.fast_math import fast_exp
from feasigrasp.models.shape.gpdf import fit_gpdf

RADIUS = 0.05


def shell(rng, low, high, count=400):
    """Random points with distance to the origin between low and high."""
    u = rng.normal(size=(count, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True) * rng.uniform(low, high, (count, 1))


@pytest.fixture(scope="module", params=[None, 0.002], ids=["paper", "offsets"])
def sphere(request, sphere_cloud):
    return fit_gpdf(sphere_cloud(), surface_offset=request.param, max_points=512)


def test_fast_exp_matches_numpy():
    near, far = np.linspace(-20.0, 2.0, 5001), np.linspace(-700.0, 700.0, 5001)
    np.testing.assert_allclose([fast_exp(x) for x in near], np.exp(near), rtol=2e-14)
    np.testing.assert_allclose([fast_exp(x) for x in far], np.exp(far), rtol=2e-13)
    assert fast_exp(0.0) == 1.0
    assert 0.0 < fast_exp(-1e9) < 1e-300


@pytest.mark.parametrize(
    ("low", "high", "bar"), [(1.02, 3.0, 0.002), (0.2, 0.98, 0.005)], ids=["outside", "inside"]
)
def test_refined_distance_of_a_sphere(sphere, low, high, bar):
    x = shell(np.random.default_rng(0), low * RADIUS, high * RADIUS)
    true = np.linalg.norm(x, axis=1) - RADIUS
    distance, surface, normals = sphere.refine(x, steps=5)
    assert np.abs(distance - true).max() <= bar * RADIUS
    np.testing.assert_allclose(np.linalg.norm(surface, axis=1), RADIUS, atol=bar * RADIUS)
    radial = x / np.linalg.norm(x, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", normals, radial).min() > np.cos(np.deg2rad(15))


def test_raw_distance_has_the_right_sign_but_not_the_right_size(sphere):
    rng = np.random.default_rng(1)
    outside, inside = shell(rng, 0.06, 0.15), shell(rng, 0.01, 0.045)
    assert (sphere.distance(outside) > 0).all()
    assert (sphere.distance(inside) < 0).all()  # o > 1 inside: must not be clamped
    assert (sphere.distance(outside) < np.linalg.norm(outside, axis=1) - RADIUS + 1e-4).all()


def test_far_away_the_distance_stays_finite(sphere):
    value, gradient = sphere.distance_and_gradient([[1e4, 0, 0], [0, -1e6, 0]])
    assert np.isfinite(value).all() and np.isfinite(gradient).all()
    assert (value > 10.0).all()


def test_field_equals_dense_gaussian_process_algebra():
    rng = np.random.default_rng(2)
    cloud = shell(rng, 0.03, 0.05, 60) + [0.4, -0.2, 0.7]
    x = shell(rng, 0.0, 0.1, 40) + [0.4, -0.2, 0.7]
    field = fit_gpdf(cloud, length_scale=0.2, noise_variance=0.01, surface_offset=None)
    K = np.exp(-cdist(cloud, cloud) / 0.2) + 0.01 * np.eye(60)
    k = np.exp(-cdist(x, cloud) / 0.2)
    occupancy = k @ np.linalg.solve(K, np.ones(60))
    np.testing.assert_allclose(field.distance(x), -0.2 * np.log(occupancy), atol=1e-12)
    variance = 1.0 - np.einsum("ij,ji->i", k, np.linalg.solve(K, k.T))
    np.testing.assert_allclose(field.variance(x), variance, atol=1e-11)


def test_gradient_matches_finite_differences(sphere):
    x, h = shell(np.random.default_rng(3), 0.005, 0.15), 1e-6
    difference = np.stack(
        [(sphere.distance(x + h * e) - sphere.distance(x - h * e)) / (2 * h) for e in np.eye(3)],
        axis=-1,
    )
    value, gradient = sphere.distance_and_gradient(x)
    np.testing.assert_allclose(gradient, difference, atol=2e-6)
    np.testing.assert_allclose(value, sphere.distance(x), atol=1e-13)
    norm = np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(sphere.normals(x), gradient / norm, atol=1e-12)


@pytest.mark.parametrize("count", [200, 3000], ids=["all points", "a selection"])
@pytest.mark.parametrize("with_camera", [False, True])
def test_field_moves_with_the_cloud(count, with_camera):
    rng = np.random.default_rng(4)
    cloud = shell(rng, 0.03, 0.06, count)
    camera = np.array([0.1, 0.5, 0.2]) if with_camera else None
    x = shell(rng, 0.0, 0.15)
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 0.3
    moved = [None if p is None else p @ R.T + t for p in (cloud, camera, x)]
    here = fit_gpdf(cloud, viewpoint=camera)
    there = fit_gpdf(moved[0], viewpoint=moved[1])
    np.testing.assert_allclose(there.distance(moved[2]), here.distance(x), atol=1e-9)
    np.testing.assert_allclose(there.variance(moved[2]), here.variance(x), atol=1e-9)
    np.testing.assert_allclose(there.normals(moved[2]) @ R, here.normals(x), atol=1e-7)


def test_every_grid_point_reaches_the_surface(sphere):
    surface = sphere.surface(n=8)
    assert len(surface) == 8**3
    np.testing.assert_allclose(np.linalg.norm(surface.points, axis=1), RADIUS, atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-12)
    assert sphere.completion is sphere.completion


def test_offsets_tell_inside_from_outside_in_one_view(true_shapes):
    truth = true_shapes["bottle"]
    cloud, to_camera = truth.views(1, np.random.default_rng(5))
    x = np.random.default_rng(6).uniform(-0.5, 0.5, (3000, 3)) * np.ptp(truth.mesh.bounds, axis=0)
    inside = x[truth.signed_distance(x) < -0.002]
    paper = fit_gpdf(cloud, surface_offset=None).distance(inside) < 0
    offsets = fit_gpdf(cloud, viewpoint=to_camera).distance(inside) < 0
    assert offsets.mean() > 0.9
    assert offsets.mean() > paper.mean() + 0.1


def test_more_views_complete_the_shape_better_and_variance_shows_the_unseen(true_shapes):
    truth = true_shapes["box"]
    error = {}
    for views in (1, 3):
        cloud, to_camera = truth.views(views, np.random.default_rng(7))
        gpdf = fit_gpdf(cloud, viewpoint=to_camera)
        surface = gpdf.completion
        off = np.abs(truth.signed_distance(surface.points))
        error[views] = off.mean()
        if views == 1:
            variance = gpdf.variance(surface.points)
            reliable = variance < np.median(variance)
            assert off[reliable].mean() < 0.3 * off[~reliable].mean()
    assert error[3] < 0.6 * error[1]


def test_selection_is_deterministic_and_covers_the_cloud():
    cloud = np.random.default_rng(8).normal(size=(5000, 3)) * 0.03
    field = fit_gpdf(cloud, max_points=100)
    np.testing.assert_array_equal(field.points, fit_gpdf(cloud, max_points=100).points)
    assert len(np.unique(field.points, axis=0)) == 100
    random = cloud[np.random.default_rng(9).choice(5000, 100, replace=False)]
    gap = cdist(cloud, field.points).min(axis=1).max()
    assert gap < cdist(cloud, random).min(axis=1).max()


def test_field_is_immutable_and_its_copy_is_itself(sphere):
    assert copy.deepcopy(sphere) is sphere
    assert copy.deepcopy(sphere.completion) is sphere.completion
    with pytest.raises(ValueError, match="read-only"):
        sphere.alpha[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        sphere.completion.points[0] = 1.0


def test_duplicates_and_a_plane_are_accepted():
    rng = np.random.default_rng(10)
    plane = np.column_stack([rng.uniform(-0.05, 0.05, (100, 2)), np.zeros(100)])
    for cloud in (np.repeat(plane, 3, axis=0), plane):
        assert np.isfinite(fit_gpdf(cloud).surface().points).all()


BALL = shell(np.random.default_rng(11), 0.05, 0.05, 64)
BAD_CLOUDS = {
    "wrong shape": (np.zeros((10, 2)), "shape"),
    "flat list": (np.zeros(30), "shape"),
    "empty": (np.zeros((0, 3)), "at least"),
    "too few": (BALL[: MIN_POINTS - 1], "at least"),
    "NaN": (np.where(np.arange(64)[:, None] < 3, np.nan, BALL), "3 of 64"),
    "infinity": (np.where(np.arange(64)[:, None] < 1, np.inf, BALL), "1 of 64"),
    "one spot": (np.ones((20, 3)), "one spot or line"),
    "a line": (np.linspace(0, 0.1, 20)[:, None] * [1, 2, 3], "one spot or line"),
    "millimetres": (1000 * BALL, "millimetres"),
}


@pytest.mark.parametrize("name", BAD_CLOUDS)
def test_bad_clouds_are_refused(name):
    cloud, message = BAD_CLOUDS[name]
    with pytest.raises(PointCloudError, match=message):
        fit_gpdf(cloud)


@pytest.mark.parametrize(
    "parameter",
    [
        {"length_scale": 0.0},
        {"length_scale": float("nan")},
        {"noise_variance": -1.0},
        {"surface_offset": -0.002},
        {"max_points": 3},
        {"viewpoint": np.zeros((5, 3))},
        {"viewpoint": [np.nan, 0, 0]},
    ],
    ids=str,
)
def test_bad_parameters_are_refused_by_name(parameter):
    with pytest.raises(PointCloudError, match=next(iter(parameter))):
        fit_gpdf(BALL, **parameter)


def test_bad_queries_are_refused(sphere):
    with pytest.raises(PointCloudError, match="shape"):
        sphere.distance([0.0, 0.0, 0.0])
    with pytest.raises(PointCloudError, match="NaN"):
        sphere.variance([[np.nan, 0.0, 0.0]])


def test_real_clouds_fit(shared_data):
    files = sorted((shared_data / "real_clouds").glob("*.npz"))
    assert files
    for file in files:
        cloud = np.load(file)["object_xyz"]
        field = fit_gpdf(cloud, viewpoint=None if "gpd_" in file.name else np.zeros(3))
        assert np.abs(field.distance(cloud)).mean() < 0.0015, file.name
        assert len(field.completion) > 450, file.name
