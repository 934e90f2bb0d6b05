"""A known shape is found in an image; what the shape does not determine stays as expected."""

import numpy as np
import pytest
import trimesh

from feasigrasp.models.clouds.checks import ViewRecord
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry import se3
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.tracking.keyframe import is_worth_merging, keyframe_of
from feasigrasp.models.tracking.model import (
    NOISE_SHARE,
    TrackedModel,
    jacobian,
    surface_deviation,
    without_noise,
)
from feasigrasp.models.tracking.registration import is_accepted, is_found, register, shows_model
from feasigrasp.models.tracking.twist_filter import moved, pose_error
from feasigrasp.models.tracking.view import ObjectView
from feasigrasp_lab.training.data.raycasting import Raycaster
from tests.object_views import CAMERA, FOCAL, camera_at, look

SHAPES = {
    "box": trimesh.creation.box((0.06, 0.09, 0.14)),
    "can": trimesh.creation.cylinder(0.035, 0.11, sections=96),
    "ball": trimesh.creation.icosphere(subdivisions=4, radius=0.045),
}
#: Standard deviation of the expected pose [rad, m].
PRIOR = np.diag(np.square(np.repeat([0.1, 0.01], 3)))


@pytest.fixture(scope="module", params=SHAPES)
def shape(request):
    """Name, ray casts and the model made of four views from one side, as a tracker would."""
    mesh = SHAPES[request.param]
    surface = Raycaster(mesh.vertices, mesh.faces)
    cloud, rng = FusedCloud.empty(0.003, smooth=True), np.random.default_rng(0)
    for angle in (0.0, 0.4, 0.8, 1.2):
        camera = camera_at([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.2])
        view = look(surface, np.eye(4), camera, rng)
        cloud = cloud.merged(view.points_W, camera[:3, 3], register=False)
    return request.param, surface, TrackedModel(complete_shape(cloud, max_points=320))


def surface_error(mesh, X, X_true):
    """Mean distance of the moved surface from the true one [m]."""
    points = np.asarray(trimesh.sample.sample_surface(mesh, 300, seed=1)[0])
    E = se3.inverse(X_true) @ X
    return Raycaster(mesh.vertices, mesh.faces).distance(points @ E[:3, :3].T + E[:3, 3]).mean()


def test_it_converges_from_8_mm_and_5_degrees(shape):
    name, surface, model = shape
    rng = np.random.default_rng(1)
    for _ in range(4):
        X_true = se3.make_pose(se3.so3_exp(0.1 * rng.standard_normal(3)), 0.02 * rng.random(3))
        axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
        X = moved(X_true, np.concatenate([np.deg2rad(5.0) * axis, 0.008 * way]))
        view = look(surface, X_true, camera_at([0.25, 0.2, 0.2]), rng)
        found = register(model, view, X, PRIOR)
        assert found.inliers > 0.95
        assert surface_error(SHAPES[name], found.X_WO, X_true) < 1e-3
        if name == "box":
            assert np.rad2deg(np.linalg.norm(pose_error(X_true, found.X_WO)[:3])) < 1.0


@pytest.mark.parametrize("shape", ["can", "ball"], indirect=True)
def test_what_an_axis_of_symmetry_leaves_open_stays_as_expected(shape):
    """Wherever the search starts, and although noisy points have bumps to hold on to."""
    _, surface, model = shape
    rng = np.random.default_rng(2)
    for turn in (0.2, -0.2):
        spin = np.array([0.0, 0.0, turn, 0.0, 0.0, 0.0])
        view = look(surface, np.eye(4), camera_at([0.25, 0.2, 0.2]), rng)
        found = register(model, view, moved(np.eye(4), spin), np.eye(6) * 0.1)
        assert abs(pose_error(np.eye(4), found.X_WO)[2] - turn) < 0.01
        about_z = np.zeros(6)
        about_z[2] = 1.0
        along_x = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
        spin_known, shift_known = (e @ found.information @ e for e in (about_z, along_x))
        assert spin_known < 1e-3 * 0.05**2 * shift_known


