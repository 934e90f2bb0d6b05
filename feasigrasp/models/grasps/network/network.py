"""The trained grasp network: one grasp for every surface point of an object.

See `feasigrasp.models.grasps.network.architectures` for what it computes. It is exactly
equivariant: grasps move with the object. It works without torch.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from feasigrasp.errors import needed_by
from feasigrasp.models.arrays import Array, Floats, Frozen
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

#: Approach directions that are handed on for each contact.
MODES = 6
#: Where the contact opposite may be farther away than it likely is, the hand makes room for so many
#: standard deviations of that, and for this much more on either side [m].
ROOM_DEVIATIONS, ROOM_BESIDE = 2.0, 6e-3
_FILE = WeightsFormat("grasp network", "feasigrasp grasp_network 1", "feasigrasp train sampler")


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
        """Makes the arrays read-only."""
        self._freeze(**vars(self))


@dataclass(frozen=True, eq=False)
class GraspNetwork(Frozen):
    """A grasp network, ready to propose.

    Attributes:
        sizes: Of its layers.
        weights: Its arrays, by the names that torch gives them.
        gripper: The hand whose room is measured round each contact.
    """

    sizes: dict[str, int]
    weights: dict[str, Floats]
    gripper: ParallelGripper = field(default_factory=ParallelGripper)

    #: Name of the architecture in the headers of files.
    preset: ClassVar[str] = "default"

    @classmethod
    def untrained(cls, seed: int = 0) -> Self:
        """A network with random weights, to train or to test.

        Raises:
            MissingPackageError: There is no torch.
        """
        architecture = cls.architecture()
        import torch

        state = torch.random.get_rng_state()
        torch.manual_seed(seed)
        network = architecture()
        torch.random.set_rng_state(state)
        return cls.of(network)

    @classmethod
    def of(cls, network: nn.Module) -> Self:
        """The network that a torch module is at present."""
        sizes: Any = network.sizes
        made = cls(sizes, network_arrays(network))
        vars(made)["network"] = network.eval().requires_grad_(False)
        return made

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

    @classmethod
    def architecture(cls) -> type[nn.Module]:
        """The class of its torch module.

        Raises:
            MissingPackageError: There is no torch.
        """
        with needed_by("the torch module of a grasp network"):
            from feasigrasp.models.grasps.network.architectures import ContactNetwork

        return ContactNetwork

    def save(self, path: str | Path) -> None:
        """Writes sizes and weights into one ``.npz`` file, whole or not at all."""
        _FILE.save(path, {"preset": self.preset, "sizes": self.sizes}, self.weights)

    @cached_property
    def network(self) -> nn.Module:
        """Its torch module; changes of that are not the network's.

        Raises:
            MissingPackageError: There is no torch.
        """
        network = self.architecture()(**self.sizes)
        fill_network(network, self.weights)
        return network.eval().requires_grad_(False)

    def with_gripper(self, gripper: ParallelGripper) -> Self:
        """The network for another hand, without training."""
        return replace(self, gripper=gripper)

    def propose(self, surface: GraspInput) -> GraspProposals:
        """Proposes a grasp at every point of a surface.

        It runs on one thread (see `feasigrasp.models.grasps.network.inference`).

        Args:
            surface: Points, normals and invariants; n > 0.

        Raises:
            GraspError: The input has no points.
        """
        arrays = (surface.points, surface.normals, surface.scalars)
        return self.propose_at(contact_features(*arrays, self.gripper))

    def propose_at(self, features: ContactFeatures) -> GraspProposals:
        """As `propose`, from features in the precision of the network's weights."""
        contact, closing, width, spread, approach, score = self._fused(features, MODES)
        width = with_room(width, np.sqrt(2.0) * spread, self.gripper.max_opening)
        return GraspProposals(contact, closing, width, np.sqrt(2.0) * spread, approach, score)

    @cached_property
    def _fused(self) -> FusedContactNetwork:
        return FusedContactNetwork(self.weights)


def with_room(width: Array, deviation: Array, opening: float) -> Array:
    """Widths that centre a hand so that it has room for a far contact that is uncertain.

    A finger that is too far out costs nothing, one that is too near stands in the object.

    Args:
        width: Most probable widths, shape (n,) [m].
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


@lru_cache(maxsize=1)
def load_grasp_network() -> GraspNetwork:
    """The trained network that comes with the package, loaded once.

    Raises:
        WeightsError: See `GraspNetwork.load`.
    """
    return GraspNetwork.load(WEIGHTS / "grasp_network.npz")
