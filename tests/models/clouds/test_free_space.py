"""Free space of a view against the ball and the camera that made it."""

import numpy as np
import pytest

from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.clouds.view_image import SIDE, free_distance, rim_points, view_image
from feasigrasp.models.geometry import se3

RADIUS = 0.04
CAMERA = np.array([0.0, 0.0, 0.5])


def ball_view(camera=CAMERA, pitch=0.0045, radius=RADIUS):
    """Points where a pinhole camera's rays hit a ball about the origin."""
    z = -camera / np.linalg.norm(camera)
    x = np.cross(z, [0.3, 0.5, 0.1])
    x /= np.linalg.norm(x)
    at = np.arange(-60, 61) * pitch
    u, v = (a.ravel() for a in np.meshgrid(at, at))
    rays = z + u[:, None] * x + v[:, None] * np.cross(z, x)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    b = rays @ camera
    root = b**2 - camera @ camera + radius**2
    hit = root > 0
    return camera + (-b[hit] - np.sqrt(root[hit]))[:, None] * rays[hit]


@pytest.fixture(scope="module")
def image():
    return view_image(ball_view(), CAMERA)


def test_the_picture_shows_a_disc_at_its_depth(image):
    rays = image.rays()
    angle = np.arctan(np.linalg.norm(rays[..., :2], axis=-1))
    rim = np.arcsin(RADIUS / 0.5)
    assert image.mask[angle < rim - 0.006].all()
    assert not image.mask[angle > rim + 0.006].any()
    middle = image.depth[SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1]
    np.testing.assert_allclose(middle, 0.5 - RADIUS, atol=5e-4)
    assert image.pitch == pytest.approx(0.0045, rel=0.03)


def test_pixels_project_back(image):
    rows, columns = np.nonzero(image.mask)
    points = image.unproject((rows, columns), image.depth[rows, columns])
    assert np.abs(np.linalg.norm(points, axis=1) - RADIUS).mean() < 1e-3
    np.testing.assert_allclose(image.project(points)[2], image.depth[rows, columns])


def test_it_is_a_lower_bound_of_the_distance_to_the_ball(image):
    x = np.random.default_rng(0).uniform(-0.15, 0.15, (5000, 3))
    free = free_distance([image], x)
    true = np.linalg.norm(x, axis=1) - RADIUS
    beside = np.linalg.norm(np.cross(x - CAMERA, -CAMERA / 0.5), axis=1) > 0.06
    assert (free[beside] > 0.0).all()
    # In front of the ball the depth to it is longer than the way; beside it, it bounds it.
    assert (free[beside] < true[beside] + 2e-3).all()
    assert np.corrcoef(free[beside], true[beside])[0, 1] > 0.7


def test_the_ball_and_what_it_hides_are_not_free(image):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    on_ball = free_distance([image], RADIUS * directions)
    # At the rim the ball falls away under the picture's coarse pixels.
    assert np.mean(on_ball < 3e-3) > 0.97
    assert on_ball.max() < 6e-3
    assert free_distance([image], 0.9 * RADIUS * directions).max() < 0.0
    shadow = np.array([[0.0, 0.0, -0.1], [0.02, 0.01, -0.2]])
    assert (free_distance([image], shadow) < 0.0).all()
    assert free_distance([image], np.array([[0.0, 0.0, 0.1]]))[0] == pytest.approx(0.06, abs=1e-3)


def test_a_second_view_frees_what_the_first_one_hides(image):
    other = np.array([0.5, 0.0, 0.0])
    second = view_image(ball_view(other), other)
    hidden = np.array([[0.0, 0.0, -0.1]])
    assert free_distance([image], hidden)[0] < 0.0 < free_distance([image, second], hidden)[0]


def test_nothing_is_known_without_views():
    assert (free_distance([], np.zeros((3, 3))) < 0.0).all()


