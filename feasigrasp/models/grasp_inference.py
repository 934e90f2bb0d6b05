"""The default grasp network without torch, several times quicker: what runs at perception's rate.

The same function as `feasigrasp.models.grasp_architectures.ContactNetwork`, whose weights it takes.
Eager torch writes every intermediate result of the whole cloud to memory and reads it back; here
contacts go through the network in tiles that stay in the cache. Arrays have channels first and
contacts last, so that every loop runs over contiguous contacts. Computes in the precision of its
weights, on one thread.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from feasigrasp.models.contact_features import LENGTH_SCALE, ContactFeatures
from feasigrasp.models.contact_surroundings import ROOM
from feasigrasp.models.grasp_architectures import LEAST_SPREAD, NARROWEST, SPREAD
from feasigrasp.models.vector_math import wide_vectors

Array = NDArray[np.floating]

#: Contacts that go through the network together; with a power of two, rows of the matrices would
#: crowd into the same sets of the cache, and products take twice as long.
_TILE = 52
#: Squared lengths up to this are zero, as in `feasigrasp.models.vector_neurons`.
_NOTHING = 1.2e-38


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

    def __call__(self, x: ContactFeatures, modes: int) -> tuple[Array, ...]:
        """What the network says of n contacts.

        Args:
            x: Their features.
            modes: Approaches per contact that are kept, M; at most a third of all.

        Returns:
            In float64: the probability of the contact (n,); closing directions (n, 3); widths and
            the scales of their Laplace distributions (n,) [m]; approaches (n, M, 3), best first,
            none beside a better one on the ring, and the probabilities that they are free (n, M).
        """
        n, kind = len(x.chords), self.kind
        frames = np.empty((3, 3, n), dtype=kind)
        frames[0], frames[1] = x.axes.T, x.across.T
        frames[2] = np.cross(x.axes, x.across).T
        directions = x.room.shape[1]
        angle = 2.0 * np.pi * np.arange(directions) / directions
        turns = np.stack([np.cos(angle), np.sin(angle)]).astype(kind)
        said, tilt = np.empty((3, n), dtype=kind), np.empty((3, n), dtype=kind)
        free = np.empty((directions, n), dtype=kind)
        with _threads().limit(limits=1, user_api="blas"):
            encoded, mean, pooled = _cloud(x.vectors, x.numbers, *self.cloud, kind.type(0.0))
            weight, bias = self.context
            context = weight @ pooled + bias + self.second_bias
            _contacts(
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
        closing, width = np.empty((n, 3)), np.empty(n)
        approach, score = np.empty((n, modes, 3)), np.empty((n, modes))
        _grasps(x.chords, frames, turns, said, tilt, free, closing, width, approach, score)
        contact, score = (1.0 / (1.0 + np.exp(-logit)) for logit in (said[0].astype(float), score))
        spread = LEAST_SPREAD + SPREAD * np.logaddexp(0.0, said[2].astype(float))
        return contact, closing, width, spread, approach, score


@lru_cache(maxsize=1)
def _threads() -> ThreadpoolController:
    return ThreadpoolController()


@njit(cache=True, fastmath=True, error_model="numpy")
def _relu(x, bias, zero):  # type: ignore[no-untyped-def]
    """Adds a bias to every channel (C, m) and cuts at zero."""
    wide_vectors()
    for c in range(len(x)):
        b, row = bias[c], x[c]
        for i in range(len(row)):
            row[i] = max(row[i] + b, zero)


@njit(cache=True, fastmath=True, error_model="numpy")
def _half_space(p0, p1, p2, d0, d1, d2, zero, nothing):  # type: ignore[no-untyped-def]
    """Takes from vectors p, in place, what points against directions d."""
    wide_vectors()
    for i in range(len(p0)):
        a, b, c = d0[i], d1[i], d2[i]
        square = a * a + b * b + c * c
        dot = min(p0[i] * a + p1[i] * b + p2[i] * c, zero)
        t = dot / max(square, nothing)
        p0[i] -= t * a
        p1[i] -= t * b
        p2[i] -= t * c


@njit(cache=True, fastmath=True, error_model="numpy")
def _dot_rows(x0, x1, x2, y0, y1, y2, out):  # type: ignore[no-untyped-def]
    wide_vectors()
    for i in range(len(x0)):
        out[i] = x0[i] * y0[i] + x1[i] * y1[i] + x2[i] * y2[i]


@njit(cache=True, fastmath=True, error_model="numpy")
def _length_rows(x0, x1, x2, nothing, out):  # type: ignore[no-untyped-def]
    wide_vectors()
    for i in range(len(x0)):
        out[i] = np.sqrt(max(x0[i] * x0[i] + x1[i] * x1[i] + x2[i] * x2[i], nothing))


@njit(cache=True, error_model="numpy")
def _cloud(vectors, numbers, encode, survey, survey_bias, zero):  # type: ignore[no-untyped-def]
    """Encoded vectors (3, C, n), their means (3, C), and the pooled survey of the cloud."""
    channels, n = len(encode) - 1, numbers.shape[1]
    nothing, share = numbers.dtype.type(_NOTHING), numbers.dtype.type(1.0 / n)
    encoded = np.empty((3, channels + 1, n), dtype=vectors.dtype)
    for axis in range(3):
        np.dot(encode, vectors[axis], encoded[axis])
    seen = np.empty((len(numbers) + channels, n), dtype=vectors.dtype)
    seen[: len(numbers)] = numbers
    mean = np.empty((3, channels), dtype=vectors.dtype)
    d = encoded[:, channels]
    for c in range(channels):
        x, y, z = encoded[0, c], encoded[1, c], encoded[2, c]
        _half_space(x, y, z, d[0], d[1], d[2], zero, nothing)
        _length_rows(x, y, z, nothing, seen[len(numbers) + c])
        for axis in range(3):
            mean[axis, c] = _mean(encoded[axis, c], share)
    surveyed = np.dot(survey, seen)
    _relu(surveyed, survey_bias, zero)
    outputs = len(surveyed)
    pooled = np.empty(2 * outputs, dtype=vectors.dtype)
    for c in range(outputs):
        pooled[c], pooled[outputs + c] = _mean_and_greatest(surveyed[c], share)
    return encoded[:, :channels], mean, pooled


@njit(cache=True, fastmath=True, error_model="numpy")
def _room_inputs(room, start, ringed):  # type: ignore[no-untyped-def]
    """Writes the room of every direction, and the less and the greater of its neighbours'."""
    wide_vectors()
    features, K, _ = room.shape
    for f in range(features):
        for k in range(K):
            before, after = (k + K - 1) % K, (k + 1) % K
            for i in range(ringed.shape[2]):
                a, b = room[f, before, start + i], room[f, after, start + i]
                ringed[f, k, i] = room[f, k, start + i]
                ringed[features + f, k, i] = min(a, b)
                ringed[2 * features + f, k, i] = max(a, b)


