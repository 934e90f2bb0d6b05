"""What the picture of an object says about the side it does not show, learnt from other objects.

Nothing of an object lies outside its silhouette: where its surface ends along the line of sight of
every pixel, beside where it begins, tells the whole of its outer shape. A small network has learnt
how thick household shapes are behind each pixel; the distance field takes that for observations
that are as uncertain as the network says (`feasigrasp.models.shape.completion`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.view_image import SIDE, ViewImage
from feasigrasp.models.geometry.nearest_distance import nearest_distance
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.weights_file import (
    WEIGHTS,
    WeightArrays,
    WeightsFormat,
    fill_network,
    network_arrays,
)

if TYPE_CHECKING:
    from feasigrasp.models.shape.hidden_side_network import HiddenSideNetwork

#: Where the trained weights are.
DEFAULT_WEIGHTS = WEIGHTS / "hidden_side.npz"
_FILE = WeightsFormat("hidden side", "feasigrasp hidden_side 2", "feasigrasp train hidden-side")
#: Half widths of pictures are given relative to this [m].
TYPICAL_SIZE = 0.1
#: Thickness that is looked for in the field, least and most [m].
LEAST, MOST = 4e-3, 0.4


@dataclass(frozen=True, eq=False)
class BackSurface:
    """Where an object probably ends behind the pixels of a picture.

    Attributes:
        depth: Along z of the picture's camera, shape (SIDE, SIDE) [m]; 0 outside the silhouette.
        deviation: Expected error of the depth, shape (SIDE, SIDE) [m].
    """

    depth: Array
    deviation: Array


def picture_scale(image: ViewImage) -> float:
    """Half the width of the picture at the object's depth [m]: the unit of lengths in it."""
    return 0.5 * SIDE * image.pixel * float(image.depth[image.mask].mean())


def believed_thickness(image: ViewImage, field: Gpdf) -> tuple[Array, Array]:
    """Where a field ends on the lines of sight, and how far that is from all that was seen.

    Every second line of sight of every second row is looked at, which is as fine as fields are.

    Returns:
        From the pictured surface to the end of the field, along z of the camera, and the distance
        of that end from the nearest observed point; shape (SIDE, SIDE) each [m]; NaN outside the
        silhouette and where there is no end.
    """
    coarse = image.mask[::2, ::2]
    rays = image.rays()[::2, ::2][coarse] @ image.X_OC[:3, :3].T
    length = np.linalg.norm(rays, axis=1)
    starts = image.X_OC[:3, 3] + image.depth[::2, ::2][coarse][:, None] * rays
    exits = field.ray_exits(starts, rays / length[:, None], MOST, LEAST) / length
    ends = starts + exits[:, None] * rays
    found = np.isfinite(exits)
    apart = np.full(len(exits), np.nan)
    apart[found] = nearest_distance(ends[found], field.points)
    answers = np.full((2, *coarse.shape), np.nan)
    answers[:, coarse] = exits, apart
    thickness, apart = np.where(image.mask, answers.repeat(2, axis=1).repeat(2, axis=2), np.nan)
    return thickness, apart


def features(image: ViewImage, field: Gpdf) -> NDArray[np.float32]:
    """What the network sees of a picture, shape (FEATURES, SIDE, SIDE).

    Silhouette, depth relative to its mean, distance to the rim, the size of the object, the
    thickness of the field, where there is one, and how far its end is from what was seen.
    """
    scale, mask = picture_scale(image), image.mask
    relative = np.where(mask, image.depth - image.depth[mask].mean(), 0.0) / scale
    rim = distance_transform_edt(mask) / (0.25 * SIDE)
    size = np.where(mask, np.log(scale / TYPICAL_SIZE), 0.0)
    believed, apart = (part / scale for part in believed_thickness(image, field))
    known = np.isfinite(believed)
    believed, apart = (np.where(known, part, 0.0) for part in (believed, apart))
    return np.stack([mask, relative, rim, size, believed, known, apart]).astype(np.float32)


class HiddenSide:
    """The trained network.

    Args:
        network: Its weights.
    """

    def __init__(self, network: HiddenSideNetwork) -> None:
        self.network = network.eval().requires_grad_(False)

    def back_surface(self, image: ViewImage, field: Gpdf) -> BackSurface:
        """Where the object in a picture probably ends, given the field of what was seen."""
        import torch  # takes a second to import

        with torch.inference_mode():
            median, spread = self.network(torch.from_numpy(features(image, field)[None]))
        scale = picture_scale(image)
        thickness = scale * median[0].double().clamp(min=0.0).numpy()
        deviation = scale * spread[0].double().numpy()
        return BackSurface(
            np.where(image.mask, image.depth + thickness, 0.0),
            np.where(image.mask, deviation, 0.0),
        )

    def save(self, filename: Path) -> None:
        """Writes the weights."""
        _FILE.save(filename, {"channels": self.network.channels}, network_arrays(self.network))

    @classmethod
    def load(cls, filename: Path = DEFAULT_WEIGHTS) -> HiddenSide:
        """Reads weights that `save` wrote.

        Raises:
            WeightsError: There is no such file, or it is of something else.
        """
        return _FILE.load(filename, cls._of)

    @classmethod
    def _of(cls, header: dict[str, Any], arrays: WeightArrays) -> HiddenSide:
        from feasigrasp.models.shape.hidden_side_network import HiddenSideNetwork

        network = HiddenSideNetwork(tuple(header["channels"]))
        fill_network(network, arrays)
        return cls(network)


@lru_cache(maxsize=1)
def load_hidden_side() -> HiddenSide:
    """The network that comes with the package."""
    return HiddenSide.load()
