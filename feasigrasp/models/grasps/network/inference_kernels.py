"""Compiled loops of the grasp network; arrays have channels first, contacts last.

Matrix products go to BLAS, on tiles of contacts; everything between them is fused here.
"""

from collections import namedtuple
from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Floats
from feasigrasp.models.compiled import compiled
from feasigrasp.models.grasps.network.contact_features import LENGTH_SCALE
from feasigrasp.models.grasps.network.surroundings import ROOM
from feasigrasp.models.numerics.fast_math import wide_vectors

#: Widths that a grasp may have, and the narrowest one [m]. Source: layout: output of the network.
WIDTHS, NARROWEST = 2, 1e-3
#: Contacts that go through the network together; with a power of two, rows of the matrices would
#: crowd into the same sets of the cache, and products take twice as long. Source: numerical.
_TILE = 52
#: Squared lengths up to this are zero, as in `feasigrasp_lab.networks`. Source: numerical.
_NOTHING = 1.2e-38


#: Weights of the layers in the order of their use; some that see the same input are stacked.
FusedWeights = namedtuple(
    "FusedWeights",
    "encode survey survey_bias context context_bias refine tilt_beside first first_bias second "
    "second_bias ring_gates ring_gates_bias ring_room ring_hidden ring_hidden_bias ring_free "
    "ring_free_bias judge judge_bias last last_bias",
)


class EncodedCloud(NamedTuple):
    """Contacts as the second stage of the network takes them.

    Attributes:
        encoded: Vectors (3, C, n).
        shift: What their mean adds to the refined ones (3, C + 1).
        numbers: Invariants of the features.
        room: Room for the hand.
        frames: Axis, reference direction and their cross product (3, 3, n).
        turns: Cosines and sines of the ring (2, K).
        context: What the pooled survey adds to the second layer.
    """

    encoded: Floats
    shift: Floats
    numbers: Floats
    room: Floats
    frames: Floats
    turns: Floats
    context: Floats


class ContactOutputs(NamedTuple):
    """Outputs per contact.

    Attributes:
        head: Logit, then `WIDTHS` corrections of the width, spreads and weights.
        tilt: Of the closing direction (3, n).
        free: Logits of free approaches (K, n).
    """

    head: Floats
    tilt: Floats
    free: Floats


@compiled(forceinline=True, fastmath=True)
def _relu(x, bias, zero):
    """Adds a bias to every channel (C, m) and cuts at zero."""
    wide_vectors()
    for c in range(len(x)):
        b, row = bias[c], x[c]
        for i in range(len(row)):
            row[i] = max(row[i] + b, zero)


@compiled(forceinline=True, fastmath=True)
def _half_space(p0, p1, p2, d0, d1, d2, zero, nothing):
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


@compiled(forceinline=True, fastmath=True)
def _dot_rows(x0, x1, x2, y0, y1, y2, out):
    wide_vectors()
    for i in range(len(x0)):
        out[i] = x0[i] * y0[i] + x1[i] * y1[i] + x2[i] * y2[i]


@compiled(forceinline=True, fastmath=True)
def _length_rows(x0, x1, x2, nothing, out):
    wide_vectors()
    for i in range(len(x0)):
        out[i] = np.sqrt(max(x0[i] * x0[i] + x1[i] * x1[i] + x2[i] * x2[i], nothing))


@compiled
def cloud_kernel(vectors, numbers, w):
    """Encoded vectors (3, C, n), their means (3, C), and the pooled survey of the cloud."""
    wide_vectors()
    channels, n, zero = len(w.encode) - 1, numbers.shape[1], numbers.dtype.type(0.0)
    nothing, share = numbers.dtype.type(_NOTHING), numbers.dtype.type(1.0 / n)
    encoded = np.empty((3, channels + 1, n), dtype=vectors.dtype)
    for axis in range(3):
        np.dot(w.encode, vectors[axis], encoded[axis])
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
    surveyed = np.dot(w.survey, seen)
    _relu(surveyed, w.survey_bias, zero)
    outputs = len(surveyed)
    pooled = np.empty(2 * outputs, dtype=vectors.dtype)
    for c in range(outputs):
        pooled[c], pooled[outputs + c] = _mean(surveyed[c], share), surveyed[c].max()
    return encoded[:, :channels], mean, pooled


@compiled(forceinline=True, fastmath=True)
def _room_inputs(room, start, ringed):
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


@compiled(forceinline=True, fastmath=True)
def _side_inputs(vectors, frame, turns, uv, ringed):
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


@compiled(forceinline=True, fastmath=True)
def _add_relu(x, y, zero):
    """Adds y (C, t) to every direction of x (C, K, t) and cuts at zero."""
    wide_vectors()
    for c in range(x.shape[0]):
        for k in range(x.shape[1]):
            for i in range(x.shape[2]):
                x[c, k, i] = max(x[c, k, i] + y[c, i], zero)


@compiled(forceinline=True, fastmath=True)
def _greatest(x, bias, zero, out):
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


@compiled(forceinline=True, fastmath=True)
def _mean(row, share):
    wide_vectors()
    total = share - share
    for i in range(len(row)):
        total += row[i]
    return total * share


@compiled(forceinline=True, fastmath=True)
def _add_product(x, y, out):
    wide_vectors()
    for i in range(len(x)):
        out[i] += x[i] * y[i]


