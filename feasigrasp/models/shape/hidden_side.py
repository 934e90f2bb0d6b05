"""Learned estimate of the object's thickness behind the observed surface.

Nothing of an object lies outside its silhouette: where its surface ends along the line of sight of
every pixel, beside where it begins, gives the whole outer shape. A small network has learnt
how thick household shapes are behind each pixel; the distance field takes that for observations
that are as uncertain as the network says (`feasigrasp.models.shape.completion`).
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.special import expit

from feasigrasp.models.arrays import Array, Float32
from feasigrasp.models.clouds.view_image import SIDE, ViewImage
from feasigrasp.models.geometry.points import nearest_distance
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.weights_file import WEIGHTS, WeightArrays, WeightsFormat, check_arrays

#: Half widths of pictures are given relative to this [m]. Source: layout: input of the network.
TYPICAL_SIZE = 0.1


@dataclass(frozen=True, eq=False)
class BackSurface:
    """Estimated far surface of an object behind the pixels of a view.

    Attributes:
        depth: Along z of the picture's camera, shape (SIDE, SIDE) [m]; 0 outside the silhouette.
        deviation: Expected error of the depth, shape (SIDE, SIDE) [m].
    """

    depth: Array
    deviation: Array


def picture_scale(image: ViewImage) -> float:
    """Half the width of the picture at the object's depth [m]: the unit of lengths in it."""
    return 0.5 * SIDE * image.pixel * float(image.depth[image.mask].mean())


def estimated_thickness(image: ViewImage, field: Gpdf) -> tuple[Array, Array]:
    """Depth of a field along the lines of sight, and its distance from observations.

    From the pictured surface to the end of the field, along z of the camera, and the distance of
    that end from the nearest observed point; shape (SIDE, SIDE) each [m]; NaN outside the
    silhouette and where there is no end. Every second line of sight of every second row is looked
    at, which is as fine as fields are.
    """
    # Thickness that is looked for in the field, least and most [m].
    least, most = 4e-3, 0.4
    coarse = image.mask[::2, ::2]
    rays = image.rays()[::2, ::2][coarse] @ image.X_OC[:3, :3].T
    length = np.linalg.norm(rays, axis=1)
    starts = image.X_OC[:3, 3] + image.depth[::2, ::2][coarse][:, None] * rays
    exits = field.ray_exits(starts, rays / length[:, None], most, least) / length
    ends = starts + exits[:, None] * rays
    found = np.isfinite(exits)
    apart = np.full(len(exits), np.nan)
    apart[found] = nearest_distance(ends[found], field.points)
    answers = np.full((2, *coarse.shape), np.nan)
    answers[:, coarse] = exits, apart
    thickness, apart = np.where(image.mask, answers.repeat(2, axis=1).repeat(2, axis=2), np.nan)
    return thickness, apart


def features(image: ViewImage, field: Gpdf) -> NDArray[np.float32]:
    """Network input of a view, shape (FEATURES, SIDE, SIDE).

    Silhouette, depth relative to its mean, distance to the rim, the size of the object, the
    thickness of the field, where there is one, and how far its end is from the observed surface.
    """
    scale, mask = picture_scale(image), image.mask
    relative = np.where(mask, image.depth - image.depth[mask].mean(), 0.0) / scale
    rim = distance_transform_edt(mask) / (0.25 * SIDE)
    size = np.where(mask, np.log(scale / TYPICAL_SIZE), 0.0)
    estimated, apart = (part / scale for part in estimated_thickness(image, field))
    known = np.isfinite(estimated)
    estimated, apart = (np.where(known, part, 0.0) for part in (estimated, apart))
    return np.stack([mask, relative, rim, size, estimated, known, apart]).astype(np.float32)


# U-Net from a view to thickness (Ronneberger et al. 2015), and its weights.
#
# Computed with NumPy, since torch takes longer to load than all pictures of a run; trained with
# torch by `feasigrasp_lab.training.train_hidden_side`.

_FILE = WeightsFormat("hidden side", "feasigrasp hidden_side 2", "feasigrasp train hidden-side")
#: Channels of a picture, see `hidden_side.features`. Source: layout: input of the network.
FEATURES = 7
#: The channel with the thickness estimated without the network. Source: layout: input of the
#: network.
ESTIMATED = 4
#: Channels at half, quarter and eighth resolution. Source: layout: the network's architecture.
CHANNELS = (32, 64, 96)
#: Least spread of the thickness, in units of the picture's scale. Source: guessed.
LEAST_SPREAD = 5e-3


