"""Training examples of the grasp networks as tensors, and the losses.

They are the shards of `feasigrasp_lab.training.train_sampler_data`. Everything but the contact
counts at points where a valid grasp starts only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from feasigrasp.models.arrays import Indices, Mask
from feasigrasp.models.grasps.network.contact_features import ContactFeatures, contact_features
from feasigrasp_lab.networks import Contacts, Heads, chosen_points, ring_directions
from feasigrasp_lab.paper.grasp_network import PaperGraspNetwork
from feasigrasp_lab.results.finished import read_shards
from feasigrasp_lab.training.loop import data_files, split_families

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
        return Labels(*(chosen_points(part, rows, 1) for part in self))


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


#: Entries of a shard that are read; the first axis is that of its examples.
ENTRIES = (
    *("points", "normals", "scalars", "contact", "width", "closing", "across", "free"),
    *("family", "true_surface"),
)


@dataclass(frozen=True, eq=False)
class Examples:
    """Examples of equal size, stacked: features, labels, and where they come from.

    Attributes:
        contacts: Features, N examples in front.
        labels: Truth, N examples in front.
        family: Family of shapes of each example, shape (N,).
        true_surface: Whether the true surface was the input instead of a completed one, (N,).
    """

    contacts: Contacts
    labels: Labels
    family: NDArray[np.str_]
    true_surface: Mask

    def __len__(self) -> int:
        """Number of examples."""
        return len(self.family)

    def batch(self, rows: Indices, device: torch.device | str) -> tuple[Contacts, Labels]:
        """Features and labels of some examples, float32 on a device."""
        index = torch.from_numpy(rows)

        def chosen(parts: Sequence[Tensor]) -> Iterator[Tensor]:
            for part in parts:
                found = part[index].to(device)
                yield found if found.dtype in (torch.bool, torch.float32) else found.float()

        return Contacts(*chosen(self.contacts)), Labels(*chosen(self.labels))


def load_examples(
    folder: Path, seed: int, n_held_out: int, most: int | None = None
) -> tuple[Examples, Examples]:
    """Reads all shards of a folder; examples to train on, and held-out ones, by `split_families`.

    Raises:
        TrainingError: There are no shards, or one side would be empty.
        InputError: A shard is broken.
    """
    data = read_shards(data_files(folder), ENTRIES)
    what = f"{folder} holds examples"
    rest, held = split_families(data["family"], what, seed, n_held_out, most)
    return _stack(data, rest), _stack(data, held)


def _stack(data: dict[str, NDArray[Any]], rows: Indices) -> Examples:
    contacts, labels = [], []
    for row in tqdm(rows, desc="examples", leave=False):
        surface = (data[name][row].astype(np.float32) for name in ("points", "normals", "scalars"))
        features = contact_features(*surface)
        found = Contacts(*(part[0] for part in Contacts.of(features)))
        # Half precision where the bulk is: nothing there is known better.
        contacts.append(found._replace(room=found.room.half()))
        truth = {name: torch.from_numpy(data[name][row]) for name in Labels._fields[:-1]}
        labels.append(Labels(**truth, ring=_ring(features, truth).half()))
    return Examples(
        Contacts(*map(torch.stack, zip(*contacts, strict=True))),
        Labels(*map(torch.stack, zip(*labels, strict=True))),
        data["family"][rows],
        data["true_surface"][rows],
    )


def _ring(features: ContactFeatures, truth: dict[str, Tensor]) -> Tensor:
    """How free the hand is for the directions of the ring, (n, K); zero where no grasp starts."""
    axes, across = torch.from_numpy(features.axes), torch.from_numpy(features.across)
    turns = (truth[name] for name in ("closing", "across", "free"))
    return free_share(ring_directions(axes, across), *turns)
