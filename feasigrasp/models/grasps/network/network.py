"""The trained grasp network: one grasp for every surface point of an object.

- Vector neurons (Deng et al., ICCV 2021) over position, normal, chord and neighbourhood vectors,
  with the mean over the cloud as context, give a correction of the closing direction, which starts
  out as the inward normal, and invariants.
- A perceptron on the invariants gives contact probability and two possible widths, as corrections
  of the chord, with spreads and weights.
- A ring of approach directions round each contact shares one small perceptron, which gives the
  probability that the hand is free.

It is exactly equivariant: grasps move with the object. It runs without torch; its torch module, for
training, is `feasigrasp_lab.networks.ContactNetwork`.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from threadpoolctl import ThreadpoolController

from feasigrasp.models.arrays import Array, Floats, Frozen
from feasigrasp.models.grasps.network import inference_kernels as kernels
from feasigrasp.models.grasps.network.contact_features import (
    NUMBERS,
    VECTORS,
    ContactFeatures,
    contact_features,
)
from feasigrasp.models.grasps.network.inference_kernels import WIDTHS, FusedWeights
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.grasps.network.surroundings import ROOM
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.weights_file import WEIGHTS, WeightArrays, WeightsFormat, check_arrays

#: Approach directions that are handed on for each contact. Source: layout: output of the network.
MODES = 6
#: Room of the hand for an opposite contact that is farther away than predicted: standard deviations
#: of the prediction, and a margin on either side [m]. Source: guessed.
ROOM_DEVIATIONS, ROOM_BESIDE = 2.0, 6e-3
#: The spread of a width that training starts with, and the least one [m]. Source: guessed.
SPREAD, LEAST_SPREAD = 5e-3, 2e-4
#: Vectors that may tilt the closing direction, and that the ring sees. Source: layout: the
#: network's architecture.
TILTS, BESIDE = 8, 6
_FILE = WeightsFormat("grasp network", "feasigrasp grasp_network 1", "feasigrasp train sampler")


def array_shapes(
    vectors: int = 24, hidden: int = 128, ring: int = 32
) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the weights, as torch names them.

    By the channels of the vector neurons, the width of the invariant perceptron, and that of the
    perceptron that approach directions share.
    """
    unbiased = {
        "encode.mix": (vectors + 1, VECTORS),
        "refine.mix": (vectors + 1, 2 * vectors),
        "tilt": (TILTS, vectors),
        "beside": (BESIDE, vectors),
        "ring_room": (ring, 3 * ROOM + 2 * BESIDE),
    }
    biased = {
        "survey": (hidden // 2, NUMBERS + vectors),
        "first": (hidden, NUMBERS + 2 * vectors),
        "context": (hidden, hidden),
        "second": (hidden, hidden),
        "to_ring": (ring, hidden),
        "ring_hidden": (ring, ring),
        "ring_free": (1, ring),
        "judge": (hidden // 2, hidden + ring + 1),
        "last": (1 + 3 * WIDTHS, hidden // 2),
        "gates": (TILTS, hidden),
    }
    shapes = {f"{name}.weight": shape for name, shape in (unbiased | biased).items()}
    return shapes | {f"{name}.bias": shape[:1] for name, shape in biased.items()}


@lru_cache(maxsize=1)
def _threads() -> ThreadpoolController:
    return ThreadpoolController()


@dataclass(frozen=True, eq=False)
class GraspProposals(Frozen):
    """Proposals of a network at each of n points, in the frame O of its input.

    Attributes:
        contact: Probability that a valid grasp starts at the point, shape (n,).
        closing: Closing direction b from there into the object, unit, shape (n, 3).
        width: Most probable distance to the contact opposite, or more, see `with_room` [m], shape
            (n,).
        width_deviation: Standard deviation of the width, if it is that one [m], shape (n,).
        approach: M approach directions, best first, unit and perpendicular to ``closing``, shape
            (n, M, 3).
        approach_score: Probability that the whole open hand is free that way, shape (n, M).
    """

    contact: Array
    closing: Array
    width: Array
    width_deviation: Array
    approach: Array
    approach_score: Array

    def __post_init__(self) -> None:
        self._freeze(**vars(self))


@dataclass(frozen=True, eq=False)
class GraspNetwork(Frozen):
    """A grasp network, ready to propose, as fused kernels in numba.

    Eager torch writes every intermediate result of the whole cloud to memory and reads it back;
    here contacts go through the network in tiles that stay in the cache. Arrays have channels first
    and contacts last, so that every loop runs over contiguous contacts. Computes in the precision
    of its weights, on one thread. For 512 points: 1.3 ms; eager torch 3.9, TorchScript 2.5 ms.

    Attributes:
        sizes: Of its layers.
        weights: Its arrays, by the names that torch gives them, all float32 or all float64.
        gripper: The hand whose room is measured round each contact.
    """

    sizes: dict[str, int]
    weights: dict[str, Floats]
    gripper: ParallelGripper = field(default_factory=ParallelGripper)

    #: Name of the architecture in the headers of files.
    preset: ClassVar[str] = "default"

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Loads a network that `save` wrote.

        Raises:
            WeightsError: The file is missing, broken, or does not match the architecture.
        """
        return _FILE.load(path, cls._of)

    @classmethod
    def _of(cls, header: dict[str, Any], arrays: WeightArrays) -> Self:
        if header["preset"] != cls.preset:
            raise ValueError(f"it holds preset {header['preset']}, not {cls.preset}")
        network = cls(header["sizes"], dict(arrays))
        network.check()
        return network

    def check(self) -> None:
        """Raises ValueError where arrays are missing, or not of the architecture."""
        check_arrays(self.weights, array_shapes(**self.sizes))

    def save(self, path: str | Path) -> None:
        """Writes sizes and weights into one ``.npz`` file, whole or not at all."""
        _FILE.save(path, {"preset": self.preset, "sizes": self.sizes}, self.weights)

    def propose(self, surface: GraspInput) -> GraspProposals:
        """Proposes a grasp at every point of a surface, on one thread.

        Raises:
            GraspError: The input has no points.
        """
        arrays = (surface.points, surface.normals, surface.scalars)
        return self.propose_at(contact_features(*arrays, self.gripper))

    def propose_at(self, features: ContactFeatures) -> GraspProposals:
        """As `propose`, from features in the precision of the network's weights."""
        x, (w, of_mean) = features, self._fused
        n, kind = len(x.chords), w.encode.dtype
        frames = np.empty((3, 3, n), dtype=kind)
        frames[0], frames[1] = x.axes.T, x.across.T
        frames[2] = np.cross(x.axes, x.across).T
        directions = x.room.shape[1]
        angle = 2.0 * np.pi * np.arange(directions) / directions
        turns = np.stack([np.cos(angle), np.sin(angle)]).astype(kind)
        shapes = (1 + 3 * WIDTHS, n), (3, n), (directions, n)
        outputs = kernels.ContactOutputs(*(np.empty(shape, dtype=kind) for shape in shapes))
        with _threads().limit(limits=1, user_api="blas"):
            encoded, mean, pooled = kernels.cloud_kernel(x.vectors, x.numbers, w)
            context = w.context @ pooled + w.context_bias + w.second_bias
            shift = mean @ of_mean.T
            seen = encoded, shift, x.numbers, x.room, frames, turns, context
            kernels.contacts_kernel(kernels.EncodedCloud(*seen), w, TILTS, outputs)
        closing, width, spread = np.empty((n, 3)), np.empty(n), np.empty(n)
        approach, score = np.empty((n, MODES, 3)), np.empty((n, MODES))
        grasps = (closing, width, spread, approach, score)
        kernels.grasps_kernel(x.chords, frames, turns, outputs, grasps)
        contact, score = (
            1.0 / (1.0 + np.exp(-logit)) for logit in (outputs.head[0].astype(float), score)
        )
        # Of a Laplace distribution, whose scale the network gives.
        deviation = np.sqrt(2.0) * (LEAST_SPREAD + SPREAD * np.logaddexp(0.0, spread))
        width = with_room(width, deviation, self.gripper.max_opening)
        return GraspProposals(contact, closing, width, deviation, approach, score)

    @cached_property
    def _fused(self) -> tuple[FusedWeights, Floats]:
        """The weights as the kernels take them, and those of the mean in the refining layer."""
        w = {name: np.ascontiguousarray(array) for name, array in self.weights.items()}
        refine, vectors = w["refine.mix.weight"], len(w["encode.mix.weight"]) - 1
        made = {
            "encode": w["encode.mix.weight"],
            "refine": np.ascontiguousarray(refine[:, :vectors]),
            "tilt_beside": np.concatenate([w["tilt.weight"], w["beside.weight"]]),
            "ring_gates": np.concatenate([w["to_ring.weight"], w["gates.weight"]]),
            "ring_gates_bias": np.concatenate([w["to_ring.bias"], w["gates.bias"]]),
        }
        for name in FusedWeights._fields:
            if name not in made:
                layer = name.removesuffix("_bias")
                made[name] = w[f"{layer}.{'weight' if layer == name else 'bias'}"]
        return FusedWeights(**made), np.ascontiguousarray(refine[:, vectors:])


def with_room(width: Array, deviation: Array, opening: float) -> Array:
    """Widths (n,) that centre a hand so that it has room for a far contact that is uncertain [m].

    A finger that is too far out costs nothing, one that is too near stands in the object. So the
    most probable width grows where `ROOM_DEVIATIONS` need more than the room behind it, and by no
    more than leaves `ROOM_BESIDE` at the near finger.
    """
    behind = 0.5 * (opening - width)
    most = np.maximum(behind - ROOM_BESIDE, 0.0)
    more = np.clip(ROOM_DEVIATIONS * deviation + ROOM_BESIDE - behind, 0.0, most)
    return np.asarray(width + 2.0 * more)


@lru_cache(maxsize=1)
def load_grasp_network() -> GraspNetwork:
    """The trained network that comes with the package, loaded once.

    Raises:
        WeightsError: See `GraspNetwork.load`.
    """
    return GraspNetwork.load(WEIGHTS / "grasp_network.npz")
