"""Pixels without depth amid an object: what a keyframe says of them, and what shape comes of it."""

import numpy as np
import pytest

from feasigrasp.models.clouds.camera import Camera, unproject
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry import se3
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.grids import object_grid
from feasigrasp.models.tracking.keyframe import keyframe_of, outlined
from feasigrasp.models.tracking.tracker import LearntShape
from feasigrasp.models.tracking.view import ObjectView

CAMERA = Camera((220.0, 220.0, 211.5, 119.5), 424, 240, 0.07, 0.002)
RADIUS, HALF, AWAY = 0.03, 0.06, 0.3
#: Pose of a camera that looks at the can from the side, its axis down the image.
X_WC = se3.make_pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), [0.0, -AWAY, 0.0])


def can_image(beyond):
    """Depths of a can before a background, and which pixels show it."""
    rays = CAMERA.rays(*(a.ravel() for a in np.meshgrid(np.arange(424), np.arange(240))))
    x, y = rays[:, 0].reshape(240, 424), rays[:, 1].reshape(240, 424)
    b = AWAY / (1.0 + x**2)
    left = b**2 - (AWAY**2 - RADIUS**2) / (1.0 + x**2)
    z = b - np.sqrt(np.maximum(left, 0.0))
    of_can = (left > 0.0) & (np.abs(y * z) < HALF)
    return np.where(of_can, z, beyond), of_can


def view(lost, beyond=np.inf):
    """The can, of which pixels were lost."""
    depth, of_can = can_image(beyond)
    depth[lost & of_can] = 0.0
    points_C = unproject(np.where(depth > 0.0, depth, np.inf), CAMERA.intrinsics)[:, of_can & ~lost]
    return ObjectView(CAMERA, X_WC, points_C.T @ X_WC[:3, :3].T + X_WC[:3, 3], depth), of_can


#: Three in four pixels are lost on the right half, in patches of 12 mm, but for its rim.
COLUMNS, ROWS = np.meshgrid(np.arange(424), np.arange(240))
LOST = (COLUMNS > 205) & (COLUMNS < 228) & ((ROWS // 9) % 4 > 0)


@pytest.mark.parametrize("beyond", [np.inf, 0.6])
def test_lost_pixels_amid_the_object_may_be_of_it_and_what_is_beside_it_is_not(beyond):
    seen, of_can = view(LOST, beyond)
    rays = seen.outline().unmeasured
    u, v = (np.rint(a).astype(int) for a in CAMERA.pixels(rays))
    # All but those beside a pixel that has a depth, which silhouettes allow for.
    assert (of_can & LOST)[v, u].all() and len(u) > 0.7 * (of_can & LOST).sum()
    whole, _ = view(np.zeros_like(LOST), beyond)
    assert len(whole.outline().unmeasured) == 0
    assert ObjectView(CAMERA, X_WC, seen.points_W).outline() is None
    assert ObjectView(CAMERA, X_WC, np.zeros((0, 3)), seen.depth).outline() is None


def test_not_a_number_is_a_pixel_without_depth_as_zero_is():
    seen, of_can = view(LOST, 0.6)
    blank = np.where(seen.depth > 0.0, seen.depth, np.nan)
    same = ObjectView(CAMERA, X_WC, seen.points_W, blank)
    behind = unproject(np.full((240, 424), 0.5), CAMERA.intrinsics)[:, of_can & LOST].T
    assert same.hidden(behind).all() and seen.hidden(behind).all()
    for mine, theirs in zip(same._silhouette[1:], seen._silhouette[1:], strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_points_outside_the_image_have_no_pixel():
    seen, _ = view(LOST)
    far = X_WC[:3, 3] + AWAY * X_WC[:3, 2] + np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]])
    more = ObjectView(CAMERA, X_WC, np.concatenate([seen.points_W, far]), seen.depth)
    np.testing.assert_array_equal(more.outline().unmeasured, seen.outline().unmeasured)


def test_the_shape_has_the_surface_that_was_lost():
    """With the keyframe's outline the can is there; without it, it is carved away."""
    seen, _ = view(LOST)
    key = keyframe_of(seen, np.eye(4), 0.0)
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 60), np.linspace(-0.05, 0.05, 21))
    true = RADIUS * np.stack([np.cos(angle), np.sin(angle), height / RADIUS], axis=-1)
    whole, _ = view(np.zeros_like(LOST))
    missing = []
    for each in (key, outlined(key, seen, np.eye(4)), keyframe_of(whole, np.eye(4), 0.0)):
        grid = object_grid(LearntShape().merged(each, max_points=320).gpdf)
        missing.append(np.mean(grid.distance_and_gradient(true.reshape(-1, 3))[0] > 0.01))
    carved, filled, seen_whole = missing
    assert filled < seen_whole + 0.01 and carved > 4.0 * seen_whole


def test_a_whole_view_has_the_same_shape_with_its_outline():
    seen, _ = view(np.zeros_like(LOST))
    key = keyframe_of(seen, np.eye(4), 0.0)
    cloud = FusedCloud.empty(0.003, smooth=True)
    both = [
        complete_shape(cloud.merged(each.points_O, each.p_OC, outline=each.outline))
        for each in (key, outlined(key, seen, np.eye(4)))
    ]
    x = np.random.default_rng(0).uniform(-0.06, 0.06, (200, 3))
    np.testing.assert_allclose(*(field.distance_and_gradient(x)[0] for field in both), atol=1e-12)
