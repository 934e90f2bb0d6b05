"""The trained grasp networks: from the surface of an object to a grasp at every point.

Two presets: ``default``, and ``paper``, the paper's own architecture with weights trained on the
same data for the same time; see `feasigrasp.models.grasps.network.architectures` for what they
compute. Both are exactly equivariant: grasps move with the object. The default one works without
torch.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import expit

from feasigrasp.errors import GraspError, needed_by
from feasigrasp.models.arrays import Array, Floats, Frozen
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.grasps.network.contact_features import ContactFeatures, contact_features
from feasigrasp.models.grasps.network.inference import FusedContactNetwork, array_shapes
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.weights_file import (
    WEIGHTS,
    WeightArrays,
    WeightsFormat,
    check_arrays,
    fill_network,
    network_arrays,
)

if TYPE_CHECKING:
    from torch import nn

    from feasigrasp.models.grasps.network.architectures import Heads


class Preset(StrEnum):
    """Which network."""

    DEFAULT = "default"
    PAPER = "paper"


#: Approach directions that are handed on for each contact.
MODES = 6
#: Where the contact opposite may be farther away than it likely is, the hand makes room for so many
#: standard deviations of that, and for this much more on either side [m].
ROOM_DEVIATIONS, ROOM_BESIDE = 2.0, 6e-3
_FILE = WeightsFormat("grasp network", "feasigrasp grasp_network 1", "feasigrasp train sampler")


@dataclass(frozen=True, eq=False)
class GraspProposals(Frozen):
    """What a network proposes at each of n points, in the frame O of its input.

    Attributes:
        contact: Probability that a valid grasp starts at the point, shape (n,).
        closing: Closing direction b from there into the object, unit, shape (n, 3).
        width: Likeliest distance to the contact opposite, or more, see `with_room` [m], shape (n,).
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
        """Makes the arrays read-only."""
        self._freeze(**vars(self))


@dataclass(frozen=True, eq=False)
class GraspNetwork(Frozen):
    """A grasp network, ready to propose.

    Attributes:
        preset: Which one.
        sizes: Of its layers.
        weights: Its arrays, by the names that torch gives them.
        gripper: The hand whose room is measured round each contact.
    """

    preset: Preset
    sizes: dict[str, int]
    weights: dict[str, Floats]
    gripper: ParallelGripper = field(default_factory=ParallelGripper)

    @classmethod
    def untrained(cls, preset: str = Preset.DEFAULT, seed: int = 0) -> GraspNetwork:
        """A network with random weights, to train or to test.

        Raises:
            GraspError: There is no such preset.
            MissingPackageError: There is no torch.
        """
        preset = _parse(preset)
        architecture = _architecture(preset)
        import torch

        state = torch.random.get_rng_state()
        torch.manual_seed(seed)
        network = architecture()
        torch.random.set_rng_state(state)
        return cls.of(preset, network)

    @classmethod
    def of(cls, preset: Preset, network: nn.Module) -> GraspNetwork:
        """The network that a torch module is at present."""
        sizes: Any = network.sizes
        made = cls(preset, sizes, network_arrays(network))
        vars(made)["network"] = network.eval().requires_grad_(False)
        return made

    @classmethod
    def load(cls, path: str | Path) -> GraspNetwork:
        """Loads a network that `save` wrote.

        Raises:
            WeightsError: The file is missing, broken, or does not match its architecture.
            MissingPackageError: It is the paper's network, and there is no torch.
        """
        return _FILE.load(path, cls._of)

    @classmethod
    def _of(cls, header: dict[str, Any], arrays: WeightArrays) -> GraspNetwork:
        network = cls(_parse(header["preset"]), header["sizes"], dict(arrays))
        if network.preset == Preset.DEFAULT:
            check_arrays(arrays, array_shapes(**network.sizes))
        else:
            _ = network.network  # checks them
        return network

    def save(self, path: str | Path) -> None:
        """Writes preset, sizes and weights into one ``.npz`` file, whole or not at all."""
        _FILE.save(path, {"preset": self.preset, "sizes": self.sizes}, self.weights)

    @cached_property
    def network(self) -> nn.Module:
        """Its torch module; changes of that are not the network's.

        Raises:
            MissingPackageError: There is no torch.
        """
        network = _architecture(self.preset)(**self.sizes)
        fill_network(network, self.weights)
        return network.eval().requires_grad_(False)

    def with_gripper(self, gripper: ParallelGripper) -> GraspNetwork:
        """The same network for another hand; no training is needed."""
        return replace(self, gripper=gripper)

    def propose(self, surface: GraspInput) -> GraspProposals:
        """Proposes a grasp at every point of a surface.

        The default network runs on one thread (see `feasigrasp.models.grasps.network.inference`),
        the paper's on those of torch; ``torch.set_num_threads(1)`` is best at control rate.

        Args:
            surface: Points, normals and invariants; n > 0.

        Raises:
            GraspError: The input has no points.
        """
        arrays = (surface.points, surface.normals, surface.scalars)
        return self.propose_at(contact_features(*arrays, self.gripper))

    def propose_at(self, features: ContactFeatures) -> GraspProposals:
        """As `propose`, from features in the precision of the network's weights."""
        if self._fused is not None:
            contact, closing, width, spread, approach, score = self._fused(features, MODES)
            width = with_room(width, np.sqrt(2.0) * spread, self.gripper.max_opening)
        else:
            heads = self.heads(features)
            contact, score = (expit(at.double().numpy()) for at in (heads.contact, heads.free))
            width, spread = (of_mode.double().numpy() for of_mode in heads.likeliest_width())
            closing, approach = (at.double().numpy() for at in (heads.closing, heads.approach))
        return GraspProposals(contact, closing, width, np.sqrt(2.0) * spread, approach, score)

    def heads(self, features: ContactFeatures) -> Heads:
        """What the torch network says of contacts, see `architectures.heads`."""
        network = self.network  # says so if there is no torch
        from feasigrasp.models.grasps.network.architectures import heads

        return heads(network, features)

    @cached_property
    def _fused(self) -> FusedContactNetwork | None:
        return FusedContactNetwork(self.weights) if self.preset == Preset.DEFAULT else None


