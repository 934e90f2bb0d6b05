"""The completed shape against the body that was looked at, and what it says about itself."""

import copy

import numpy as np
import pytest

from feasigrasp.errors import PointCloudError
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp_lab.paper.field import PAPER

RADIUS = 0.04
CAMERA = np.array([0.0, 0.0, 0.5])


def seen(camera, noise=0.0):
    """The part of a ball that faces the camera, with noise along the rays."""
    rng = np.random.default_rng(0)
    points = RADIUS * sphere_points(4000, 1.0)
    points = points[points @ camera > 1.2 * RADIUS**2]
    rays = (camera - points) / np.linalg.norm(camera - points, axis=1, keepdims=True)
    return points + rng.normal(scale=noise, size=(len(points), 1)) * rays


def cloud_of(*cameras, noise=1e-3, smooth=True):
    cloud = FusedCloud.empty(0.003, smooth=smooth)
    for camera in cameras:
        cloud = cloud.merged(seen(camera, noise), camera)
    return cloud


@pytest.fixture(scope="module")
def field():
    return complete_shape(cloud_of(CAMERA))


def test_free_space_closes_the_hidden_side(field):
    hidden = RADIUS * sphere_points(300, 1.0)
    hidden = hidden[hidden[:, 2] < -0.2 * RADIUS]
    paper = complete_shape(cloud_of(CAMERA, smooth=False), preset="paper")
    ours, theirs = (np.abs(f.refine(hidden, 10)[0]).mean() for f in (field, paper))
    assert ours < 0.009
    assert ours < 0.75 * theirs


def test_completed_points_are_possible_and_known_to_be_uncertain(field):
    surface = field.completion
    assert field.possible(surface.points).all()
    front, back = surface.points[:, 2] > 0.02, surface.points[:, 2] < -0.01
    assert front.sum() > 20
    assert back.sum() > 20
    variance = field.variance(surface.points)
    assert variance[front].max() < variance[back].min()


def test_points_the_camera_looked_through_are_not_possible(field):
    free = np.array([[0.08, 0.0, 0.0], [0.0, -0.1, -0.05], [0.0, 0.0, 0.08]])
    assert not field.possible(free).any()
    assert field.possible(seen(CAMERA)).all()
    assert field.possible(np.array([[0.0, 0.0, -0.1]])).all()  # hidden: who knows


def test_free_space_begins_close_to_the_surface(field):
    """Eight millimetres in front of what was seen and twelve beside the silhouette it is free."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(24)], axis=1)
    assert not field.possible((RADIUS + 0.012) * circle).any()
    assert field.possible((RADIUS + 0.001) * circle).all()
    front = seen(CAMERA)[::50]
    outward = front / np.linalg.norm(front, axis=1, keepdims=True)
    facing = outward @ CAMERA / np.linalg.norm(CAMERA) > 0.8
    assert not field.possible((front + 0.008 * outward)[facing]).any()
    assert field.possible((front + 0.001 * outward)[facing]).all()


def test_variance_counts_the_observed_nodes_alone(field):
    """In front of the object, the same as that of a field that never had the others."""
    x = np.random.default_rng(1).uniform(-0.08, 0.08, (500, 3))
    x = x[np.linalg.norm(x, axis=1) > 1.1 * RADIUS]
    x = x[x @ CAMERA > 0.8 * np.linalg.norm(x, axis=1) * np.linalg.norm(CAMERA)]
    assert len(x) > 10
    nodes = field.nodes[:, : field.observed].T + field.center
    noise = field.noise_variance[: field.observed]

    def kernel(a, b):
        return np.exp(-np.linalg.norm(a[:, None] - b[None], axis=-1) / field.length_scale)

    cross = kernel(x, nodes)
    gram = kernel(nodes, nodes) + np.diag(noise)
    expected = 1.0 - np.einsum("ij,ji->i", cross, np.linalg.solve(gram, cross.T))
    assert field.observed < field.nodes.shape[1]
    np.testing.assert_allclose(field.variance(x), expected, atol=1e-8)


def test_the_far_side_of_a_thin_wall_is_known_to_be_unseen():
    side = np.linspace(-0.05, 0.05, 60)
    near = np.stack([*np.meshgrid(side, side), np.zeros((60, 60))], axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    seen = near + rng.normal(scale=5e-4, size=near.shape) * [0.0, 0.0, 1.0]
    cloud = FusedCloud.empty(0.004, smooth=True).merged(seen, CAMERA)
    wall = complete_shape(cloud, max_points=320)
    x = rng.uniform(-0.045, 0.045, (500, 2))
    near, far = (np.column_stack([x, np.full(len(x), z)]) for z in (0.0, -0.003))
    assert np.quantile(wall.variance(near), 0.99) < np.quantile(wall.variance(far), 0.01)


def test_three_views_of_a_ball_make_a_ball():
    cameras = 0.5 * np.array([[0, 0, 1], [0.87, 0, -0.5], [-0.87, 0, -0.5]])
    field = complete_shape(cloud_of(*cameras))
    around = RADIUS * sphere_points(300, 1.0)
    assert np.abs(field.refine(around)[0]).mean() < 6e-4


def test_the_paper_preset_is_the_papers_field():
    cloud = cloud_of(CAMERA, smooth=False)
    ours = complete_shape(cloud, preset="paper", max_points=200)
    expected = fit_gpdf(cloud.points, viewpoint=cloud.directions, max_points=200, **PAPER)
    x = np.random.default_rng(2).uniform(-0.1, 0.1, (100, 3))
    np.testing.assert_array_equal(ours.distance(x), expected.distance(x))


def test_wrong_input_is_refused():
    with pytest.raises(PointCloudError, match="smooth=True"):
        complete_shape(cloud_of(CAMERA, smooth=False))
    with pytest.raises(PointCloudError, match="choose one of default, paper"):
        complete_shape(cloud_of(CAMERA), preset="best")
    with pytest.raises(PointCloudError, match="max_points"):
        complete_shape(cloud_of(CAMERA), max_points=2)
    with pytest.raises(PointCloudError, match=r"every point is below; turn its normal up"):
        complete_shape(cloud_of(CAMERA), table=[0.0, 0.0, -1.0, -RADIUS])


def test_it_is_immutable(field):
    assert copy.deepcopy(field) is field
    with pytest.raises(ValueError, match="read-only"):
        field.nodes[0] = 0.0
