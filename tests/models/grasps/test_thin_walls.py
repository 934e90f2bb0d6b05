"""A bowl: the inside is free once it was seen, and grasps of the rim stay from view to view."""

import numpy as np
import pytest

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.grasps.non_maximum_suppression import recheck_grasps
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.grids import object_grid
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.views import ViewedObject, look_at

GRIPPER = ParallelGripper()
ABOVE, ASIDE, BELOW = (0.1, 0.0, 0.5), (0.15, 0.05, 0.5), (0.1, 0.0, -0.5)


@pytest.fixture(scope="module")
def bowl():
    return ViewedObject(load_object("bowl"))


@pytest.fixture(scope="module")
def truth(bowl):
    return TrueGrasps(bowl.obj.mesh)


def seen_from(bowl, *cameras):
    rng, cloud = np.random.default_rng(0), FusedCloud.empty(0.003, smooth=True)
    for camera in cameras:
        view = bowl.view(look_at(np.array(camera), 0.3), rng)
        cloud = cloud.merged(view.points, view.p_OC)
    return complete_shape(cloud)


def room_inside(bowl, truth):
    """Points in the bowl, between its opening and its floor, at least 12 mm from it, (n, 3)."""
    rng = np.random.default_rng(1)
    x = rng.uniform(bowl.obj.vertices.min(axis=0), bowl.obj.vertices.max(axis=0), (4000, 3))
    at, _ = truth.closest(x)
    beside = np.hypot(*x[:, :2].T) < 0.04
    apart = np.linalg.norm(at - x, axis=1) > 0.012
    return x[beside & apart & (x[:, 2] > at[:, 2])]


def test_a_finger_may_enter_what_was_looked_into(bowl, truth):
    x = room_inside(bowl, truth)
    assert len(x) > 100
    looked_into = object_grid(seen_from(bowl, BELOW, ABOVE)).distance_and_gradient(x)[0]
    assert np.mean(looked_into > 0.002) > 0.98
    unobserved = object_grid(seen_from(bowl, BELOW)).distance_and_gradient(x)[0]
    assert np.mean(unobserved < 0.002) > 0.75


def test_grasps_of_a_rim_are_known_again(bowl, truth):
    field, next_field = seen_from(bowl, ABOVE), seen_from(bowl, ABOVE, ASIDE)
    grasps = NetworkSampler(GRIPPER)(field)
    numbered = grasps.select(np.arange(len(grasps)))
    assert np.mean(grasps.width < 0.01) > 0.9
    again = recheck_grasps(next_field, numbered, GRIPPER)
    assert len(again) > 0.8 * len(grasps)
    assert (np.diff(again.score) <= 0.0).all()
    assert truth.valid(again.X_OG, GRIPPER).mean() > 0.9


@pytest.mark.parametrize("radius", [0.045, 0.06])
def test_a_body_wider_than_the_hand_is_no_wall(radius):
    """One view shows a cap of it that would fit between the fingers."""
    camera = np.array([0.0, 0.0, -0.45])
    points = radius * sphere_points(4000, 1.0)
    points = points[points @ (camera / 0.45) > 1.3 * radius**2 / 0.45]
    cloud = FusedCloud.empty(0.003, smooth=True).merged(points, camera)
    grasps = NetworkSampler(GRIPPER)(complete_shape(cloud))
    assert not (grasps.width < 0.01).any()