@njit(cache=True, fastmath=True, error_model="numpy")
def _side_inputs(vectors, frame, turns, uv, ringed):  # type: ignore[no-untyped-def]
    """Writes the components of vectors (3, C, t) along and beside every direction (2 C, K, t)."""
    wide_vectors()
    sides, K = vectors.shape[1], ringed.shape[1]
    for f in range(sides):
        for d in range(2):
            for i in range(ringed.shape[2]):
                uv[d, i] = (
                    vectors[0, f, i] * frame[1 + d, 0, i]
                    + vectors[1, f, i] * frame[1 + d, 1, i]
                    + vectors[2, f, i] * frame[1 + d, 2, i]
                )
        for k in range(K):
            cos, sin = turns[0, k], turns[1, k]
            for i in range(ringed.shape[2]):
                ringed[f, k, i] = cos * uv[0, i] + sin * uv[1, i]
                ringed[sides + f, k, i] = abs(sin * uv[0, i] - cos * uv[1, i])


@njit(cache=True, fastmath=True, error_model="numpy")
def _add_relu(x, y, zero):  # type: ignore[no-untyped-def]
    """Adds y (C, t) to every direction of x (C, K, t) and cuts at zero."""
    wide_vectors()
    for c in range(x.shape[0]):
        for k in range(x.shape[1]):
            for i in range(x.shape[2]):
                x[c, k, i] = max(x[c, k, i] + y[c, i], zero)


@njit(cache=True, fastmath=True, error_model="numpy")
def _greatest(x, bias, zero, out):  # type: ignore[no-untyped-def]
    """Greatest over the directions of (C, K, t), with a bias, cut at zero."""
    wide_vectors()
    for c in range(x.shape[0]):
        for i in range(x.shape[2]):
            out[c, i] = x[c, 0, i]
        for k in range(1, x.shape[1]):
            for i in range(x.shape[2]):
                out[c, i] = max(out[c, i], x[c, k, i])
        for i in range(x.shape[2]):
            out[c, i] = max(out[c, i] + bias[c], zero)


@njit(cache=True, fastmath=True, error_model="numpy")
def _mean_and_greatest(row, share):  # type: ignore[no-untyped-def]
    """The mean of a row, and its greatest entry by folding, which overwrites it."""
    wide_vectors()
    total = share - share
    for i in range(len(row)):
        total += row[i]
    size = len(row)
    while size > 1:
        half = (size + 1) // 2
        for i in range(size - half):
            row[i] = max(row[i], row[half + i])
        size = half
    return total * share, row[0]


@njit(cache=True, fastmath=True, error_model="numpy")
def _mean(row, share):  # type: ignore[no-untyped-def]
    wide_vectors()
    total = share - share
    for i in range(len(row)):
        total += row[i]
    return total * share


