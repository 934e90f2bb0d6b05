"""Images of a mesh for tests that track it."""

import numpy as np

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.geometry import se3
from feasigrasp.models.tracking.view import ObjectView

WIDTH, HEIGHT, FOCAL = 320, 240, 280.0
CAMERA = Camera((FOCAL, FOCAL, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5), WIDTH, HEIGHT, 0.07, 0.005)


def camera_at(p):
    z = -np.asarray(p) / np.linalg.norm(p)
    x, y = se3.perpendiculars(z)
    return se3.make_pose(np.column_stack([x, y, z]), p)


def look(surface, X_WO, X_WC, rng=None):
    """An image of a mesh at a pose, before a wall that is far away; 1 mm of noise."""
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    depth = surface.depth_image(K, se3.inverse(X_WC) @ X_WO, WIDTH, HEIGHT)
    seen = np.isfinite(depth)
    if rng is not None:
        depth = depth + 1e-3 * rng.standard_normal(depth.shape)
    v, u = np.nonzero(seen)
    z = depth[seen]
    fx, fy, cx, cy = CAMERA.intrinsics
    points_C = np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z])
    points_W = points_C @ X_WC[:3, :3].T + X_WC[:3, 3]
    return ObjectView(CAMERA, X_WC, points_W, np.where(seen, depth, 2.0))