def test_nothing_beside_the_silhouette_is_overlooked():
    """Half a bar is seen; only the background tells that the model does not stick out there."""
    bar = trimesh.creation.box((0.03, 0.03, 0.16))
    surface = Raycaster(bar.vertices, bar.faces)
    camera = camera_at([0.3, 0.0, 0.0])
    view = look(surface, np.eye(4), camera)
    model = TrackedModel(
        complete_shape(
            FusedCloud.empty(0.003, smooth=True)
            .merged(view.points_W, camera[:3, 3])
            .merged(view.points_W, camera[:3, 3], register=False)
        )
    )
    slid = moved(np.eye(4), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.02]))
    lower = view.points_W[view.points_W[:, 2] < 0.04]
    for depth, known in ((view.depth, True), (None, False)):
        seen = ObjectView(CAMERA, camera, lower, depth)
        found = register(model, seen, slid, np.eye(6) * 1e-2)
        assert (found.beside > 0.0) == known
        _, way = seen.beside(seen.in_camera(model.points + [0.0, 0.0, 0.02]))
        assert (len(way) > 0) == known


def test_the_way_back_to_the_silhouette_is_right():
    """Points that a camera sees past, against the true outline of a ball."""
    ball = SHAPES["ball"]
    camera = camera_at([0.3, 0.0, 0.0])
    view = look(Raycaster(ball.vertices, ball.faces), np.eye(4), camera)
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = 0.055 * np.column_stack([0.0 * angle, np.cos(angle), np.sin(angle)])
    found, way = view.beside(view.in_camera(ring))
    assert found.all()
    # The outline is where lines of sight touch the ball: 45 mm from its centre, here seen 45.5.
    edge = 0.3 * np.tan(np.arcsin(0.045 / 0.3))
    length = np.linalg.norm(way, axis=1)
    pixel = 0.3 / FOCAL
    assert np.abs(length - (0.055 - edge - 4.0 * pixel)).max() < 3.0 * pixel
    towards = -(view.in_camera(ring) - view.in_camera(np.zeros((1, 3))))[:, :2] / 0.055
    assert np.einsum("ij,ij->i", way / length[:, None], towards).min() > 0.9
    hidden = ObjectView(CAMERA, camera, view.points_W, np.where(view.depth < 1.0, view.depth, 0.0))
    assert not hidden.beside(view.in_camera(ring))[0].any()  # nothing measured: nothing known


def test_rows_are_the_derivatives_of_the_distance(shape):
    _, _, model = shape
    rng = np.random.default_rng(3)
    x = rng.normal(size=(50, 3)) * 0.05
    X = moved(np.eye(4), np.array([0.1, -0.2, 0.3, 0.01, 0.02, -0.01]))

    def distance(error):
        Y = moved(X, error)
        return model.gpdf.distance((x - Y[:3, 3]) @ Y[:3, :3])

    lever = x - X[:3, 3]
    gradient = model.gpdf.distance_and_gradient(lever @ X[:3, :3])[1]
    rows = jacobian(lever, gradient @ X[:3, :3].T)
    h = 1e-6
    expected = np.stack([(distance(h * e) - distance(-h * e)) / (2 * h) for e in np.eye(6)], axis=1)
    assert np.allclose(rows, expected, atol=1e-5)


