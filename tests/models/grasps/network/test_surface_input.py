"""Network inputs: even points, chords and deviations, on shapes known in closed form."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from feasigrasp.errors import GraspError
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.network import surface_input
from feasigrasp.models.grasps.network.surface_input import (
    MAX_CHORD,
    SCALARS,
    GraspInput,
    grasp_input,
)
from feasigrasp.models.shape.completion import CompletedField, complete_shape
from feasigrasp.models.shape.gpdf import fit_field, fit_gpdf

DEVIATION, CHORD, COSINE, FAR = range(len(SCALARS))
RADIUS = 0.03


@pytest.fixture(scope="module")
def ball():
    """A ball seen from four sides."""
    cloud = FusedCloud.empty(0.003, smooth=True)
    points = sphere_points(4000, RADIUS)
    for direction in np.array(
        [[0, 0, 1], [0, 0.94, -0.33], [0.82, -0.47, -0.33], [-0.82, -0.47, -0.33]]
    ):
        cloud = cloud.merged(points[points @ direction > 0.2 * RADIUS], 0.5 * direction)
    return complete_shape(cloud, max_points=320)


def test_points_normals_and_chords_of_a_ball(ball):
    made = grasp_input(ball, 256)
    assert len(made) == 256
    assert made.points.dtype == made.normals.dtype == made.scalars.dtype == np.float32
    radius = np.linalg.norm(made.points, axis=1)
    assert np.abs(radius - RADIUS).max() < 0.002
    outward = np.einsum("ij,ij->i", made.points, made.normals) / radius
    assert np.median(outward) > 0.99 and outward.min() > 0.85
    chord = made.scalars[:, CHORD]
    assert (chord > 0).mean() > 0.98
    # Along a normal that is t off the radius the chord is 2 R cos t.
    np.testing.assert_allclose(chord[chord > 0], 2 * (radius * outward)[chord > 0], atol=0.002)
    assert np.median(made.scalars[:, COSINE]) < -0.97


def test_even_spacing(ball):
    points = grasp_input(ball, 256).points
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    completed = ball.completion.points
    before = cKDTree(completed).query(completed, k=2)[0][:, 1]
    assert nearest.std() / nearest.mean() < 0.25 < before.std() / before.mean()


def slab_field(thickness):
    x, y = (part.ravel() for part in np.meshgrid(*[np.linspace(-0.05, 0.05, 26)] * 2))
    top = np.column_stack([x, y, np.full_like(x, thickness / 2)])
    cloud = FusedCloud.empty(0.003, smooth=True)
    cloud = cloud.merged(top, [0.0, 0.0, 0.5])
    return complete_shape(cloud.merged(top * [1, 1, -1], [0.0, 0.0, -0.5]), max_points=320)


@pytest.mark.parametrize("thickness", [0.006, 0.03])
def test_chord_through_a_slab(thickness):
    made = grasp_input(slab_field(thickness), 400)
    middle = (np.abs(made.points[:, :2]).max(axis=1) < 0.035) & (
        np.abs(np.abs(made.points[:, 2]) - thickness / 2) < 0.002
    )
    assert middle.sum() > 40
    assert np.median(made.scalars[middle, CHORD]) == pytest.approx(thickness, abs=0.001)
    assert np.median(made.scalars[middle, COSINE]) < -0.95


@pytest.mark.parametrize(("apart", "chord"), [(0.06, 0.06), (0.11, 0.01)])
def test_chord_through_two_walls(apart, chord):
    """Of two walls that fit between the pads it ends on the other one, else on this one."""
    y, z = (part.ravel() for part in np.meshgrid(*[np.linspace(-0.04, 0.04, 21)] * 2))
    wall = np.column_stack([np.full_like(y, apart / 2), y, z])
    nodes, depth = [], []
    for side in (1.0, -1.0):
        for behind, value in ((0.0, 0.0), (0.002, -0.002), (0.005, -0.005), (0.01, 0.0)):
            nodes.append((wall - [behind, 0.0, 0.0]) * [side, 1.0, 1.0])
            depth.append(np.full(len(wall), value))
        nodes.append((wall + [0.003, 0.0, 0.0]) * [side, 1.0, 1.0])
        depth.append(np.full(len(wall), 0.003))
        nodes.append((wall - [0.015, 0.0, 0.0]) * [side, 1.0, 1.0])
        depth.append(np.full(len(wall), 0.005))
    points = np.concatenate([part for part, d in zip(nodes, depth, strict=True) if d[0] == 0.0])
    field = fit_field(
        np.concatenate(nodes),
        np.exp(-np.concatenate(depth) / 0.3),
        points=points,
        bounds=np.stack([points.min(axis=0), points.max(axis=0)]),
        length_scale=0.3,
        noise_variance=1e-4,
    )
    made = grasp_input(field, 400)
    outer = (np.abs(made.points[:, 0]) > apart / 2 - 0.002) & (
        np.abs(made.points[:, 1:]).max(axis=1) < 0.025
    )
    outer &= np.abs(made.normals[:, 0]) > 0.95
    assert outer.sum() > 30
    assert np.median(made.scalars[outer, CHORD]) == pytest.approx(chord, abs=0.0015)


def test_no_chord_beyond_reach(ball, monkeypatch):
    monkeypatch.setattr(surface_input, "MAX_CHORD", 0.04)
    made = grasp_input(ball, 64)
    assert (made.scalars[:, CHORD] == 0.0).mean() > 0.9
    none = made.scalars[:, CHORD] == 0.0
    assert (made.scalars[none][:, [COSINE, FAR]] == 0.0).all()
    assert MAX_CHORD > 0.085


def test_unseen_surface_is_less_sure():
    cloud = FusedCloud.empty(0.003, smooth=True)
    points = sphere_points(4000, RADIUS)
    field = complete_shape(cloud.merged(points[points[:, 2] > 0.005], [0, 0, 0.5]), max_points=320)
    made = grasp_input(field, 300)
    seen, hidden = made.points[:, 2] > 0.008, made.points[:, 2] < -0.008
    assert made.scalars[hidden, DEVIATION].min() > 3 * np.median(made.scalars[seen, DEVIATION])
    # What a chord from there ends on may be hidden.
    chord = made.scalars[:, CHORD]
    ends = made.points - chord[:, None] * made.normals
    below = seen & (chord > 0) & (ends[:, 2] < -0.008)
    assert below.sum() > 5
    assert made.scalars[below, FAR].min() > 3 * np.median(made.scalars[seen, DEVIATION])


def test_scalars_do_not_change_with_the_pose():
    """The same field in another frame: points move along, scalars stay."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.random(random_state=4).as_matrix(), [0.2, -0.1, 0.3]
    points = sphere_points(400, 1.0) * [0.02, 0.03, 0.045]
    still = grasp_input(fit_gpdf(points, max_points=200), 200)
    # The completion's grid does not turn with the cloud, its nodes do: compare at those.
    moved = grasp_input(fit_gpdf(points @ X[:3, :3].T + X[:3, 3], max_points=200), 200)
    apart, partner = cKDTree(still.points @ X[:3, :3].T + X[:3, 3]).query(moved.points)
    same = apart < 1e-4
    assert same.sum() > 30
    turned = still.normals[partner[same]] @ X[:3, :3].T
    assert np.einsum("ij,ij->i", turned, moved.normals[same]).min() > 0.99
    difference = np.abs(still.scalars[partner[same]] - moved.scalars[same])
    assert np.percentile(difference[:, CHORD], 90) < 0.002
    assert np.percentile(difference[:, DEVIATION], 90) < 1e-4


def test_same_field_same_input(ball):
    first, again = grasp_input(ball, 128), grasp_input(ball, 128)
    np.testing.assert_array_equal(first.scalars, again.scalars)
    np.testing.assert_array_equal(first.points, again.points)


def test_smoothed_normals_are_handed_on(ball):
    assert isinstance(ball, CompletedField)
    assert ball.cloud_normals.shape == ball.cloud.shape


def test_wrong_input_is_refused():
    with pytest.raises(GraspError, match="normals"):
        GraspInput(np.zeros((3, 3)), np.zeros((2, 3)), np.zeros((3, 4)))
    with pytest.raises(GraspError, match="NaN"):
        GraspInput(np.full((3, 3), np.nan), np.zeros((3, 3)), np.zeros((3, 4)))