@compiled
def contacts_kernel(cloud, w, tilts, outputs):
    """Writes the `ContactOutputs` of an `EncodedCloud`; ``tilts`` vectors may tilt the axis."""
    encoded, shift, numbers, room, frames, turns, context = cloud
    head_outputs, tilt, free = outputs
    wide_vectors()
    kind = encoded.dtype
    n, channels, K = numbers.shape[1], encoded.shape[1], len(free)
    nothing, zero = numbers.dtype.type(_NOTHING), numbers.dtype.type(0.0)
    lowest = numbers.dtype.type(-3e38)
    uv = np.empty((2, _TILE), dtype=kind)
    ring, hidden = len(w.ring_hidden), len(w.second)
    for start in range(0, n, _TILE):
        t = min(_TILE, n - start)
        tile = slice(start, start + t)
        vectors = np.empty((3, channels + 1, t), dtype=kind)
        part = np.empty((channels, t), dtype=kind)
        for axis in range(3):
            part[:] = encoded[axis, :, tile]
            np.dot(w.refine, part, vectors[axis])
            for c in range(channels + 1):
                vectors[axis, c] += shift[axis, c]
        inputs = np.empty((len(numbers) + 2 * channels, t), dtype=kind)
        inputs[: len(numbers)] = numbers[:, tile]
        frame = frames[:, :, tile].copy()
        d = vectors[:, channels]
        mixed = np.empty((3, len(w.tilt_beside), t), dtype=kind)
        for c in range(channels):
            x, y, z = vectors[0, c], vectors[1, c], vectors[2, c]
            _half_space(x, y, z, d[0], d[1], d[2], zero, nothing)
            row = len(numbers) + c
            _dot_rows(x, y, z, frame[0, 0], frame[0, 1], frame[0, 2], inputs[row])
            _length_rows(x, y, z, nothing, inputs[row + channels])
        for axis in range(3):
            np.dot(w.tilt_beside, vectors[axis, :channels], mixed[axis])
        h = np.dot(w.first, inputs)
        _relu(h, w.first_bias, zero)
        h = np.dot(w.second, h)
        _relu(h, context, zero)
        to_ring = np.dot(w.ring_gates, h)
        for c in range(len(w.ring_gates)):
            to_ring[c] += w.ring_gates_bias[c]

        ringed = np.empty((w.ring_room.shape[1], K, t), dtype=kind)
        _room_inputs(room, start, ringed)
        _side_inputs(mixed[:, tilts:], frame, turns, uv, ringed[3 * ROOM :])
        r = np.dot(w.ring_room, ringed.reshape(len(ringed), K * t))
        _add_relu(r.reshape(ring, K, t), to_ring, zero)
        r = np.dot(w.ring_hidden, r)
        judged = np.empty((hidden + ring + 1, t), dtype=kind)
        judged[:hidden] = h
        _greatest(r.reshape(ring, K, t), w.ring_hidden_bias, zero, judged[hidden:])
        _relu(r, w.ring_hidden_bias, zero)
        logits = np.dot(w.ring_free, r).reshape(1, K, t)
        _greatest(logits, w.ring_free_bias, lowest, judged[hidden + ring :])
        for k in range(K):
            free[k, tile] = logits[0, k] + w.ring_free_bias[0]
        h = np.dot(w.judge, judged)
        _relu(h, w.judge_bias, zero)
        h = np.dot(w.last, h)
        for c in range(len(head_outputs)):
            head_outputs[c, tile] = h[c] + w.last_bias[c]
        for axis in range(3):
            total = np.zeros(t, dtype=kind)
            for f in range(tilts):
                _add_product(mixed[axis, f], to_ring[ring + f], total)
            tilt[axis, tile] = total


@compiled(nogil=True)
def grasps_kernel(chords, frames, turns, outputs, grasps):
    """Writes grasps, in float64 so that unit vectors are unit; spreads before their softplus."""
    head_outputs, tilt, free = outputs
    closing, width, spread, approach, score = grasps
    ring, modes = len(free), score.shape[1]
    logits = np.empty(ring)
    for i in range(len(width)):
        likely = int(np.argmax(head_outputs[1 + 2 * WIDTHS :, i]))
        correction = LENGTH_SCALE * np.float64(head_outputs[1 + likely, i])
        width[i] = max(chords[i] + correction, NARROWEST)
        spread[i] = head_outputs[1 + WIDTHS + likely, i]
        axis = frames[0, :, i].astype(np.float64)
        b = _unit(axis[0] + tilt[0, i], axis[1] + tilt[1, i], axis[2] + tilt[2, i])
        closing[i, 0], closing[i, 1], closing[i, 2] = b
        for k in range(ring):
            logits[k] = free[k, i]
        for mode in range(modes):
            best = int(np.argmax(logits))
            score[i, mode] = logits[best]
            logits[best - 1] = logits[best] = logits[(best + 1) % ring] = -np.inf
            x = _along(turns, best, frames[1, 0, i], frames[2, 0, i])
            y = _along(turns, best, frames[1, 1, i], frames[2, 1, i])
            z = _along(turns, best, frames[1, 2, i], frames[2, 2, i])
            dot = x * b[0] + y * b[1] + z * b[2]
            x, y, z = _unit(x - dot * b[0], y - dot * b[1], z - dot * b[2])
            approach[i, mode, 0], approach[i, mode, 1], approach[i, mode, 2] = x, y, z


@compiled
def _along(turns, k, u, v):
    """A coordinate of direction k of the ring, from those of its axes."""
    return turns[0, k] * np.float64(u) + turns[1, k] * np.float64(v)


@compiled
def _unit(x, y, z):
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length
