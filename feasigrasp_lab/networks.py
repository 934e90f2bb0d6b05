"""Architecture of the grasp network in torch, and vector neurons: contact features to grasps.

It takes a batch of B clouds of n points and gives, for every point, how likely a grasp starts
there and which:

- vector neurons over position, normal, chord and neighbourhood vectors, with the mean over the
  cloud as context, give a correction of the closing direction, which starts out as the inward
  normal, and invariants;
- a perceptron on the invariants, with mean and maximum over the cloud as context, gives contact
  probability and two possible widths, as corrections of the chord, with spreads and weights: a cup
  is held by its wall or round its outside, and nothing in between is a grasp of it;
- a ring of approach directions round each contact shares one small perceptron; it sees the room
  that the hand has that way and in the ways beside it, the vectors' components in the ring's frame,
  and the invariants, and gives the probability that the hand is free.

Vector neurons (Deng, Litany, Duan, Poulenard, Tagliasacchi, Guibas, "Vector Neurons: A General
Framework for SO(3)-Equivariant Networks", ICCV 2021) are layers whose features are C vectors, not
numbers. A linear layer mixes vectors with scalar weights and has no bias, the nonlinearity cuts
vectors at a half space whose direction is itself such a mixture; rotating the input by R rotates
every vector by R, up to rounding and for any weights. Their layout is ``(..., 3, n, C)``, channels
last, so that a linear layer is one matrix product over all points and coordinates. No epsilon is
added anywhere: where a direction vanishes it is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from feasigrasp.models.grasps.network.contact_features import (
    DIRECTIONS,
    LENGTH_SCALE,
    NUMBERS,
    VECTORS,
    ContactFeatures,
)
from feasigrasp.models.grasps.network.inference_kernels import NARROWEST, WIDTHS
from feasigrasp.models.grasps.network.network import (
    BESIDE,
    LEAST_SPREAD,
    SPREAD,
    TILTS,
    GraspNetwork,
)
from feasigrasp.models.grasps.network.surroundings import ROOM
from feasigrasp.models.weights_file import WeightArrays, check_arrays

Network = TypeVar("Network", bound=nn.Module)

#: Squared lengths below the least normal float32 are zero: their direction is rounding. Source:
#: numerical.
_NOTHING = 1.2e-38


class VectorLinear(nn.Module):
    """Mixes vectors: ``v'_c = sum_k W_ck v_k``.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, inputs))
        nn.init.uniform_(self.weight, -(inputs**-0.5), inputs**-0.5)

    def forward(self, vectors: Tensor) -> Tensor:
        """From vectors (..., 3, n, inputs) to (..., 3, n, outputs)."""
        return vectors @ self.weight.T