def with_room(width: Array, deviation: Array, opening: float) -> Array:
    """Widths that centre a hand so that it has room for a far contact that is uncertain.

    A finger that is too far out costs nothing, one that is too near stands in the object.

    Args:
        width: Likeliest widths, shape (n,) [m].
        deviation: Their standard deviations, shape (n,) [m].
        opening: Of the hand [m].

    Returns:
        Shape (n,) [m]; more than ``width`` only where `ROOM_DEVIATIONS` need more than the room
        behind it, and no more than leaves `ROOM_BESIDE` at the near finger.
    """
    behind = 0.5 * (opening - width)
    most = np.maximum(behind - ROOM_BESIDE, 0.0)
    more = np.clip(ROOM_DEVIATIONS * deviation + ROOM_BESIDE - behind, 0.0, most)
    return np.asarray(width + 2.0 * more)


def load_grasp_network(preset: str = Preset.DEFAULT) -> GraspNetwork:
    """The trained network that comes with the package, loaded once.

    Raises:
        GraspError: There is no such preset.
        WeightsError: See `GraspNetwork.load`.
    """
    return _load(_parse(preset))


def weights_file(preset: Preset) -> Path:
    """Where the trained weights of a preset are."""
    name = "grasp_network" if preset == Preset.DEFAULT else f"grasp_network_{preset}"
    return WEIGHTS / f"{name}.npz"


@lru_cache(maxsize=len(Preset))
def _load(preset: Preset) -> GraspNetwork:
    return GraspNetwork.load(weights_file(preset))


def _parse(preset: str) -> Preset:
    return parse_choice(Preset, preset, "the preset of a grasp network", GraspError)


def _architecture(preset: Preset) -> type[nn.Module]:
    with needed_by(f"the grasp network '{preset}'"):
        from feasigrasp.models.grasps.network.architectures import ContactNetwork, PaperNetwork

    return ContactNetwork if preset == Preset.DEFAULT else PaperNetwork
