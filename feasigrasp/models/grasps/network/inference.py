"""The default grasp network without torch, several times quicker: what runs at perception's rate.

The same function as `feasigrasp.models.grasps.network.architectures.ContactNetwork`, whose weights
it takes. Eager torch writes every intermediate result of the whole cloud to memory and reads it
back; here contacts go through the network in tiles that stay in the cache. Arrays have channels
first and contacts last, so that every loop runs over contiguous contacts. Computes in the precision
of its weights, on one thread.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from feasigrasp.models.grasps.network.architectures import LEAST_SPREAD, SPREAD, WIDTHS
from feasigrasp.models.grasps.network.contact_features import ContactFeatures
from feasigrasp.models.grasps.network.inference_kernels import (
    cloud_kernel,
    contacts_kernel,
    grasps_kernel,
)

Array = NDArray[np.floating]
Float64 = NDArray[np.float64]


class FusedContactNetwork:
    """A trained `ContactNetwork`, frozen.

    Args:
        weights: Its parameters by the names that torch gives them, all float32 or all float64.
    """

    def __init__(self, weights: Mapping[str, Array]) -> None:
        w = {name: np.ascontiguousarray(array) for name, array in weights.items()}
        self.kind = w["encode.mix.weight"].dtype
        vectors = w["encode.mix.weight"].shape[0] - 1
        refine = w["refine.mix.weight"]
        self.cloud = (w["encode.mix.weight"], w["survey.weight"], w["survey.bias"])
        self.context = (w["context.weight"], w["context.bias"])
        self.of_mean = np.ascontiguousarray(refine[:, vectors:])
        self.contact = (
            np.ascontiguousarray(refine[:, :vectors]),
            np.concatenate([w["tilt.weight"], w["beside.weight"]]),
            w["first.weight"],
            w["first.bias"],
            w["second.weight"],
            np.concatenate([w["to_ring.weight"], w["gates.weight"]]),
            np.concatenate([w["to_ring.bias"], w["gates.bias"]]),
            w["ring_room.weight"],
            w["ring_hidden.weight"],
            w["ring_hidden.bias"],
            w["ring_free.weight"],
            w["ring_free.bias"],
            w["judge.weight"],
            w["judge.bias"],
            w["last.weight"],
            w["last.bias"],
        )
        self.tilts = len(w["tilt.weight"])
        self.second_bias = w["second.bias"]

    def __call__(self, x: ContactFeatures, modes: int) -> tuple[Float64, ...]:
        """What the network says of n contacts.

        Args:
            x: Their features.
            modes: Approaches per contact that are kept, M; at most a third of all.

        Returns:
            In float64: the probability of the contact (n,); closing directions (n, 3); likeliest
            widths and the scales of their Laplace distributions (n,) [m]; approaches (n, M, 3),
            best first, none beside a better one on the ring, and the probabilities that they are
            free (n, M).
        """
        n, kind = len(x.chords), self.kind
        frames = np.empty((3, 3, n), dtype=kind)
        frames[0], frames[1] = x.axes.T, x.across.T
        frames[2] = np.cross(x.axes, x.across).T
        directions = x.room.shape[1]
        angle = 2.0 * np.pi * np.arange(directions) / directions
        turns = np.stack([np.cos(angle), np.sin(angle)]).astype(kind)
        said = np.empty((1 + 3 * WIDTHS, n), dtype=kind)
        tilt = np.empty((3, n), dtype=kind)
        free = np.empty((directions, n), dtype=kind)
        with _threads().limit(limits=1, user_api="blas"):
            encoded, mean, pooled = cloud_kernel(x.vectors, x.numbers, *self.cloud, kind.type(0.0))
            weight, bias = self.context
            context = weight @ pooled + bias + self.second_bias
            contacts_kernel(
                encoded,
                mean @ self.of_mean.T,
                x.numbers,
                x.room,
                frames,
                turns,
                context,
                self.contact,
                self.tilts,
                kind.type(0.0),
                said,
                tilt,
                free,
            )
        closing, width, spread = np.empty((n, 3)), np.empty(n), np.empty(n)
        approach, score = np.empty((n, modes, 3)), np.empty((n, modes))
        grasps = (closing, width, spread, approach, score)
        grasps_kernel(x.chords, frames, turns, said, tilt, free, *grasps)
        contact, score = (1.0 / (1.0 + np.exp(-logit)) for logit in (said[0].astype(float), score))
        spread = LEAST_SPREAD + SPREAD * np.logaddexp(0.0, spread)
        return contact, closing, width, spread, approach, score


@lru_cache(maxsize=1)
def _threads() -> ThreadpoolController:
    return ThreadpoolController()
