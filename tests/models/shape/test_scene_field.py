"""The scene field against planes and boxes; hand and arm against it."""

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from feasigrasp.errors import PointCloudError
from feasigrasp.models.grasps.hand_clearance import scene_clear
from feasigrasp.models.robot.capsules import arm_balls
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.scene_field import fit_scene
from feasigrasp.resources import model_path
from feasigrasp_lab.arm import IIWA_CAPSULES

CAMERA = np.array([0.2, -0.8, 1.2])
BOX_CENTER, BOX_HALF = np.array([0.5, 0.1, 0.15]), np.array([0.1, 0.1, 0.15])


def box_distance(x):
    q = np.abs(x - BOX_CENTER) - BOX_HALF
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def true_distance(x):
    """Distance to the box on the table top z = 0."""
    return np.minimum(x[:, 2], box_distance(x))


def desk(noise, step=0.005, seed=0):
    """Cloud of a table with a box on it, all five sides of which are seen."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(-0.3, 1.1, step), np.arange(-0.6, 0.6, step), indexing="ij")
    table = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    table = table[box_distance(table) > 0.002]
    u = rng.uniform(-1.0, 1.0, (12000, 3))
    side = rng.integers(0, 5, len(u))
    u[side < 2, 0] = np.sign(u[side < 2, 0])
    u[(side == 2) | (side == 3), 1] = np.sign(u[(side == 2) | (side == 3), 1])
    u[side == 4, 2] = 1.0
    cloud = np.concatenate([table, BOX_CENTER + BOX_HALF * u])
    return cloud + rng.normal(scale=noise, size=cloud.shape)


def directions(cloud):
    """Towards cameras all round: those of the box look outwards, those of the table up."""
    outwards = np.where(
        (box_distance(cloud) < 0.01)[:, None], cloud - BOX_CENTER * [1, 1, 0], [0.0, 0.0, 1.0]
    )
    return outwards + [0.0, 0.0, 0.1]


@pytest.fixture(scope="module")
def scene():
    cloud = desk(0.001)
    return fit_scene(cloud, directions(cloud))


@pytest.fixture(scope="module")
def table():
    """A table alone, without the hole that a box leaves."""
    x, y = np.meshgrid(np.arange(-0.3, 1.1, 0.005), np.arange(-0.6, 0.6, 0.005))
    z = np.random.default_rng(0).normal(scale=0.001, size=x.size)
    return fit_scene(np.column_stack([x.ravel(), y.ravel(), z]), CAMERA)


def queries(n, low=0.005, seed=1):
    x = np.random.default_rng(seed).uniform([-0.1, -0.4, 0.0], [0.9, 0.4, 0.6], (n, 3))
    return x[true_distance(x) > low]


def test_distances_are_those_of_plane_and_box(scene):
    x = queries(2000)
    error = 1e3 * (scene.distance(x) - true_distance(x))
    assert np.abs(error).mean() < 2.5
    assert np.abs(np.median(error)) < 1.0
    assert np.percentile(np.abs(error), 95) < 8.0


def test_marching_down_the_gradient_of_one_field_would_not_do(scene):
    """What the module says of the plain refinement: why the nearest point comes first."""
    from feasigrasp.models.shape.gpdf import fit_gpdf

    cloud = desk(0.001)
    x = queries(300)
    plain, _, _ = fit_gpdf(cloud, max_points=600, viewpoint=CAMERA).refine(x, 8)
    assert np.abs(plain - true_distance(x)).mean() > 0.015
    assert np.abs(scene.distance(x) - true_distance(x)).mean() < 0.003


def test_noise_averages_out_where_the_nearest_point_is_too_near():
    cloud = desk(0.003)
    x = queries(2000)
    scene = fit_scene(cloud, directions(cloud))
    nearest = cKDTree(cloud[::9]).query(x)[0]
    assert np.median(nearest - true_distance(x)) < -0.0015
    assert np.abs(np.median(scene.distance(x) - true_distance(x))) < 0.0015
    assert np.abs(scene.distance(x) - true_distance(x)).mean() < 0.0035


def test_gradients_are_unit_and_point_away_from_the_nearest_surface(scene):
    x = queries(1000, low=0.03)
    gradient = scene.distance_and_gradient(x)[1]
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-9)
    h = 1e-6
    true = np.column_stack(
        [true_distance(x + h * e) - true_distance(x - h * e) for e in np.eye(3)]
    ) / (2 * h)
    cosine = np.einsum("mi,mi->m", gradient, true)
    assert np.median(cosine) > 0.999
    assert np.percentile(cosine, 10) > 0.97


def test_behind_a_surface_is_inside_as_deep_as_it_is_thick(table):
    below = np.array([[0.3, 0.0, -z] for z in (0.003, 0.01, 0.03, 0.045)])
    distance, gradient = table.distance_and_gradient(below)
    np.testing.assert_allclose(distance, below[:, 2], atol=1e-3)
    assert (gradient[:, 2] > 0.98).all()
    assert table.distance([[0.3, 0.0, -0.08]])[0] == pytest.approx(0.08, abs=1e-3)
    # Beside the table's rim is not behind its surface.
    assert table.distance([[-0.33, 0.0, -0.01]])[0] > 0.02


def test_closer_than_is_the_distance_compared(scene):
    x = np.random.default_rng(3).uniform([0.2, -0.2, -0.04], [0.8, 0.4, 0.4], (3000, 3))
    for margin in (0.0, 0.02, 0.1):
        np.testing.assert_array_equal(scene.closer_than(x, margin), scene.distance(x) < margin)


def test_the_field_moves_with_the_scene():
    cloud = desk(0.001)[::3]
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).as_matrix()
    X[:3, 3] = [1.0, -2.0, 0.5]
    x = queries(500)
    here = fit_scene(cloud, CAMERA).distance(x)
    there = fit_scene(cloud @ X[:3, :3].T + X[:3, 3], X[:3, :3] @ CAMERA + X[:3, 3])
    moved = there.distance(x @ X[:3, :3].T + X[:3, 3])
    assert np.median(np.abs(here - moved)) < 2e-3  # voxels lie differently


def test_isolated_points_stand_for_themselves():
    cloud = np.concatenate([desk(0.001)[::3], [[0.0, 0.0, 1.5], [0.02, 0.0, 1.5]]])
    scene = fit_scene(cloud, CAMERA)
    distance, gradient = scene.distance_and_gradient([[0.0, 0.1, 1.5]])
    assert distance[0] == pytest.approx(0.1, abs=1e-9)
    np.testing.assert_allclose(gradient[0], [0.0, 1.0, 0.0], atol=1e-9)


def hand_poses():
    down = np.diag([1.0, -1.0, -1.0])
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, :3] = down
    tip = ParallelGripper().tip
    poses[:, :3, 3] = [
        [0.1, 0.0, tip + 0.02],  # clear of the table
        [0.1, 0.0, tip - 0.01],  # fingers in the table
        [0.5, 0.1, 0.3 + tip + 0.02],  # above the box
        [0.5, 0.0, 0.2],  # a finger in the box
    ]
    return poses


def test_the_open_hand_keeps_clear_of_table_and_box(scene):
    clear = scene_clear(scene, hand_poses(), ParallelGripper(), 0.005)
    np.testing.assert_array_equal(clear, [True, False, True, False])
    assert not scene_clear(scene, hand_poses()[:1], ParallelGripper(), margin=0.03)[0]
    assert scene_clear(scene, np.zeros((0, 4, 4)), ParallelGripper(), 0.005).shape == (0,)


def test_random_hand_poses_agree_with_the_true_distance(scene):
    rng, gripper = np.random.default_rng(5), ParallelGripper()
    poses = np.tile(np.eye(4), (400, 1, 1))
    poses[:, :3, :3] = Rotation.random(400, random_state=5).as_matrix()
    poses[:, :3, 3] = rng.uniform([0.2, -0.2, 0.0], [0.8, 0.4, 0.5], (400, 3))
    hand = gripper.surface_points(gripper.max_opening)
    points = np.einsum("nij,kj->nki", poses[:, :3, :3], hand) + poses[:, None, :3, 3]
    least = true_distance(points.reshape(-1, 3)).reshape(400, -1).min(axis=1)
    clear = scene_clear(scene, poses, gripper, margin=0.01)
    deep = least > -0.045  # deeper than that nothing is known to be solid
    reliable = deep & (np.abs(least - 0.01) > 0.006)
    assert reliable.sum() > 150
    assert np.mean(clear[reliable] == (least[reliable] > 0.01)) > 0.98


def test_balls_cover_the_capsules():
    balls, rng = arm_balls(IIWA_CAPSULES), np.random.default_rng(2)
    for c in IIWA_CAPSULES.movers:
        r, (a, b) = IIWA_CAPSULES.radius[c], IIWA_CAPSULES.ends[c]
        away = rng.normal(size=(200, 3))
        away *= r / np.linalg.norm(away, axis=1, keepdims=True)
        surface = a + rng.random((200, 1)) * (b - a) + 0.968 * away
        of_link = balls.link == IIWA_CAPSULES.link[c]
        gap = np.linalg.norm(surface[:, None] - balls.center[None, of_link], axis=2)
        assert (gap - balls.radius[of_link]).min(axis=1).max() < 1e-9


@pytest.fixture(scope="module")
def in_the_world():
    """``in_the_world(q, link, points)``: points of links' frames in the world, by Drake."""
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    (iiwa,) = parser.AddModels(str(model_path("iiwa", "iiwa7.urdf")))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("iiwa_link_0", iiwa))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    bodies = [plant.GetBodyByName(f"iiwa_link_{k}", iiwa) for k in range(8)]

    def place(q, link, points):
        plant.SetPositions(context, iiwa, q)
        poses = [plant.EvalBodyPoseInWorld(context, body) for body in bodies]
        return np.array([poses[k] @ point for k, point in zip(link, points, strict=True)])

    return place


