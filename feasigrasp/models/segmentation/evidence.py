"""What speaks for a component being the object: the field, a motion, the hand, a box."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from feasigrasp.models.arrays import Array, Floats, Indices, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.segmentation.camera_view import CameraView
from feasigrasp.models.segmentation.components import Components

#: A point agrees with the field that is no farther from its zero [m]: the error of the predicted
#: pose and of the side of the object that was not seen yet.
AGREES = 0.02
#: A component of which this share agrees is of the object; of others only single pixels are, which
#: are nearer to the surface than this [m].
_AGREEING_SHARE, _SINGLE = 0.5, 0.006
#: Pixels of components that do not agree are looked at no farther from its surface [m].
_GROWTH = 0.03
#: Of a component's sample one point in so many is compared with the field.
_EVERY = 3
#: A point that lies this much before what an earlier view saw there has come there since [m].
_MOVED = 0.008
#: It has, if the view looked through beside it as well [pixels].
_BESIDE = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
#: A body moves of which more than this share has come where nothing was.
LEAST_MOVED = 0.04


class DistanceField(Protocol):
    """What is asked of the object's field; a `Gpdf` is one."""

    @property
    def bounds(self) -> Array:
        """Lower and upper corner of the object, shape (2, 3) [m]."""

    def distance_and_gradient(self, x: Array) -> tuple[Array, Array]:
        """Raw distance (m,) and its gradient (m, 3) at x (m, 3)."""


def distance_to(field: DistanceField, points_O: Array) -> Array:
    """First-order distance ``|d| / |grad d|`` of points (m, 3) from the field's zero, (m,) [m]."""
    near = _beside(field.bounds, points_O) <= _GROWTH
    distance = np.full(len(points_O), np.inf)
    d, gradient = field.distance_and_gradient(np.ascontiguousarray(points_O[near]))
    distance[near] = np.abs(d) / np.maximum(np.linalg.norm(gradient, axis=1), 0.2)
    return distance


def agreeing(
    components: Components, points: Floats, field: DistanceField, X_WO: Array
) -> tuple[list[int], Indices]:
    """The components that are of an object with that field at that pose, and single pixels.

    A component is the object's if most of it is near the field's zero. What else is near it, amid a
    larger body that the object touches, is found pixel by pixel.

    Args:
        components: Of the picture.
        points: By pixel, shape (n, 3) [m].
        field: The object's, in O.
        X_WO: Predicted pose, shape (4, 4).

    Returns:
        Numbers of the components, and of the pixels of other components.
    """
    X_OW = inverse_kernel(np.ascontiguousarray(X_WO))
    kept: list[int] = []
    single = [np.zeros(0, dtype=np.int64)]
    for k, sample in enumerate(components.samples):
        near = distance_to(field, _to(X_OW, sample[::_EVERY])) < AGREES
        if near.mean() >= _AGREEING_SHARE:
            kept.append(k)
        else:
            pixels = np.flatnonzero(components.number == k)
            distance = distance_to(field, _to(X_OW, points[pixels].astype(float)))
            single.append(pixels[distance < _SINGLE])
    return kept, np.concatenate(single)


def moved_share(points: Array, before: CameraView, camera: Camera, sigmas: float) -> float:
    """The share of some points that lie where an earlier view has looked through.

    Args:
        points: Of one body, shape (m, 3) [m].
        before: An earlier view.
        camera: The camera.
        sigmas: So many standard deviations of a depth are noise.

    Returns:
        Of the points that the earlier view would have shown, in [0, 1]; 0 if it shows none.
    """
    X_CW = inverse_kernel(np.ascontiguousarray(before.X_WC))
    points_C = _to(X_CW, points)
    z, (u, v) = points_C[:, 2], (np.rint(c).astype(np.int64) for c in camera.pixels(points_C))
    inside = (z > 0.0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    if not inside.any():
        return 0.0
    u, v, z = u[inside], v[inside], z[inside]
    z_before = np.full(len(z), np.inf)
    for down, right in _BESIDE:  # the rim of a body at rest is a pixel farther out now and then
        row = np.clip(v + down, 0, camera.height - 1)
        pixel = row * camera.width + np.clip(u + right, 0, camera.width - 1)
        with np.errstate(invalid="ignore"):  # infinite where nothing was seen
            depth = _to(X_CW, before.points[pixel].astype(float))[:, 2]
        z_before = np.fmin(z_before, np.where(np.isfinite(depth), depth, np.inf))
    off = _MOVED + sigmas * camera.depth_noise * z**2
    shown = z_before > z - off  # what was hidden may have been there
    came = np.count_nonzero(z_before > z + off)
    return float(came) / max(int(np.count_nonzero(shown)), 1)


def nearest_to(p: Array, groups: list[Indices], components: Components) -> int:
    """The group that comes nearest to a point p (3,)."""
    return int(np.argmin([_distance(p, group, components) for group in groups]))


def in_box(mask_of: list[Mask], camera: Camera, box: Array) -> int | None:
    """Of some masks (n,) the one that has most pixels in a box, None if none has one.

    Args:
        mask_of: The masks.
        camera: The camera.
        box: First column and row, and last ones, as for a click twice the same [px], shape (4,).
    """
    left, top, right, bottom = np.rint(box).astype(int)
    shape = camera.height, camera.width
    inside = [
        np.count_nonzero(m.reshape(shape)[max(top, 0) : bottom + 1, max(left, 0) : right + 1])
        for m in mask_of
    ]
    return int(np.argmax(inside)) if any(inside) else None


def _distance(p: Array, group: Indices, components: Components) -> float:
    return min(float(np.linalg.norm(components.samples[k] - p, axis=1).min()) for k in group)


def _beside(bounds: Array, points: Array) -> Array:
    """How far points (m, 3) are outside a box (2, 3) along the worst axis, (m,)."""
    return np.asarray(np.maximum(bounds[0] - points, points - bounds[1]).max(axis=1))


def _to(X: Array, points: Array) -> Array:
    return np.asarray(points @ X[:3, :3].T + X[:3, 3])