class VectorLinearReLU(nn.Module):
    """Mixes vectors, then takes from each what points against a learned direction.

    With ``p = W v`` and the direction ``d = U v``, which all channels share: p where
    ``p . d >= 0``, and its part across d, ``p - (p . d / |d|^2) d``, elsewhere.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.outputs = outputs
        self.mix = VectorLinear(inputs, outputs + 1)

    def forward(self, vectors: Tensor) -> Tensor:
        """From vectors (..., 3, n, inputs) to (..., 3, n, outputs)."""
        mixed = self.mix(vectors)
        p, d = mixed[..., : self.outputs], mixed[..., self.outputs :]
        against = (p * d).sum(-3, keepdim=True).clamp_max(0.0)
        return p - (against / squared_length(d)) * d


def squared_length(vectors: Tensor) -> Tensor:
    """Squared lengths of vectors (..., 3, n, C): (..., 1, n, C); infinite where they vanish."""
    square = (vectors * vectors).sum(-3, keepdim=True)
    return torch.where(square > _NOTHING, square, torch.inf)


def lengths(vectors: Tensor) -> Tensor:
    """Lengths (..., n, C) of vectors (..., 3, n, C), with a finite gradient at zero."""
    return (vectors * vectors).sum(-3).clamp_min(_NOTHING).sqrt()


def with_mean(vectors: Tensor) -> Tensor:
    """Appends the means over the points as further channels: (..., 3, n, 2 C)."""
    mean = vectors.mean(-2, keepdim=True)
    return torch.cat((vectors, mean.expand_as(vectors)), -1)


def unit(vectors: Tensor) -> Tensor:
    """Vectors (..., 3) scaled to length 1; those that vanish stay zero."""
    square = (vectors * vectors).sum(-1, keepdim=True)
    return vectors * torch.where(square > _NOTHING, square, torch.inf).rsqrt()


def across(vectors: Tensor, axes: Tensor) -> Tensor:
    """The part of vectors (..., 3) across unit axes (..., 3)."""
    return vectors - (vectors * axes).sum(-1, keepdim=True) * axes


class Contacts(NamedTuple):
    """A batch of contact features (see `contact_features`), channels last."""

    axes: Tensor
    across: Tensor
    chords: Tensor
    vectors: Tensor
    numbers: Tensor
    room: Tensor

    @classmethod
    def of(cls, features: ContactFeatures) -> Contacts:
        """A batch of one."""
        parts = (torch.from_numpy(getattr(features, name)) for name in cls._fields)
        axes, across, chords, vectors, numbers, room = parts
        last = (vectors.mT, numbers.mT, room.permute(2, 1, 0))
        return cls(*(part.contiguous()[None] for part in (axes, across, chords, *last)))

    def chosen(self, rows: Tensor) -> Contacts:
        """The contacts of some rows (B, m)."""
        return Contacts(
            *(
                chosen_points(part, rows, -2 if name == "vectors" else 1)
                for name, part in zip(self._fields, self, strict=True)
            )
        )


class Heads(NamedTuple):
    """Outputs of a network per contact.

    Attributes:
        contact: Logit that a grasp starts there, (B, n).
        closing: b, unit, into the object, (B, n, 3).
        width: Distances that the contact opposite may be away [m], (B, n, W).
        spread: Scales of the Laplace distributions about them [m], (B, n, W).
        weight: Logits of these, (B, n, W).
        approach: K directions, unit, across the closing direction, (B, n, K, 3).
        free: Logits that the whole hand is free that way, (B, n, K).
    """

    contact: Tensor
    closing: Tensor
    width: Tensor
    spread: Tensor
    weight: Tensor
    approach: Tensor
    free: Tensor

    def mode_width(self) -> tuple[Tensor, Tensor]:
        """The width of most weight and its spread [m], both (B, n)."""
        best = self.weight.argmax(-1, keepdim=True)
        return self.width.gather(-1, best).squeeze(-1), self.spread.gather(-1, best).squeeze(-1)


class ContactNetwork(nn.Module):
    """The grasp network, see the head of this module.

    Args:
        vectors: Channels of the vector neurons.
        hidden: Width of the invariant perceptron.
        ring: Width of the perceptron that approach directions share.
    """

    def __init__(self, vectors: int = 24, hidden: int = 128, ring: int = 32) -> None:
        super().__init__()
        self.sizes = {"vectors": vectors, "hidden": hidden, "ring": ring}
        self.encode = VectorLinearReLU(VECTORS, vectors)
        self.survey = nn.Linear(NUMBERS + vectors, hidden // 2)
        self.refine = VectorLinearReLU(2 * vectors, vectors)
        self.tilt = VectorLinear(vectors, TILTS)
        self.beside = VectorLinear(vectors, BESIDE)
        self.first = nn.Linear(NUMBERS + 2 * vectors, hidden)
        self.context = nn.Linear(hidden, hidden)
        self.second = nn.Linear(hidden, hidden)
        self.to_ring = nn.Linear(hidden, ring)
        self.ring_room = nn.Linear(3 * ROOM + 2 * BESIDE, ring, bias=False)
        self.ring_hidden = nn.Linear(ring, ring)
        self.ring_free = nn.Linear(ring, 1)
        self.judge = nn.Linear(hidden + ring + 1, hidden // 2)
        self.last = nn.Linear(hidden // 2, 1 + 3 * WIDTHS)
        self.gates = nn.Linear(hidden, TILTS)
        with torch.no_grad():  # start with b the inward normal and the width the chord
            self.last.weight[1:].mul_(0.1)
            self.last.bias[1:].zero_()
            # How far apart the default network starts the widths of a grasp [m].
            self.last.bias[1 : 1 + WIDTHS] = torch.arange(WIDTHS) * (20e-3 / LENGTH_SCALE)
            self.last.bias[-WIDTHS:] = -torch.arange(WIDTHS)
            self.gates.weight.mul_(0.1)
            self.gates.bias.zero_()

    def forward(self, x: Contacts, rows: Tensor | None = None) -> Heads:
        """Outputs for a batch of contacts; for m chosen ones if their rows are given.

        Args:
            x: Features of whole clouds.
            rows: Indices (B, m). Training on some points of many clouds is worth more than on all
                points of few.
        """
        encoded = self.encode(x.vectors)
        seen = torch.cat((x.numbers, lengths(encoded)), -1)
        seen = torch.relu(self.survey(seen))
        context = self.context(torch.cat((seen.mean(-2), seen.amax(-2)), -1)).unsqueeze(-2)
        mean = encoded.mean(-2, keepdim=True)
        if rows is not None:
            x, encoded = x.chosen(rows), chosen_points(encoded, rows, -2)
        vectors = self.refine(torch.cat((encoded, mean.expand_as(encoded)), -1))
        along = (vectors * x.axes.transpose(-1, -2).unsqueeze(-1)).sum(-3)
        h = torch.relu(self.first(torch.cat((x.numbers, along, lengths(vectors)), -1)))
        h = torch.relu(self.second(h) + context)
        beside = self._ring(x, self.beside(vectors))
        r = self.ring_room(torch.cat((_with_neighbours(x.room), beside), -1))
        r = torch.relu(r + self.to_ring(h).unsqueeze(-2))
        r = torch.relu(self.ring_hidden(r))
        free = self.ring_free(r).squeeze(-1)
        judged = torch.cat((h, r.amax(-2), free.amax(-1, keepdim=True)), -1)
        head_outputs = self.last(torch.relu(self.judge(judged)))
        contact, width, spread, weight = head_outputs.split((1, WIDTHS, WIDTHS, WIDTHS), -1)
        tilt = (self.tilt(vectors) * self.gates(h).unsqueeze(-3)).sum(-1).transpose(-1, -2)
        closing = unit(x.axes + tilt)
        width = (x.chords.unsqueeze(-1) + LENGTH_SCALE * width).clamp_min(NARROWEST)
        spread = LEAST_SPREAD + SPREAD * functional.softplus(spread)
        approach = unit(across(ring_directions(x.axes, x.across), closing.unsqueeze(-2)))
        return Heads(contact.squeeze(-1), closing, width, spread, weight, approach, free)

    def _ring(self, x: Contacts, vectors: Tensor) -> Tensor:
        """Components of vectors (B, 3, n, C) along and beside each direction, (B, n, K, 2 C).

        Those beside without sign: the hand's camera may be on either side, so mirrored objects have
        mirrored grasps, and the network is equivariant to reflections as well.
        """
        side = torch.linalg.cross(x.axes, x.across)
        u = (vectors * x.across.transpose(-1, -2).unsqueeze(-1)).sum(-3).unsqueeze(-2)
        v = (vectors * side.transpose(-1, -2).unsqueeze(-1)).sum(-3).unsqueeze(-2)
        cos, sin = _turns(u)
        return torch.cat((cos * u + sin * v, torch.abs(sin * u - cos * v)), -1)


def ring_directions(axes: Tensor, reference: Tensor) -> Tensor:
    """Unit directions all round unit axes (..., 3), counted from unit references across them.

    Returns:
        Shape (..., K, 3).
    """
    side = torch.linalg.cross(axes, reference)
    cos, sin = _turns(axes)
    return cos * reference.unsqueeze(-2) + sin * side.unsqueeze(-2)


def _turns(like: Tensor) -> tuple[Tensor, Tensor]:
    """Cosines and sines (K, 1) of the ring's directions."""
    angle = torch.arange(DIRECTIONS, dtype=like.dtype, device=like.device).unsqueeze(-1)
    angle = angle * (2.0 * math.pi / DIRECTIONS)
    return torch.cos(angle), torch.sin(angle)