def configurations_above_the_table(in_the_world, count):
    """The balls' places in random configurations whose capsules are above the table's middle."""
    rng, balls, found = np.random.default_rng(4), arm_balls(IIWA_CAPSULES), []
    home = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 0.8, 0.0])
    while len(found) < count:
        q = home + rng.uniform(-1.0, 1.0, 7) * [0.5, 0.6, 1, 0.6, 1, 1, 1]
        x = in_the_world(q, balls.link, balls.center)
        if x[:, 2].min() > 0.02 and np.abs(x[:, 1]).max() < 0.45 and x[:, 0].min() > -0.2:
            found.append(x)
    return found


def test_arm_distances_above_a_table_are_the_heights_of_its_balls(table, in_the_world):
    radius = arm_balls(IIWA_CAPSULES).radius
    for x in configurations_above_the_table(in_the_world, 20):
        if x[:, 0].max() < 0.9:
            distance = np.minimum(table.distance(x) - radius, 0.25)
            np.testing.assert_allclose(distance, np.minimum(x[:, 2] - radius, 0.25), atol=4e-3)


@pytest.mark.parametrize(
    ("cloud", "view", "message"),
    [
        (np.zeros((3, 3)), CAMERA, "3 points of the scene"),
        (np.full((20, 3), np.nan), CAMERA, "NaN"),
        (np.zeros((20, 2)), CAMERA, "points has shape"),
        (desk(0.0)[::50], [0.0, 1.0], "viewpoint has shape \\(2,\\)"),
    ],
)
def test_clouds_that_cannot_be_fitted_are_refused(cloud, view, message):
    with pytest.raises(PointCloudError, match=message):
        fit_scene(cloud, view)


def test_queries_that_are_no_points_are_refused(table):
    with pytest.raises(PointCloudError, match="NaN or infinity"):
        table.distance([[0.0, np.nan, 0.0]])