def test_information_less_noise_does_not_depend_on_the_axes():
    rng = np.random.default_rng(4)
    lever, normals = rng.normal(size=(2, 40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = rng.random(40) + 0.1
    information, projection = without_noise(jacobian(lever, normals), weights, lever, NOISE_SHARE)
    R = se3.so3_exp(rng.normal(size=3))
    rows = jacobian(lever @ R.T, normals @ R.T)
    turned, _ = without_noise(rows, weights, lever @ R.T, NOISE_SHARE)
    both = np.kron(np.eye(2), R)
    assert np.allclose(turned, both @ information @ both.T)
    # Enough directions are seen: nearly all of it is believed.
    whole = jacobian(lever, normals).T @ (weights[:, None] * jacobian(lever, normals))
    assert np.linalg.eigvalsh(whole - information).min() > -1e-9
    assert np.trace(information) > 0.9 * np.trace(whole)
    assert np.allclose(projection @ projection @ whole, information)


def test_normals_that_err_do_not_make_motions_too_small():
    """A plain least-squares fit does, as any whose regressors err (attenuation)."""
    rng = np.random.default_rng(6)
    lever = 0.05 * rng.normal(size=(20000, 3))
    true = rng.normal(size=(20000, 3)) * [1.0, 0.5, 0.2]
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    wrong = true + 0.4 * rng.normal(size=(20000, 3))
    e = np.array([0.05, -0.03, 0.04, 2e-3, 1e-3, -2e-3])
    J, weights = jacobian(lever, wrong), np.ones(20000)
    gradient = J.T @ (jacobian(lever, true) @ e)
    information, projection = without_noise(J, weights, lever, 0.4**2)
    plain = np.linalg.solve(J.T @ J, gradient)
    ours = np.linalg.solve(information, projection @ gradient)
    assert plain[5] / e[5] < 0.4  # along z, where few normals point
    assert np.abs(ours[3:] / e[3:] - 1.0).max() < 0.15


@pytest.mark.parametrize(("sigma", "least", "most"), [(2e-4, 0.0, 0.02), (1e-2, 0.05, 0.3)])
def test_how_much_normals_err_is_measured(sigma, least, most):
    surface = Raycaster(SHAPES["box"].vertices, SHAPES["box"].faces)
    camera, rng = camera_at([0.3, 0.2, 0.2]), np.random.default_rng(7)
    exact = look(surface, np.eye(4), camera)
    towards = camera[:3, 3] - exact.points_W
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    noisy = exact.points_W + sigma * rng.standard_normal((len(towards), 1)) * towards
    cloud = FusedCloud.empty(0.003, smooth=True).merged(noisy, camera[:3, 3])
    assert least <= TrackedModel(complete_shape(cloud, max_points=320)).noise_share <= most


def test_the_deviation_of_a_surface_is_that_of_samples():
    rng = np.random.default_rng(5)
    lever, normals = rng.normal(size=(2, 30, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    root = rng.normal(size=(6, 6))
    covariance = root @ root.T
    errors = rng.multivariate_normal(np.zeros(6), covariance, size=20_000)
    moved_by = errors[:, None, 3:] + np.cross(errors[:, None, :3], lever)
    across = np.einsum("nij,ij->ni", moved_by, normals)
    deviation = surface_deviation(covariance, lever, normals)
    assert deviation == pytest.approx(np.sqrt(np.mean(across**2)), rel=0.03)


def test_a_model_beside_the_object_is_not_covered_by_it(shape):
    """Kept from moving by its prior: at the place, half a width off, and half out of the image."""
    _, surface, model = shape
    view, fixed = look(surface, np.eye(4), camera_at([0.25, 0.2, 0.2])), 1e-12 * np.eye(6)
    there = register(model, view, np.eye(4), fixed)
    assert there.covered > 0.95 and there.inside == 1.0 and there.in_view == 1.0
    aside = se3.make_pose(np.eye(3), 0.1 * view.X_WC[:3, 0])
    assert register(model, view, aside, fixed).covered < 0.3
    turned = view.X_WC @ se3.make_pose(se3.so3_exp([0.0, np.arctan2(160.0, FOCAL), 0.0]), [0, 0, 0])
    half = register(model, look(surface, np.eye(4), turned), np.eye(4), fixed)
    assert 0.2 < half.inside < 0.8 and half.covered > 0.9


def test_points_of_a_side_that_was_never_seen_are_no_outliers():
    """Known from its end alone, a beam is longer than anybody would guess."""
    mesh = trimesh.creation.box((0.05, 0.07, 0.3))
    surface, cloud = Raycaster(mesh.vertices, mesh.faces), FusedCloud.empty(0.003, smooth=True)
    end = camera_at([1e-3, 2e-3, 0.4])
    cloud = cloud.merged(look(surface, np.eye(4), end).points_W, end[:3, 3])
    model = TrackedModel(complete_shape(cloud, max_points=320))
    fixed = 1e-12 * np.eye(6)
    found = register(model, look(surface, np.eye(4), camera_at([0.2, 0.2, 0.3])), np.eye(4), fixed)
    assert found.inliers > 0.8 and found.new > 0.3
    assert found.on_model == pytest.approx(found.inliers * (1.0 - found.new))
    again = register(model, look(surface, np.eye(4), end), np.eye(4), fixed)
    assert again.inliers > 0.99 and again.new < 0.01


def test_a_side_of_which_hardly_anything_is_known_shows_nothing_that_is(shape):
    """A single point that faces the camera may be in view and covered, and is no view."""
    _, surface, model = shape
    shares = []
    for angle in np.linspace(1.5, 4.2, 12):
        camera = camera_at([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.0])
        points, normals = model.placed(np.eye(3))
        towards = camera[:3, 3] - points
        cosine = (towards * normals).sum(axis=1) / np.linalg.norm(towards, axis=1)
        shares.append((cosine > 0.3).mean())
        found = register(model, look(surface, np.eye(4), camera), np.eye(4), 1e-12 * np.eye(6))
        assert found.facing == shares[-1]
        assert shows_model(found) == (shares[-1] >= 0.03)
        assert shows_model(found) or not is_found(found)
    assert min(shares) < 0.03 < max(shares)


def test_a_side_of_which_hardly_anything_is_known_is_learnt():
    """A sure view of it is merged, though next to nothing of what is known faces the camera."""
    mesh = trimesh.creation.icosphere(4, 0.045)
    surface, cloud = Raycaster(mesh.vertices, mesh.faces), FusedCloud.empty(0.003, smooth=True)
    cameras = [camera_at([0.35 * np.cos(a), 0.35 * np.sin(a), 0.0]) for a in (-0.1, 0.0, 0.1)]
    for camera in cameras:
        cloud = cloud.merged(look(surface, np.eye(4), camera).points_W, camera[:3, 3])
    model = TrackedModel(complete_shape(cloud, max_points=320))
    views, learnt = ViewRecord(np.stack([X[:3, 3] for X in cameras]), np.zeros(3)), []
    for angle in np.linspace(1.8, 3.0, 25):
        view = look(surface, np.eye(4), camera_at([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.0]))
        found = register(model, view, np.eye(4), 1e-12 * np.eye(6))
        if 0.0 < found.facing < 0.03:
            key = keyframe_of(view, np.eye(4), 1.0, 1e-3)
            learnt.append(is_accepted(found) and is_worth_merging(key, found, 0.0, views))
    assert len(learnt) > 0 and all(learnt)


def test_what_something_nearer_hides_is_not_in_view(shape):
    _, surface, model = shape
    view, fixed = look(surface, np.eye(4), camera_at([0.25, 0.2, 0.2])), 1e-12 * np.eye(6)
    hidden = view.points_C[:, 0] < 0.0
    depth = view.depth.copy()
    depth[:, : depth.shape[1] // 2] = 0.1
    half = register(
        model, ObjectView(view.camera, view.X_WC, view.points_W[~hidden], depth), np.eye(4), fixed
    )
    assert half.inside == 1.0 and half.covered > 0.9
    assert half.in_view == pytest.approx(1.0 - hidden.mean(), abs=0.15)


def test_what_comes_into_the_image_does_not_pull_along_the_object():
    """Of a beam the first image showed one end only; where the other is, nobody knows."""
    mesh = trimesh.creation.box((0.05, 0.07, 0.3))
    surface, camera = Raycaster(mesh.vertices, mesh.faces), camera_at([0.4, 0.1, 0.0])
    aside = camera @ se3.make_pose(se3.so3_exp([0.25, 0.0, 0.0]), np.zeros(3))
    first = look(surface, np.eye(4), aside)
    ended = first.camera.to_border(first.points_C) < 4.0
    assert 0 < ended.sum() < 0.1 * len(ended)
    cloud = FusedCloud.empty(0.003, smooth=True).merged(first.points_W, aside[:3, 3])
    gpdf = complete_shape(cloud, max_points=320)
    whole = look(surface, np.eye(4), camera)
    along = [
        abs(register(TrackedModel(gpdf, cut), whole, np.eye(4), PRIOR).X_WO[2, 3])
        for cut in (first.points_W[ended], np.zeros((0, 3)))
    ]
    assert along[0] < 1.5e-3 < 4e-3 < along[1]
