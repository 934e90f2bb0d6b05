"""Training examples as tensors: the shards of `feasigrasp_lab.training.train_sampler_data`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from feasigrasp.models.arrays import Indices, Mask
from feasigrasp.models.grasps.network.contact_features import ContactFeatures, contact_features
from feasigrasp_lab.networks.contact_network import Contacts, ring_directions
from feasigrasp_lab.results.finished import read_shard
from feasigrasp_lab.training.grasp_losses import Labels, free_share
from feasigrasp_lab.training.loop import TrainingError

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
    folder: Path, held_out: Sequence[str], seed: int, n_held_out: int, most: int | None = None
) -> tuple[Examples, Examples]:
    """Reads all shards of a folder and splits off the families that are held out.

    Args:
        folder: Where the shards are.
        held_out: Names of the families that are not trained on.
        seed: Draws the held-out examples that are used.
        n_held_out: Their number, at most.
        most: Number of training examples, at most; all when None.

    Returns:
        Examples to train on, and held-out ones.

    Raises:
        TrainingError: There are no shards, or one side would be empty.
        InputError: A shard is broken.
    """
    files = sorted(Path(folder).glob("*.npz"))
    if not files:
        raise TrainingError(
            f"there are no shards in {folder}; make them with `feasigrasp "
            "train sampler-data`, or name their folder with --data"
        )
    shards = [read_shard(file, ENTRIES) for file in files]
    data = {name: np.concatenate([shard[name] for shard in shards]) for name in ENTRIES}
    family = data["family"]
    of_held = np.isin(family, list(held_out))
    held, rest = np.flatnonzero(of_held), np.flatnonzero(~of_held)
    if len(held) == 0 or len(rest) == 0:
        raise TrainingError(
            f"{folder} holds examples of the families {', '.join(np.unique(family))}; to train and "
            f"to judge, both these held out are needed and others: {', '.join(held_out)}"
        )
    rng = np.random.default_rng(seed)
    held = np.sort(rng.permutation(held)[:n_held_out])
    rest = np.sort(rng.permutation(rest)[:most])
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
