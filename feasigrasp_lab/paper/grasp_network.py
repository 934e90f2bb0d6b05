"""The grasp network of "Towards Feasible Dynamic Grasping" (arXiv 2311.02576), section IV-A.

As its authors published it: two VN-PointNet encoders, an equivariant decoder for the directions b
and a, and an invariant one for contact and width. Its weights were trained on the same data for the
same time as those of `ContactNetwork`.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import ClassVar

import numpy as np
import torch
from scipy.special import expit
from torch import Tensor, nn

from feasigrasp.models.grasps.network.contact_features import LENGTH_SCALE, ContactFeatures
from feasigrasp.models.grasps.network.network import GraspProposals
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.weights_file import WEIGHTS as PACKAGED
from feasigrasp_lab import WEIGHTS
from feasigrasp_lab.networks import (
    Contacts,
    Heads,
    TorchGraspNetwork,
    VectorLinear,
    VectorLinearReLU,
    across,
    chosen_points,
    unit,
    with_mean,
)


class PaperNetwork(nn.Module):
    """The paper's network; one approach direction, as likely free as the contact is a contact."""

    def __init__(self) -> None:
        super().__init__()
        self.sizes: dict[str, int] = {}
        self.equivariant_encoder = _PaperEncoder()
        self.invariant_encoder = _PaperEncoder()
        self.directions = nn.Sequential(
            VectorLinearReLU(128, 64), VectorLinearReLU(64, 32), VectorLinear(32, 2)
        )
        self.numbers = nn.Sequential(
            nn.Linear(32 * 32, 256), nn.ReLU(), nn.Linear(256, 64), nn.ReLU(), nn.Linear(64, 2)
        )

    def forward(self, x: Contacts, rows: Tensor | None = None) -> Heads:
        """What the network says of a batch of contacts, see `ContactNetwork.forward`."""
        position, normal = x.vectors[..., 0], x.vectors[..., 1]
        inputs = torch.stack((position * LENGTH_SCALE, -normal), -1)
        a, b = self.equivariant_encoder(inputs), self.invariant_encoder(inputs)
        both = with_mean(torch.cat((a, b), -1))
        if rows is not None:
            a, b, both = (chosen_points(part, rows, -2) for part in (a, b, both))
        closing, approach = self.directions(both).unbind(-1)
        closing = unit(closing.transpose(-1, -2))
        approach = unit(across(approach.transpose(-1, -2), closing))
        a, b = a.transpose(-3, -2), b.transpose(-3, -2)  # (B, n, 3, 32)
        contact, width = self.numbers((a.transpose(-1, -2) @ b).flatten(-2)).unbind(-1)
        width, score = torch.exp(width).unsqueeze(-1), contact.unsqueeze(-1)
        weight, approach = torch.zeros_like(width), approach.unsqueeze(-2)
        return Heads(contact, closing, width, 0.3 * width, weight, approach, score)


class _PaperEncoder(nn.Sequential):
    def __init__(self) -> None:
        super().__init__(
            VectorLinearReLU(2, 32),
            VectorLinear(32, 64),
            _WithMean(),
            VectorLinearReLU(128, 64),
            VectorLinear(64, 32),
        )


class _WithMean(nn.Module):
    def forward(self, vectors: Tensor) -> Tensor:
        return with_mean(vectors)


def torch_heads(network: nn.Module, features: ContactFeatures) -> Heads:
    """What a torch module says of contacts, all approaches, without the batch axis."""
    with torch.inference_mode():
        return Heads(*(head[0] for head in network(Contacts.of(features))))


class PaperGraspNetwork(TorchGraspNetwork):
    """The paper's network, ready to propose; it runs on the threads of torch."""

    preset: ClassVar[str] = "paper"
    architecture = PaperNetwork

    def check(self) -> None:
        """Raises ValueError where arrays are missing, or not of the architecture."""
        _ = self.network

    def propose_at(self, features: ContactFeatures) -> GraspProposals:
        """As `propose`, from features in the precision of the network's weights."""
        heads = torch_heads(self.network, features)
        contact, score = (expit(at.double().numpy()) for at in (heads.contact, heads.free))
        width, spread = (of_mode.double().numpy() for of_mode in heads.mode_width())
        closing, approach = (at.double().numpy() for at in (heads.closing, heads.approach))
        return GraspProposals(contact, closing, width, np.sqrt(2.0) * spread, approach, score)


#: The architectures that are trained and compared, by their names.
NETWORKS: Mapping[str, type[TorchGraspNetwork]] = {
    network.preset: network for network in (TorchGraspNetwork, PaperGraspNetwork)
}


@lru_cache
def trained_network(preset: str) -> TorchGraspNetwork:
    """The trained network of an architecture, one of `NETWORKS`, loaded once.

    Raises:
        WeightsError: See `GraspNetwork.load`.
    """
    if preset == PaperGraspNetwork.preset:
        return PaperGraspNetwork.load(WEIGHTS / "grasp_network_paper.npz")
    return TorchGraspNetwork.load(PACKAGED / "grasp_network.npz")


def make_sampler(
    gripper: ParallelGripper, *, n_candidates: int, n_grasps: int, least_score: float, seed: int = 0
) -> NetworkSampler:
    """The sampler ``paper``: this network, and nothing else to fall back on; it draws nothing."""
    return NetworkSampler(
        gripper,
        trained_network(PaperGraspNetwork.preset),
        n_contacts=max(1, n_candidates // NetworkSampler.n_approaches),
        n_grasps=n_grasps,
        least_score=least_score,
        top_up=False,
    )
