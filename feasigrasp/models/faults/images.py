"""Faults of depth images and object masks."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.choices import key
from feasigrasp.models.faults.fault import Fault


class View(NamedTuple):
    """One measurement of a depth camera.

    Attributes:
        points: One per pixel, in the world [m], not finite where nothing is measured, shape (3, n).
        of_object: Which of them are on the object, shape (n,).
        p_WC: Where the camera is, shape (3,).
        axis: Where it looks, a unit vector in the world, shape (3,).
    """

    points: Array
    of_object: Mask
    p_WC: Array
    axis: Array


@dataclass
class CloudFault(Fault):
    """A fault of what the camera measures; derive from it."""

    def seen(self, view: View, rng: np.random.Generator) -> Array:
        """The points that the camera delivers instead of a view's, as many, shape (3, n).

        What is random is drawn from ``rng``.
        """
        raise NotImplementedError


@dataclass
class CameraGone(CloudFault):
    """No image arrives: there is no depth in any pixel."""

    def seen(self, view: View, rng: np.random.Generator) -> Array:
        """Nothing."""
        return np.full_like(view.points, np.inf)


@dataclass
class CameraBlack(CloudFault):
    """Zero depth in every pixel, as valid measurements: all points are in the camera."""

    def seen(self, view: View, rng: np.random.Generator) -> Array:
        """The camera's own place, in every pixel."""
        return np.repeat(view.p_WC[:, None], view.points.shape[1], axis=1)


@dataclass
class DepthFault(Fault):
    """A fault of depth images, and of the points that are made of them; derive from it."""

    def depth(self, image: Array, first: Array) -> Array:
        """Delivered instead of an image (h, w, 1) [m]; ``first`` is that when the fault began."""
        raise NotImplementedError


@dataclass
class CameraFrozen(DepthFault):
    """One image comes again and again, as if it were new."""

    def depth(self, image: Array, first: Array) -> Array:
        """The first one."""
        return first


@dataclass
class CameraMirrored(DepthFault):
    """Images are mirrored: left is right."""

    def depth(self, image: Array, first: Array) -> Array:
        """Each row in reverse."""
        return image[:, ::-1]


@dataclass
class OnePlane(CloudFault):
    """All pixels of the object have the same depth: its points lie on one plane."""

    def seen(self, view: View, rng: np.random.Generator) -> Array:
        """Each point of the object moved along its ray to the median depth of all of them."""
        chosen = view.of_object & np.isfinite(view.points).all(axis=0)
        rays = view.points[:, chosen] - view.p_WC[:, None]
        depths = view.axis @ rays
        result = view.points.copy()
        if len(depths):
            result[:, chosen] = view.p_WC[:, None] + rays * (np.median(depths) / depths)
        return result


@dataclass
class Outliers(CloudFault):
    """Some pixels are far off in depth, as reflections and flying pixels are.

    Attributes:
        share: Share of the pixels.
        size: How far they are off along their rays, towards the camera or away from it [m].
    """

    share: float = key(0.05, 0.0, 1.0)
    size: float = key(0.05, 0.0, 10.0, "m")

    def seen(self, view: View, rng: np.random.Generator) -> Array:
        """Pixels drawn anew for every image."""
        points = view.points
        chosen = (rng.random(points.shape[1]) < self.share) & np.isfinite(points).all(axis=0)
        rays = points[:, chosen] - view.p_WC[:, None]
        off = rng.choice([-self.size, self.size], rays.shape[1])
        result = points.copy()
        result[:, chosen] += off * rays / np.linalg.norm(rays, axis=0)
        return result


@dataclass
class MaskFault(Fault):
    """A fault of the mask; derive from it."""

    def mask(self, of_object: Mask) -> Mask:
        """The pixels that are taken for the object, from those that show it, shape (h, w)."""
        raise NotImplementedError


@dataclass
class MaskShifted(MaskFault):
    """The mask lies beside the object, as one of an image long ago does.

    Attributes:
        columns: How far to the right [pixels].
        rows: How far down [pixels].
    """

    columns: int = key(10, -10000, 10000, "px")
    rows: int = key(0, -10000, 10000, "px")

    def mask(self, of_object: Mask) -> Mask:
        """The mask moved; nothing comes in from outside the image."""
        rows, columns = np.nonzero(of_object)
        rows, columns = rows + int(self.rows), columns + int(self.columns)
        height, width = of_object.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        result = np.zeros_like(of_object)
        result[rows[inside], columns[inside]] = True
        return result


@dataclass
class MaskEroded(MaskFault):
    """The mask misses the object's rim.

    Attributes:
        pixels: Its width.
    """

    pixels: float = key(10.0, 0.0, 10000.0, "px")

    def mask(self, of_object: Mask) -> Mask:
        """The pixels that are farther than that from every other pixel."""
        if of_object.all():
            return of_object
        return np.asarray(distance_transform_edt(of_object) > self.pixels)


@dataclass
class MaskDilated(MaskFault):
    """The mask has a rim of what is beside the object.

    Attributes:
        pixels: Its width.
    """

    pixels: float = key(10.0, 0.0, 10000.0, "px")

    def mask(self, of_object: Mask) -> Mask:
        """The pixels that are at most that far from one of the object."""
        if not of_object.any():
            return of_object
        return np.asarray(distance_transform_edt(~of_object) <= self.pixels)


@dataclass
class MaskWhole(MaskFault):
    """The whole image is taken for the object."""

    def mask(self, of_object: Mask) -> Mask:
        """All pixels."""
        return np.ones_like(of_object)


@dataclass
class MaskEmpty(MaskFault):
    """No pixel is taken for the object."""

    def mask(self, of_object: Mask) -> Mask:
        """No pixel."""
        return np.zeros_like(of_object)