@njit(cache=True, fastmath=True, error_model="numpy")
def _add_product(x, y, out):  # type: ignore[no-untyped-def]
    wide_vectors()
    for i in range(len(x)):
        out[i] += x[i] * y[i]


@njit(cache=True, error_model="numpy")
def _contacts(  # type: ignore[no-untyped-def]
    encoded, shift, numbers, room, frames, turns, context, weights, tilts, zero, said, tilt, free
):
    (
        refine, linear, first, first_bias, second, gate, gate_bias, ring_room, ring_hidden,
        ring_hidden_bias, ring_free, ring_free_bias, judge, judge_bias, last, last_bias,
    ) = weights  # fmt: skip
    kind = encoded.dtype
    n, channels, K = numbers.shape[1], encoded.shape[1], len(free)
    nothing, lowest = numbers.dtype.type(_NOTHING), numbers.dtype.type(-3e38)
    uv = np.empty((2, _TILE), dtype=kind)
    ring, hidden = len(ring_hidden), len(second)
    for start in range(0, n, _TILE):
        t = min(_TILE, n - start)
        tile = slice(start, start + t)
        vectors = np.empty((3, channels + 1, t), dtype=kind)
        part = np.empty((channels, t), dtype=kind)
        for axis in range(3):
            part[:] = encoded[axis, :, tile]
            np.dot(refine, part, vectors[axis])
            for c in range(channels + 1):
                vectors[axis, c] += shift[axis, c]
        inputs = np.empty((len(numbers) + 2 * channels, t), dtype=kind)
        inputs[: len(numbers)] = numbers[:, tile]
        frame = frames[:, :, tile].copy()
        d = vectors[:, channels]
        mixed = np.empty((3, len(linear), t), dtype=kind)
        for c in range(channels):
            x, y, z = vectors[0, c], vectors[1, c], vectors[2, c]
            _half_space(x, y, z, d[0], d[1], d[2], zero, nothing)
            row = len(numbers) + c
            _dot_rows(x, y, z, frame[0, 0], frame[0, 1], frame[0, 2], inputs[row])
            _length_rows(x, y, z, nothing, inputs[row + channels])
        for axis in range(3):
            np.dot(linear, vectors[axis, :channels], mixed[axis])
        h = np.dot(first, inputs)
        _relu(h, first_bias, zero)
        h = np.dot(second, h)
        _relu(h, context, zero)
        to_ring = np.dot(gate, h)
        for c in range(len(gate)):
            to_ring[c] += gate_bias[c]

        ringed = np.empty((ring_room.shape[1], K, t), dtype=kind)
        _room_inputs(room, start, ringed)
        _side_inputs(mixed[:, tilts:], frame, turns, uv, ringed[3 * ROOM :])
        r = np.dot(ring_room, ringed.reshape(len(ringed), K * t))
        _add_relu(r.reshape(ring, K, t), to_ring, zero)
        r = np.dot(ring_hidden, r)
        judged = np.empty((hidden + ring + 1, t), dtype=kind)
        judged[:hidden] = h
        _greatest(r.reshape(ring, K, t), ring_hidden_bias, zero, judged[hidden:])
        _relu(r, ring_hidden_bias, zero)
        logits = np.dot(ring_free, r).reshape(1, K, t)
        _greatest(logits, ring_free_bias, lowest, judged[hidden + ring :])
        for k in range(K):
            free[k, tile] = logits[0, k] + ring_free_bias[0]
        h = np.dot(judge, judged)
        _relu(h, judge_bias, zero)
        h = np.dot(last, h)
        for c in range(3):
            said[c, tile] = h[c] + last_bias[c]
        for axis in range(3):
            total = np.zeros(t, dtype=kind)
            for f in range(tilts):
                _add_product(mixed[axis, f], to_ring[ring + f], total)
            tilt[axis, tile] = total



@njit(cache=True, nogil=True, error_model="numpy")
def _grasps(  # type: ignore[no-untyped-def]
    chords, frames, turns, said, tilt, free, closing, width, approach, score
):
    """Writes grasps, in float64 so that unit vectors are unit."""
    ring, modes = len(free), score.shape[1]
    b, a, logits = np.empty(3), np.empty(3), np.empty(ring)
    for i in range(len(width)):
        width[i] = max(chords[i] + LENGTH_SCALE * np.float64(said[1, i]), NARROWEST)
        for axis in range(3):
            b[axis] = np.float64(frames[0, axis, i]) + tilt[axis, i]
        b /= np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2)
        closing[i] = b
        for k in range(ring):
            logits[k] = free[k, i]
        for mode in range(modes):
            best = int(np.argmax(logits))
            score[i, mode] = logits[best]
            logits[best - 1] = logits[best] = logits[(best + 1) % ring] = -np.inf
            for axis in range(3):
                u, v = np.float64(frames[1, axis, i]), np.float64(frames[2, axis, i])
                a[axis] = turns[0, best] * u + turns[1, best] * v
            a -= (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) * b
            a /= np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
            approach[i, mode] = a
