"""Inference of the default grasp network in numba, without torch.

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
from threadpoolctl import ThreadpoolController

from feasigrasp.models.arrays import Array, Floats
from feasigrasp.models.grasps.network.contact_features import NUMBERS, VECTORS, ContactFeatures
from feasigrasp.models.grasps.network.inference_kernels import (
    WIDTHS,
    FusedWeights,
    cloud_kernel,
    contacts_kernel,
    grasps_kernel,
)
from feasigrasp.models.grasps.network.surroundings import ROOM

#: The spread of a width that training starts with, and the least one [m].
SPREAD, LEAST_SPREAD = 5e-3, 2e-4
#: Vectors that may tilt the closing direction, and that the ring sees.
TILTS, BESIDE = 8, 6


def array_shapes(
    vectors: int = 24, hidden: int = 128, ring: int = 32
) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the weights, as `ContactNetwork` in torch names them.

    Args:
        vectors: Channels of the vector neurons.
        hidden: Width of the invariant perceptron.
        ring: Width of the perceptron that approach directions share.
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


class FusedContactNetwork:
    """A trained `ContactNetwork`, frozen.

    Args:
        weights: Its parameters by the names that torch gives them, all float32 or all float64.
    """

    def __init__(self, weights: Mapping[str, Floats]) -> None:
        w = {name: np.ascontiguousarray(array) for name, array in weights.items()}
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
        self.weights = FusedWeights(**made)
        self.of_mean = np.ascontiguousarray(refine[:, vectors:])
        self.tilts = len(w["tilt.weight"])

    def __call__(self, x: ContactFeatures, modes: int) -> tuple[Array, ...]:
        """What the network says of n contacts.

        Args:
            x: Their features.
            modes: Approaches per contact that are kept, M; at most a third of all.

        Returns:
            In float64: the probability of the contact (n,); closing directions (n, 3); most
            probable widths and the scales of their Laplace distributions (n,) [m]; approaches (n,
            M, 3), best first, none beside a better one on the ring, and the probabilities that they
            are free (n, M).
        """
        n, w = len(x.chords), self.weights
        kind = w.encode.dtype
        frames = np.empty((3, 3, n), dtype=kind)
        frames[0], frames[1] = x.axes.T, x.across.T
        frames[2] = np.cross(x.axes, x.across).T
        directions = x.room.shape[1]
        angle = 2.0 * np.pi * np.arange(directions) / directions
        turns = np.stack([np.cos(angle), np.sin(angle)]).astype(kind)
        head_outputs = np.empty((1 + 3 * WIDTHS, n), dtype=kind)
        tilt = np.empty((3, n), dtype=kind)
        free = np.empty((directions, n), dtype=kind)
        with _threads().limit(limits=1, user_api="blas"):
            encoded, mean, pooled = cloud_kernel(x.vectors, x.numbers, w)
            context = w.context @ pooled + w.context_bias + w.second_bias
            contacts_kernel(
                encoded,
                mean @ self.of_mean.T,
                x.numbers,
                x.room,
                frames,
                turns,
                context,
                w,
                self.tilts,
                head_outputs,
                tilt,
                free,
            )
        closing, width, spread = np.empty((n, 3)), np.empty(n), np.empty(n)
        approach, score = np.empty((n, modes, 3)), np.empty((n, modes))
        grasps = (closing, width, spread, approach, score)
        grasps_kernel(x.chords, frames, turns, head_outputs, tilt, free, *grasps)
        contact, score = (
            1.0 / (1.0 + np.exp(-logit)) for logit in (head_outputs[0].astype(float), score)
        )
        spread = LEAST_SPREAD + SPREAD * np.logaddexp(0.0, spread)
        return contact, closing, width, spread, approach, score


@lru_cache(maxsize=1)
def _threads() -> ThreadpoolController:
    return ThreadpoolController()
