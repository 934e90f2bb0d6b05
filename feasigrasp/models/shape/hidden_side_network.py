"""The network behind `hidden_side`: a small U-Net from pictures to thickness, and its weights.

The one file here that loads torch.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from feasigrasp.models.clouds.view_image import ViewImage
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.shape.hidden_side import BackSurface, features, picture_scale
from feasigrasp.models.weights_file import (
    WEIGHTS,
    WeightArrays,
    WeightsFormat,
    fill_network,
    network_arrays,
)

#: Where the trained weights are.
DEFAULT_WEIGHTS = WEIGHTS / "hidden_side.npz"
_FILE = WeightsFormat("hidden side", "feasigrasp hidden_side 2", "feasigrasp train hidden-side")
#: Channels of a picture, see `hidden_side.features`.
FEATURES = 7
#: The channel with the thickness that is believed without the network.
BELIEVED = 4
#: Channels at half, quarter and eighth resolution.
CHANNELS = (32, 64, 96)
#: Least spread of the thickness, in units of the picture's scale.
LEAST_SPREAD = 5e-3


class _Block(nn.Sequential):
    """Two convolutions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(outputs, outputs, 3, padding=1),
            nn.SiLU(),
        )


class HiddenSideNetwork(nn.Module):
    """Thickness of the object behind every pixel, and the spread of what it may be.

    It changes the thickness that is believed without it. Pictures (b, FEATURES, s, s) become
    medians and scales of Laplace distributions, (b, s, s) each, in units of the picture's scale;
    s is a multiple of 8. Blocks of 2 x 2 pixels are looked at together: what lies behind them
    hardly differs.
    """

    def __init__(self, channels: tuple[int, ...] = CHANNELS) -> None:
        super().__init__()
        self.channels = channels
        inputs = (4 * FEATURES, *channels[:-1])
        self.down = nn.ModuleList(_Block(a, b) for a, b in zip(inputs, channels, strict=True))
        self.up = nn.ModuleList(_Block(a + b, a) for a, b in itertools.pairwise(channels))
        self.head = nn.Conv2d(channels[0], 2, 1)
        nn.init.zeros_(self.head.weight)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        x = functional.pixel_unshuffle(pictures, 2).contiguous(memory_format=torch.channels_last)
        skipped: list[Tensor] = []
        for block in self.down:
            x = block(functional.avg_pool2d(x, 2) if skipped else x)
            skipped.append(x)
        for level in reversed(range(len(self.up))):
            larger = functional.interpolate(x, scale_factor=2, mode="nearest")
            x = self.up[level](torch.cat([skipped[level], larger], dim=1))
        answers = functional.interpolate(self.head(x), scale_factor=2, mode="bilinear")
        change, spread = answers.unbind(dim=1)
        return pictures[:, BELIEVED] + change, functional.softplus(spread) + LEAST_SPREAD


class HiddenSide:
    """The trained network.

    Args:
        network: Its weights.
    """

    def __init__(self, network: HiddenSideNetwork) -> None:
        self.network = network.eval().requires_grad_(False)

    def back_surfaces(self, images: Sequence[ViewImage], field: Gpdf) -> list[BackSurface]:
        """Where the object in every picture probably ends, given the field of what was seen."""
        seen = np.stack([features(image, field) for image in images])
        with torch.inference_mode():
            median, spread = self.network(torch.from_numpy(seen))
        backs = []
        for k, image in enumerate(images):
            scale = picture_scale(image)
            thickness = scale * median[k].double().clamp(min=0.0).numpy()
            deviation = scale * spread[k].double().numpy()
            depth = np.where(image.mask, image.depth + thickness, 0.0)
            backs.append(BackSurface(depth, np.where(image.mask, deviation, 0.0)))
        return backs

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
        network = HiddenSideNetwork(tuple(header["channels"]))
        fill_network(network, arrays)
        return cls(network)


@lru_cache(maxsize=1)
def load_hidden_side() -> HiddenSide:
    """The network that comes with the package."""
    return HiddenSide.load()