class HiddenSide:
    """The trained network.

    Args:
        channels: At half, quarter, ... resolution.
        weights: Its arrays, by the names that torch gives them.

    Raises:
        ValueError: The arrays are not those of such a network.
    """

    def __init__(self, channels: Sequence[int], weights: WeightArrays) -> None:
        self.channels, self._weights = tuple(channels), weights
        check_arrays(weights, _shapes(self.channels))
        # Kernels (D, C, k, k) as matrices (k k C, D).
        self._kernels = {
            name.removesuffix(".weight"): array.transpose(2, 3, 1, 0).reshape(-1, len(array))
            for name, array in weights.items()
            if name.endswith(".weight")
        }

    def back_surfaces(self, images: Sequence[ViewImage], field: Gpdf) -> list[BackSurface]:
        """Estimated far surface behind every view, given the field of the observed surface."""
        backs = []
        for image in images:
            median, spread = self.thickness(features(image, field))
            scale = picture_scale(image)
            depth = np.where(image.mask, image.depth + scale * np.maximum(median, 0.0), 0.0)
            backs.append(BackSurface(depth, np.where(image.mask, scale * spread, 0.0)))
        return backs

    def thickness(self, picture: Float32) -> tuple[Array, Array]:
        """Thickness of the object behind every pixel, and the spread of what it may be.

        Medians and scales (s, s) of Laplace distributions, in units of the scale of the picture
        (FEATURES, s, s), s a multiple of 8.
        """
        half = picture.shape[1] // 2  # blocks of 2 x 2 pixels are looked at together
        blocks = picture.reshape(FEATURES, half, 2, half, 2).transpose(1, 3, 0, 2, 4)
        x = blocks.reshape(half, half, 4 * FEATURES)
        skipped: list[Float32] = []
        for level in range(len(self.channels)):
            x = self._block(f"down.{level}", _halved(x) if skipped else x)
            skipped.append(x)
        for level in reversed(range(len(self.channels) - 1)):
            larger = x.repeat(2, axis=0).repeat(2, axis=1)
            x = self._block(f"up.{level}", np.concatenate([skipped[level], larger], axis=2))
        answers = self._convolved("head", x).astype(float)
        change, spread = _doubled(_doubled(answers).swapaxes(0, 1)).T
        return picture[ESTIMATED] + change, np.logaddexp(0.0, spread) + LEAST_SPREAD

    def save(self, filename: Path) -> None:
        """Writes the weights."""
        _FILE.save(filename, {"channels": self.channels}, self._weights)

    @classmethod
    def load(cls, filename: Path) -> Self:
        """Reads weights that `save` wrote.

        Raises:
            WeightsError: There is no such file, or it is of something else.
        """
        return _FILE.load(filename, lambda header, arrays: cls(header["channels"], arrays))

    def _block(self, name: str, x: Float32) -> Float32:
        """Two convolutions, each followed by ``x * sigmoid(x)``."""
        for layer in (0, 2):
            x = self._convolved(f"{name}.{layer}", x)
            x = x * expit(x)
        return x

    def _convolved(self, name: str, x: Float32) -> Float32:
        """Pixels (h, w, C) convolved with a kernel, zero beyond the rim: (h, w, D)."""
        (h, w, channels), kernel = x.shape, self._kernels[name]
        size = math.isqrt(len(kernel) // channels)
        padded = np.pad(x, [(size // 2, size // 2)] * 2 + [(0, 0)])
        shifts = itertools.product(range(size), repeat=2)
        around = np.concatenate([padded[i : i + h, j : j + w] for i, j in shifts], axis=2)
        return np.asarray(around @ kernel + self._weights[f"{name}.bias"])


def _shapes(channels: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the weights."""
    ways = (4 * FEATURES, *channels)
    blocks = {f"down.{k}": pair for k, pair in enumerate(itertools.pairwise(ways))}
    for k, (a, b) in enumerate(itertools.pairwise(channels)):
        blocks[f"up.{k}"] = (a + b, a)
    shapes: dict[str, tuple[int, ...]] = {"head.weight": (2, channels[0], 1, 1), "head.bias": (2,)}
    for name, (inputs, outputs) in blocks.items():
        for layer, before in ((0, inputs), (2, outputs)):
            shapes[f"{name}.{layer}.weight"] = (outputs, before, 3, 3)
            shapes[f"{name}.{layer}.bias"] = (outputs,)
    return shapes


def _halved(x: Float32) -> Float32:
    """Means of blocks of 2 x 2 pixels (h, w, C)."""
    h, w, channels = x.shape
    return np.asarray(x.reshape(h // 2, 2, w // 2, 2, channels).mean(axis=(1, 3)))


def _doubled(x: Array) -> Array:
    """Twice as many rows (h, ...), interpolated linearly between their middles."""
    before, after = np.concatenate([x[:1], x[:-1]]), np.concatenate([x[1:], x[-1:]])
    pairs = np.stack([0.25 * before + 0.75 * x, 0.75 * x + 0.25 * after], axis=1)
    return pairs.reshape(-1, *x.shape[1:])


@lru_cache(maxsize=1)
def load_hidden_side() -> HiddenSide:
    """The network that comes with the package."""
    return HiddenSide.load(WEIGHTS / "hidden_side.npz")
