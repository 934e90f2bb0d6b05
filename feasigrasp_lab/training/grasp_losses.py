"""Losses of the grasp networks.

Everything but the contact counts at points where a valid grasp starts only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from feasigrasp_lab.networks.contact_network import Heads
from feasigrasp_lab.paper.grasp_network import PaperGraspNetwork

#: Closing directions off by less than this count by the square, beyond it linearly [rad]. Source:
#: guessed.
_SLIGHT = math.radians(3.0)
#: Weights of the parts.
_WEIGHTS = {"contact": 1.0, "width": 0.2, "closing": 4.0, "approach": 1.0}
#: A predicted approach counts as valid from this share of free turns beside it. Source: reasoned:
#: even odds.
FREE = 0.5


class Labels(NamedTuple):
    """Truth for a batch of B clouds of n points; zero where no grasp starts.

    Attributes:
        contact: Whether a valid grasp starts at a point, (B, n).
        width: Of the best one [m], (B, n).
        closing: Its closing direction, (B, n, 3).
        across: Its approach direction of turn 0, (B, n, 3).
        free: How free the hand is for T turns about the closing direction, (B, n, T), in [0, 1].
        ring: How free it is for the approach directions that the default network starts from,
            (B, n, K), in [0, 1].
    """

    contact: Tensor
    width: Tensor
    closing: Tensor
    across: Tensor
    free: Tensor
    ring: Tensor

    def chosen(self, rows: Tensor) -> Labels:
        """The labels of some rows (B, m)."""
        return Labels(
            *(
                torch.take_along_dim(part, rows.reshape(*rows.shape, *[1] * (part.dim() - 2)), 1)
                for part in self
            )
        )


def loss(preset: str, heads: Heads, labels: Labels) -> tuple[Tensor, dict[str, Tensor]]:
    """The training loss of a preset, and its parts."""
    mask = labels.contact
    off = torch.linalg.vector_norm(heads.closing[mask] - labels.closing[mask], dim=-1)
    if preset == PaperGraspNetwork.preset:
        width = (heads.width[mask, 0].log() - labels.width[mask].log()).abs()
        approach = _nearest_approach(heads, labels)
    else:
        error, spread = (heads.width - labels.width.unsqueeze(-1))[mask].abs(), heads.spread[mask]
        likelihood = heads.weight[mask].log_softmax(-1) - error / spread - torch.log(spread / 1e-3)
        width = -likelihood.logsumexp(-1)
        approach = functional.binary_cross_entropy_with_logits(
            heads.free[mask], labels.ring[mask], reduction="none"
        )
    slight = functional.huber_loss(off, torch.zeros_like(off), delta=_SLIGHT, reduction="none")
    parts = {
        "contact": functional.binary_cross_entropy_with_logits(
            heads.contact, mask.to(heads.contact.dtype)
        ),
        "width": _mean(width),
        "closing": _mean(slight / _SLIGHT),
        "approach": _mean(approach),
    }
    total = sum((_WEIGHTS[name] * part for name, part in parts.items()), labels.width.new_zeros(()))
    return total, parts


def _mean(values: Tensor) -> Tensor:
    """The mean; zero, not NaN, of no values."""
    return values.sum() / max(values.numel(), 1)


def free_share(approach: Tensor, closing: Tensor, across: Tensor, free: Tensor) -> Tensor:
    """How free the hand is for some approaches, interpolated between the turns of the labels.

    Args:
        approach: K directions at m contacts, which need not lie across, (m, K, 3).
        closing: Closing directions of the labels, (m, 3).
        across: Their approach direction of turn 0, (m, 3).
        free: How free the hand is for T turns, (m, T).

    Returns:
        In [0, 1], (m, K).
    """
    side = torch.linalg.cross(closing, across)
    y, x = (approach @ v.unsqueeze(-1) for v in (side, across))
    turns = free.shape[-1]
    turn = torch.atan2(y, x).squeeze(-1) * (turns / (2.0 * math.pi)) + turns
    floor = turn.floor()
    share = turn - floor
    first, free = floor.long() % turns, free.float()
    return free.gather(-1, first) * (1.0 - share) + free.gather(-1, (first + 1) % turns) * share


def _nearest_approach(heads: Heads, labels: Labels) -> Tensor:
    """The least ``1 - a . a_j`` over valid approaches, (m,)."""
    mask = labels.contact
    u, b = labels.across[mask], labels.closing[mask]
    turns = labels.free.shape[-1]
    t = torch.arange(turns, device=u.device, dtype=u.dtype) * (2.0 * math.pi / turns)
    v = torch.linalg.cross(b, u)
    a = heads.approach[mask][:, 0]
    cosine = (a * u).sum(-1, keepdim=True) * t.cos() + (a * v).sum(-1, keepdim=True) * t.sin()
    valid = torch.where(labels.free[mask] > FREE, cosine, -1.0)
    return 1.0 - valid.amax(-1)
