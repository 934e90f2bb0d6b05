"""The U-Net of the hidden side in torch, to train it.

See `feasigrasp.models.shape.hidden_side_network` for what it computes, and for its weights.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn
from torch.nn import functional

from feasigrasp.models.shape.hidden_side_network import (
    BELIEVED,
    CHANNELS,
    FEATURES,
    LEAST_SPREAD,
    HiddenSide,
)
from feasigrasp.models.weights_file import network_arrays


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


def export(network: HiddenSideNetwork) -> HiddenSide:
    """The network without torch, as it is used and saved."""
    return HiddenSide(network.channels, network_arrays(network))
