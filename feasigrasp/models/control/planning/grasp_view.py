"""How much of the object a camera on the hand sees at a grasp, and what the grasp is worth by that.

A hand that is led by its own camera must not go where it cannot see what it grasps: the object
moves on meanwhile. A grasp and the same turned by half a turn differ in this, since the camera is
on one side of the hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.grasps.grasp_set import GraspSet

#: With this share of the known surface in the image a grasp is worth all that it was; with less, in
#: proportion, but never less than this share of it.
_ENOUGH, _LEAST = 0.6, 0.05
#: Points of the surface that are looked at, at most.
_POINTS = 150


def share_in_view(X_OG: Array, points_O: Array, X_GC: Array, camera: Camera) -> Array:
    """The share of an object's surface that is in the image at each grasp, shape (n,).

    Points that the object itself or the fingers hide count as in the image.

    Args:
        X_OG: Grasps in O, shape (n, 4, 4) [m].
        points_O: Points of the surface, shape (m, 3) [m].
        X_GC: Pose of the camera on the hand, z forward, shape (4, 4).
        camera: The camera.
    """
    every = -(-len(points_O) // _POINTS)
    points = points_O[::every]
    X_OC = X_OG @ X_GC
    points_C = (points - X_OC[:, None, :3, 3]) @ X_OC[:, :3, :3]
    shown = camera.in_image(points_C.reshape(-1, 3)).reshape(len(X_OG), len(points))
    return np.asarray(shown.mean(axis=1))


def rated_by_view(grasps: GraspSet, points_O: Array, X_GC: Array, camera: Camera) -> GraspSet:
    """The grasps, scores multiplied by what they are worth; arguments as `share_in_view`."""
    if len(grasps) == 0 or len(points_O) == 0:
        return grasps
    share = share_in_view(grasps.X_OG, points_O, X_GC, camera)
    return replace(grasps, score=grasps.score * np.clip(share / _ENOUGH, _LEAST, 1.0))