def test_rim_points_are_free_and_just_outside(image):
    points = rim_points(image, 40)
    assert 10 < len(points) <= 40
    free = free_distance([image], points)
    assert (free > 0.0).all()
    across = np.linalg.norm(np.cross(points - CAMERA, -CAMERA / 0.5), axis=1)
    assert across.min() > RADIUS
    assert across.max() < RADIUS + 0.02
    angle = np.sort(np.arctan2(*points[:, :2].T))
    assert np.diff(angle).max() < np.deg2rad(60)  # all round


def test_it_moves_with_object_and_camera(image):
    X = se3.random_pose(np.random.default_rng(3), 1)[0]
    x = np.random.default_rng(4).uniform(-0.1, 0.1, (500, 3))
    np.testing.assert_allclose(
        free_distance([image.moved(X)], x @ X[:3, :3].T + X[:3, 3]),
        free_distance([image], x),
        atol=1e-9,
    )


@pytest.mark.parametrize("points", [np.zeros((30, 3)), np.tile([[0.0, 0.01, 0.0]], (40, 1))])
def test_points_all_in_one_place_make_a_picture(points):
    assert view_image(points, CAMERA).mask.any()


@pytest.fixture(scope="module")
def parts():
    """Of a ball: points with a depth, points without one between them, and points beyond."""
    x = ball_view() @ np.array([1.0, 0.2, 0.0])
    return ball_view()[np.abs(x) > 0.01], ball_view()[np.abs(x) < 0.008], ball_view()[x > 0.02]


@pytest.mark.parametrize("of", ["unmeasured", "hidden"])
def test_what_may_be_the_object_is_not_free(parts, of):
    measured, between, _ = parts
    rays = {"unmeasured": np.zeros((0, 3)), "hidden": np.zeros((0, 3))} | {of: between - CAMERA}
    plain, outlined = (view_image(measured, CAMERA, outline) for outline in (None, Outline(**rays)))
    assert free_distance((plain,), between).max() > 0.003
    assert free_distance((outlined.reliable,), between).max() <= 0.0
    if of == "hidden":  # for the shape a guess is good enough
        np.testing.assert_array_equal(*(free_distance((i,), between) for i in (plain, outlined)))
    else:
        assert free_distance((outlined,), between).max() <= 0.0
    angle = np.linspace(-0.7, 0.7, 100)  # far from the band
    beside = 0.07 * np.stack([np.cos(angle), np.sin(angle), np.zeros(100)], axis=1)
    known = free_distance((outlined.reliable,), beside)
    assert outlined.reliable.whole and known.min() > 0.005
    np.testing.assert_allclose(known, free_distance((plain,), beside), atol=1e-12)


def test_rim_points_have_the_depth_of_the_silhouette_beside_what_is_unclear(parts):
    measured, between, _ = parts
    points = rim_points(view_image(measured, CAMERA, Outline(between - CAMERA, [])).reliable, 60)
    assert np.abs(points[:, 2]).max() < 0.12  # not in the camera, where nothing was measured


def test_a_silhouette_has_the_parts_without_depth(parts):
    """Where the band was, the picture of the ball is as if it had been measured, but for noise."""
    measured, between, end = parts
    whole, outlined = (
        view_image(points, CAMERA, outline)
        for points, outline in (
            (ball_view(), None),
            (measured, Outline(between - CAMERA, [])),
        )
    )
    assert np.mean(whole.mask != outlined.mask) < 0.02
    band = whole.mask & outlined.mask & ~outlined.measured
    error = np.abs(whole.depth - outlined.depth)
    assert band.sum() > 40 and np.median(error[band]) < 0.003
    assert np.mean(error[band] < 2.0 * outlined.deviation[band] + 0.001) > 0.9
    assert (outlined.deviation[outlined.measured] == 0.0).all()
    # Most of it is out of what was measured.
    rest = view_image(end, CAMERA, Outline(ball_view() - CAMERA, []))
    assert np.mean(whole.mask != rest.mask) < 0.05
    assert not view_image(end, CAMERA, Outline([], [], whole=False)).reliable.whole
