"""Training examples as tensors: the shards of `feasigrasp.training.train_sampler_data`."""

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
from feasigrasp.models.grasps.network.architectures import Contacts, ring_directions
from feasigrasp.models.grasps.network.contact_features import ContactFeatures, contact_features
from feasigrasp.training.grasp_losses import Labels, free_share
from feasigrasp.training.loop import TrainingError

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
        TrainingError: There are no shards, one is broken, or one side would be empty.
    """
    files = sorted(Path(folder).glob("*.npz"))
    if not files:
        raise TrainingError(
            f"there are no shards in {folder}; make them with `feasigrasp "
            "train sampler-data`, or name their folder with --data"
        )
    shards = [_read(file) for file in files]
    family = np.concatenate([shard["family"] for shard in shards])
    where = [(s, row) for s, shard in enumerate(shards) for row in range(len(shard["family"]))]
    held = np.flatnonzero(np.isin(family, list(held_out)))
    rest = np.flatnonzero(~np.isin(family, list(held_out)))
    if len(held) == 0 or len(rest) == 0:
        raise TrainingError(
            f"{folder} holds examples of the families {', '.join(np.unique(family))}; to train and "
            f"to judge, both these held out are needed and others: {', '.join(held_out)}"
        )
    rng = np.random.default_rng(seed)
    held = np.sort(rng.permutation(held)[:n_held_out])
    rest = np.sort(rng.permutation(rest)[:most])
    return _stack(shards, where, rest), _stack(shards, where, held)


def _read(file: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(file, allow_pickle=False) as content:
            shard = {name: content[name] for name in ENTRIES}
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise TrainingError(f"{file} is not a shard of training data: {error}") from None
    n = {len(array) for array in shard.values()}
    if len(n) != 1:
        raise TrainingError(f"{file}: its entries have different numbers of examples")
    return shard


def _stack(
    shards: list[dict[str, NDArray[Any]]], where: list[tuple[int, int]], rows: Indices
) -> Examples:
    contacts: dict[str, list[Tensor]] = {name: [] for name in Contacts._fields}
    labels: dict[str, list[Tensor]] = {name: [] for name in Labels._fields}
    family, true_surface = [], []
    for row in tqdm(rows, desc="examples", leave=False):
        shard, place = shards[where[row][0]], where[row][1]
        example = {name: shard[name][place] for name in ENTRIES}
        features = contact_features(
            *(example[name].astype(np.float32) for name in ("points", "normals", "scalars"))
        )
        for (name, parts), part in zip(contacts.items(), Contacts.of(features), strict=True):
            # Half precision where the bulk is: nothing there is known better.
            parts.append(part[0].half() if name == "room" else part[0])
        for name, parts in labels.items():
            if name != "ring":
                parts.append(torch.from_numpy(example[name]))
        labels["ring"].append(_ring(features, example).half())
        family.append(str(example["family"]))
        true_surface.append(bool(example["true_surface"]))
    return Examples(
        Contacts(*(torch.stack(contacts[name]) for name in Contacts._fields)),
        Labels(*(torch.stack(labels[name]) for name in Labels._fields)),
        np.array(family),
        np.array(true_surface),
    )


def _ring(features: ContactFeatures, example: dict[str, NDArray[Any]]) -> Tensor:
    """How free the hand is for the directions of the ring, (n, K); zero where no grasp starts."""
    axes, across = torch.from_numpy(features.axes), torch.from_numpy(features.across)
    truth = (torch.from_numpy(example[name]) for name in ("closing", "across", "free"))
    return free_share(ring_directions(axes, across), *truth)
