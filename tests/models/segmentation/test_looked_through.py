"""Images that are not of the camera's pose show what is behind a table; others do not.

Depths are those of a plane in closed form.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.segmentation.modeled_bodies import Boxes, ModeledBodies

CAMERA = Camera((180.0, 180.0, 159.5, 119.5), 320, 240, 0.07, 0.01)
HALF = np.array([0.8, 0.8, 0.02])
TABLE = np.eye(4)
TABLE[2, 3] = -0.02  # its top is at z = 0


def bodies(solid=True):
    return ModeledBodies(ParallelGripper(), Boxes(TABLE[None], HALF[None], np.array([solid])))


def pose(p, tilt=30.0, pan=0.0, roll=0.0):
    """It looks down, tilted about its x axis, turned about the vertical and its own axis."""
    X = np.eye(4)
    turns = Rotation.from_euler("ZXZ", [pan, 180.0 + tilt, roll], degrees=True)
    X[:3, :3], X[:3, 3] = turns.as_matrix(), p
    return X


def image(X_WC, top=0.0, noise=0.0, far=3.0, before=np.inf):
    """Of the table with its top at a height, nothing behind it, and the middle third hidden."""
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    rays = np.stack([(u - 159.5) / 180.0, (v - 119.5) / 180.0, np.ones_like(u, float)], -1)
    d = rays @ X_WC[:3, :3].T
    with np.errstate(divide="ignore"):
        z = (top - X_WC[2, 3]) / d[..., 2]
    on = (z > 0.0) & (np.abs(X_WC[:2, 3] + z[..., None] * d[..., :2]) <= 0.8).all(axis=2)
    z = np.where(on, z, np.inf)
    z[:, 107:213] = np.minimum(z[:, 107:213], before)
    z = z + noise * np.where(on, z, 0.0) ** 2 * np.random.default_rng(0).standard_normal(z.shape)
    return np.where(z > far, np.inf, z).astype(np.float32)


HERE = pose([0.0, -0.5, 0.8], roll=25.0)


def looked_through(depth, X_WC=HERE, **how):
    return bodies(**how).looked_through(depth, X_WC, CAMERA)


@pytest.mark.parametrize("how", [{}, {"noise": 0.01}, {"before": 0.3}, {"top": 0.02}, {"far": 0.9}])
@pytest.mark.parametrize("tilt", [0.0, 30.0, 60.0])
def test_an_image_of_its_pose_does_not(how, tilt):
    """With noise, a body before the table, a table 2 cm higher, a camera that sees less far."""
    here = pose([0.1, -0.5, 0.8], tilt, roll=25.0)
    assert not looked_through(image(here, **how), here)
    assert looked_through(image(here), here) is False


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize(
    "now",
    [
        pose([0.0, -0.5, 0.6], roll=25.0),
        pose([0.0, -0.5, 0.8], roll=60.0),
        pose([0.0, -0.5, 0.8], tilt=10.0, roll=25.0),
        pose([0.3, -0.3, 0.65], pan=30.0, roll=25.0),
    ],
)
def test_an_image_of_an_earlier_pose_does(now, noise):
    assert looked_through(image(HERE, noise=noise), now) is True


def test_a_mirrored_image_does_where_the_mirror_shows():
    """Not where the camera's x axis is level: then left is as right."""
    assert looked_through(image(HERE)[:, ::-1]) is True
    level = pose([0.0, -0.5, 0.8])
    assert looked_through(image(level)[:, ::-1], level) is False


def test_without_the_cell_in_the_image_it_is_unknown():
    away = pose([0.0, 0.0, 0.5], tilt=150.0)
    assert looked_through(image(away, before=0.4), away) is None
    for nothing in (0.0, np.nan, np.inf):
        assert looked_through(np.full((240, 320), nothing, dtype=np.float32)) is None


def test_a_box_about_a_body_may_be_looked_through():
    X_WC = pose([0.0, -0.5, 0.6], roll=25.0)
    assert looked_through(image(HERE), X_WC, solid=False) is None
    assert ModeledBodies(ParallelGripper()).looked_through(image(HERE), X_WC, CAMERA) is None