def chosen_points(values: Tensor, rows: Tensor, dim: int) -> Tensor:
    """Selected points, along axis ``dim``, of every cloud of a batch."""
    dim = dim % values.dim()
    shape = [1] * values.dim()
    shape[0], shape[dim] = rows.shape
    index = rows.reshape(shape)
    return torch.take_along_dim(values, index, dim)


def _with_neighbours(ring: Tensor) -> Tensor:
    """Channels (..., K, C) with the less and the greater of the next directions', (..., K, 3 C)."""
    before, after = ring.roll(1, -2), ring.roll(-1, -2)
    return torch.cat((ring, torch.minimum(before, after), torch.maximum(before, after)), -1)


class TorchGraspNetwork(GraspNetwork):
    """A grasp network with its torch module, to train and to compare with."""

    #: The class of its torch module.
    architecture: ClassVar[type[nn.Module]] = ContactNetwork

    @classmethod
    def untrained(cls, seed: int = 0) -> Self:
        """A network with random weights, to train or to test."""
        return cls.of(seeded(cls.architecture, seed))

    @classmethod
    def of(cls, network: nn.Module) -> Self:
        """The network that a torch module is at present."""
        sizes: Any = network.sizes
        made = cls(sizes, network_arrays(network))
        vars(made)["network"] = network.eval().requires_grad_(False)
        return made

    @cached_property
    def network(self) -> nn.Module:
        """Its torch module; changes of that are not the network's."""
        network = self.architecture(**self.sizes)
        fill_network(network, self.weights)
        return network.eval().requires_grad_(False)


def seeded(make: Callable[[], Network], seed: int) -> Network:
    """A torch network with random weights; the generator of torch is left as it is."""
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(seed)
        return make()


def fill_network(network: nn.Module, arrays: WeightArrays) -> None:
    """Fills a torch network; raises ValueError where the arrays are not its own."""
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    check_arrays(arrays, shapes)
    network.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})


def network_arrays(network: nn.Module) -> WeightArrays:
    """The weights that a torch network has at present, by name."""
    state = network.state_dict()
    return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}
