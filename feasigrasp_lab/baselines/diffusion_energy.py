"""Energy network of grasp diffusion in torch (SE(3)-DiffusionFields, Urain et al. 2023).

After Urain, Funk, Peters, Chalvatzaki, "SE(3)-DiffusionFields" (arXiv 2209.03855), from their
description: a vector-neuron encoder of the cloud, points on the hand that the pose moves, a feature
network at each of them whose first output is the signed distance, and a head that makes one energy
of all features. Its gradient by the pose points away from grasps, by noise over variance.

Where it differs: besides a latent of the whole cloud, every point on the hand gets what the encoder
says of the cloud round it, as means with Gaussian weights of three widths, and vectors are given in
the hand's frame. So the energy is exactly invariant to motions of object and hand together, and
needs no clouds turned at random to learn that.

Lengths in here are in units of `LENGTH`, so that noise of one size is as much in angle as in
position.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.networks import VectorLinear, VectorLinearReLU, lengths, with_mean

#: One unit of length [m]; the authors scale by 8. Source: paper: SE(3)-DiffusionFields.
LENGTH = 0.125
#: Widths of the means round a point on the hand, in units: 6, 3 and 1.5 cm; each half the last.
#: Source: guessed.
_WIDEST, _WIDTHS = 0.48, 3
#: Frequencies of the noise level's Fourier features [1 per unit of time]. Source: guessed.
_FREQUENCIES = (0.25, 0.5, 1.0, 2.0, 4.0)


class Cloud(NamedTuple):
    """An encoded batch of clouds.

    Attributes:
        points: Relative to their mean, in units, shape (B, n, 3).
        table: What is averaged round places: one, invariants, and vectors; then the same times
            each coordinate of the point, for the slopes of the averages. Shape (B, n, 4 C).
        latent: Vectors of the whole cloud, shape (B, 3, Z).
    """

    points: Tensor
    table: Tensor
    latent: Tensor

    def repeated(self, count: int) -> Cloud:
        """The one cloud of a batch so many times, without copies."""
        return Cloud(*(part.expand(count, *part.shape[1:]) for part in self))


class PoseEnergy(nn.Module):
    """The energy, see the head of this module."""

    def __init__(self) -> None:
        super().__init__()
        # Channels of the vector neurons; numbers and vectors of a point of the cloud that are
        # averaged, besides its position and normal.
        vectors, invariants, directions = 24, 6, 2
        # Width of the feature network, what it says of a point on the hand, width of the head.
        hidden, features, head = 128, 8, 256
        self.encode_first = VectorLinearReLU(2, vectors)
        self.encode_second = VectorLinearReLU(2 * vectors, vectors)
        self.to_latent = VectorLinear(2 * vectors, vectors)
        self.to_directions = VectorLinear(2 * vectors, directions)
        self.to_invariants = nn.Linear(vectors, invariants)
        local = 1 + invariants + 3 * (2 + directions)
        self.first = nn.Linear(_WIDTHS * local + 1 + 2 * vectors + 2 * len(_FREQUENCIES), hidden)
        self.second = nn.Linear(hidden, hidden)
        self.third = nn.Linear(hidden, hidden)
        self.said = nn.Linear(hidden, features)
        self.hand: Tensor
        self.register_buffer("hand", torch.tensor(hand_points(ParallelGripper())))
        self.combine = nn.Linear(len(self.hand) * features + 2 * len(_FREQUENCIES), head)
        self.norm = nn.LayerNorm(head)
        self.last = nn.Linear(head, 1)

    def encode(self, points: Tensor, normals: Tensor) -> Cloud:
        """Encodes clouds.

        Args:
            points: Relative to their mean, in units, shape (B, n, 3).
            normals: Outward, unit, shape (B, n, 3).
        """
        given = torch.stack((points, normals), -1).transpose(1, 2)  # (B, 3, n, 2)
        seen = self.encode_second(with_mean(self.encode_first(given)))
        both = with_mean(seen)
        latent = self.to_latent(both).mean(-2)
        vectors = torch.cat((given, self.to_directions(both)), -1).permute(0, 2, 3, 1)
        invariants = self.to_invariants(lengths(seen))
        one = torch.ones_like(points[..., :1])
        table = torch.cat((one, invariants, vectors.flatten(2)), -1)
        by_place = (points.unsqueeze(-1) * table.unsqueeze(-2)).flatten(2)
        return Cloud(points, torch.cat((table, by_place), -1), latent)

    def features(self, cloud: Cloud, x: Tensor, R: Tensor, time: Tensor) -> Tensor:
        """What the feature network says of places; the first is the signed distance in units.

        Args:
            cloud: Of B clouds.
            x: Places relative to the mean of each, in units, shape (B, m, 3).
            R: Axes in which vectors are given there, shape (B, m, 3, 3).
            time: Noise levels in [0, 1], shape (B, m).

        Returns:
            Shape (B, m, features).
        """
        latent = cloud.latent
        square = (x * x).sum(-1, keepdim=True)
        parts = [square, torch.linalg.vecdot(x.unsqueeze(-1), latent.unsqueeze(1), dim=-2)]
        parts += [lengths(latent.unsqueeze(-2)).expand(-1, x.shape[1], -1), _fourier(time)]
        invariants, directions = self.to_invariants.out_features, len(self.to_directions.weight)
        for summed in _summed(cloud, x):
            near, rest = summed.split((1, summed.shape[-1] - 1), -1)
            # Weight that stands for nothing near.
            share = 1.0 / (near + 1e-3)
            numbers, place, vectors = (rest * share).split((invariants, 3, 3 + 3 * directions), -1)
            vectors = torch.cat((place - x * (near * share), vectors), -1).unflatten(-1, (-1, 3))
            parts += [-torch.log(share), numbers, (vectors @ R).flatten(2)]
        h = functional.silu(self.first(torch.cat(parts, -1)))
        h = functional.silu(self.second(h)) + h
        h = functional.silu(self.third(h)) + h
        said: Tensor = self.said(h)
        return said

    def forward(self, cloud: Cloud, R: Tensor, p: Tensor, time: Tensor) -> Tensor:
        """Energies of hand poses.

        Args:
            cloud: Of B clouds.
            R: Rotations of P hands beside each, shape (B, P, 3, 3).
            p: Their positions relative to the mean of the cloud, in units, shape (B, P, 3).
            time: Noise levels in [0, 1], shape (B, P).

        Returns:
            Shape (B, P).
        """
        count = len(self.hand)
        x = (p.unsqueeze(-2) + self.hand @ R.mT).flatten(1, 2)
        axes, times = (part.repeat_interleave(count, 1) for part in (R, time))
        said = self.features(cloud, x, axes, times).unflatten(1, (-1, count)).flatten(2)
        h = self.norm(self.combine(torch.cat((said, _fourier(time)), -1)))
        energy = self.last(functional.silu(h)).squeeze(-1)
        return energy / standard_deviation(time)

    def gradient(
        self, cloud: Cloud, R: Tensor, p: Tensor, time: Tensor, *, train: bool = False
    ) -> Tensor:
        """Gradient of the energy by a body twist [angular; linear in units], shape (B, P, 6).

        Arguments as of `forward`; ``train`` keeps what a loss on the gradient needs.
        """
        with torch.enable_grad():
            twist = torch.zeros(*p.shape[:2], 6, dtype=p.dtype, device=p.device, requires_grad=True)
            turn = _hat(twist[..., :3])
            moved = p + (R @ twist[..., 3:].unsqueeze(-1)).squeeze(-1)
            energy = self(cloud, R + R @ turn, moved, time)
            return torch.autograd.grad(energy.sum(), twist, create_graph=train)[0]


def standard_deviation(time: Tensor) -> Tensor:
    """Of the noise at a time in [0, 1] [rad or units]: that of the authors, from 0 to 0.74."""
    return torch.sqrt((0.25**time - 1.0) / (2.0 * math.log(0.5)))


def hand_points(gripper: ParallelGripper) -> list[list[float]]:
    """Points on an open hand and between its pads, in its frame and in units.

    Five along the closing line, tips, heels and outer edges of both fingers, palm, and camera.
    """
    half, side, tip = gripper.max_opening / 2, gripper.finger_width / 2, gripper.tip
    outer, heel = half + gripper.finger_thickness, gripper.heel
    px, py = gripper.palm_size[0] / 2, gripper.palm_size[1] / 2
    cx, (_, cy, cz) = gripper.camera_box[0] / 2, gripper.camera_center
    points = [(share * half, 0.0, 0.0) for share in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    for way in (-1.0, 1.0):
        points += [(way * half, y, z) for z in (tip, heel / 2) for y in (-side, side)]
        points += [(way * outer, 0.0, z) for z in (tip, heel / 2)]
    points += [(x, y, heel) for x in (-px, px) for y in (-py, py)]
    points += [(0.0, 0.0, heel), (0.0, 0.0, heel / 2), (0.0, 0.0, tip)]
    points += [(x, cy, cz + gripper.camera_box[2] / 2) for x in (-cx, 0.0, cx)]
    return [[value / LENGTH for value in point] for point in points]


def _summed(cloud: Cloud, x: Tensor) -> Iterator[Tensor]:
    """Sums of a cloud's table with Gaussian weights round places x (B, m, 3), for every width.

    By x they can be differentiated once, with slopes in closed form: ``sum_j w_j (p_j - x) T_j``
    over the square of the width. So nothing of the size of places times points needs a gradient.

    Yields:
        Shape (B, m, C), the widest first.
    """
    at = x.detach()
    with torch.no_grad():
        d2 = torch.cdist(at, cloud.points).square_()
        weight = torch.exp_(d2.mul_(-0.5 / _WIDEST**2))
    columns = cloud.table.shape[-1] // 4
    for narrower in range(_WIDTHS):
        if narrower:  # half the width is the fourth power
            weight = weight.square().square_()
        everything = (weight @ cloud.table) / cloud.points.shape[1]
        value, by_place = everything.split((columns, 3 * columns), -1)
        slope = by_place.unflatten(-1, (3, columns)) - at.unsqueeze(-1) * value.unsqueeze(-2)
        step = (x - at).unsqueeze(-2) * (0.25**-narrower / _WIDEST**2)
        yield value + (step @ slope).squeeze(-2)


def _fourier(time: Tensor) -> Tensor:
    angle = time.unsqueeze(-1) * (2.0 * math.pi * time.new_tensor(_FREQUENCIES))
    return torch.cat((torch.sin(angle), torch.cos(angle)), -1)


def _hat(w: Tensor) -> Tensor:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    x, y, z = w.unbind(-1)
    zero = torch.zeros_like(x)
    rows = (torch.stack(r, -1) for r in ((zero, -z, y), (z, zero, -x), (-y, x, zero)))
    return torch.stack(tuple(rows), -2)
