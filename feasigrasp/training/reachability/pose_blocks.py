"""Millions of poses in blocks of neighbours, and the pass of EM over such blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.mixtures.float32_kernels import (
    BLOCK,
    FASTMATH,
    Float32Array,
    exponentials_kernel,
    log2_density_kernel,
    tangents_kernel,
)
from feasigrasp.models.numerics.simd import wide_vectors

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@dataclass(frozen=True, eq=False)
class PoseBlocks:
    """Poses sorted so that neighbours share a block: there, few components are responsible.

    Attributes:
        blocks: Quaternions wxyz and positions [m], shape (m, 7, 256), single precision. What is
            left of the last block repeats the last pose.
        n: Number of poses.
    """

    blocks: Float32Array
    n: int

    @classmethod
    def of(cls, quaternions: ArrayLike, positions: ArrayLike) -> PoseBlocks:
        """Sorts and packs poses.

        Args:
            quaternions: Unit quaternions wxyz, shape (n, 4), n >= 1.
            positions: Positions, shape (n, 3) [m].
        """
        q, p = np.asarray(quaternions, np.float32), np.asarray(positions, np.float32)
        n = len(q)
        low, high = p.min(axis=0), p.max(axis=0)
        keys = np.empty(n, np.uint16)
        _keys(q, p, low, np.float32(3.999) / np.maximum(high - low, np.float32(1e-9)), keys)
        order = np.argsort(keys, kind="stable")  # a radix sort, for 16 bits
        blocks = np.empty((-(-n // BLOCK), 7, BLOCK), np.float32)
        _gather(q, p, order, blocks)
        blocks.flags.writeable = False
        return cls(blocks, n)

    def draw(self, rng: np.random.Generator, n: int) -> tuple[Array, Array]:
        """At most ``n`` different poses: quaternions (4, k) and positions (3, k) [m]."""
        chosen = rng.choice(self.n, min(n, self.n), replace=False)
        poses = self.blocks[chosen // BLOCK, :, chosen % BLOCK].astype(float).T
        return np.ascontiguousarray(poses[:4]), np.ascontiguousarray(poses[4:])

    def subset(self, rng: np.random.Generator, n: int) -> PoseBlocks:
        """At most ``n`` different poses, in blocks of their own."""
        q, p = self.draw(rng, n)
        return PoseBlocks.of(q.T, p.T)


@njit(cache=True, error_model="numpy")
def _keys(q, p, low, scale, out):
    """Cells of the poses: face of the quaternion cube, then 4 cells per dimension, interleaved."""
    cells = np.empty(6, np.int64)
    for j in range(len(q)):
        face = 0
        for i in range(4):
            if abs(q[j, i]) > abs(q[j, face]):
                face = i
        for i in range(3):
            # Of the opposite quaternions q and -q, both have the same ratios.
            ratio = q[j, (face + 1 + i) % 4] / q[j, face]
            cells[i] = min(3, int(4.0 * (0.5 + 2.0 / math.pi * math.atan(ratio))))
            cells[3 + i] = int((p[j, i] - low[i]) * scale[i])
        key = face
        for bit in (1, 0):
            for i in range(6):
                key = key << 1 | (cells[i] >> bit & 1)
        out[j] = key


@njit(cache=True)
def _gather(q, p, order, blocks):
    for b in range(len(blocks)):
        for j in range(BLOCK):
            source = order[min(b * BLOCK + j, len(order) - 1)]
            for i in range(4):
                blocks[b, i, j] = q[source, i]
            for i in range(3):
                blocks[b, 4 + i, j] = p[source, i]


@njit(cache=True, error_model="numpy", fastmath=FASTMATH, nogil=True)
def _add_moments(r, v, scaled, first, second):
    """Adds sum r v and the lower triangle of sum r v v^T of a block; returns sum r.

    ``scaled`` (BLOCK,) is scratch.
    """
    wide_vectors()
    mass = _ZERO
    for j in range(BLOCK):
        mass += r[j]
    for a in range(6):
        row, total = v[a], _ZERO
        for j in range(BLOCK):
            scaled[j] = r[j] * row[j]
            total += scaled[j]
        first[a] += total
        for b in range(a + 1):
            other, total = v[b], _ZERO
            for j in range(BLOCK):
                total += scaled[j] * other[j]
            second[a, b] += total
    return mass


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"}, nogil=True)
def _normalise(log2, active, largest, total, valid):
    """Turns the ratios of the active components into responsibilities; log likelihood.

    Poses from ``valid`` on only fill up the block: their responsibilities become zero.
    """
    likelihood = 0.0
    for j in range(valid):
        likelihood += largest[j] + math.log2(total[j])
    for j in range(BLOCK):
        total[j] = _ONE / total[j] if j < valid else _ZERO
    for k in range(len(log2)):
        if active[k]:
            row = log2[k]
            for j in range(BLOCK):
                row[j] *= total[j]
    return likelihood * math.log(2.0)


@njit(cache=True, nogil=True)
def moments_of_blocks(blocks, start, stop, n, packed, mass, first, second):
    """Adds the moments of the poses in ``blocks[start:stop]``; returns their log likelihood.

    Args:
        blocks: See `PoseBlocks`.
        start: First block.
        stop: Behind the last block.
        n: Number of poses in all blocks.
        packed: The mixture, see `feasigrasp.models.mixtures.float32_kernels.pack`.
        mass: Sum of the responsibilities, shape (K,), added to.
        first: Sum of r v, shape (K, 6), added to.
        second: Lower triangle of the sum of r v v^T, shape (K, 6, 6), added to.
    """
    K, likelihood = len(packed), 0.0
    v, log2 = np.empty((K, 6, BLOCK), np.float32), np.empty((K, BLOCK), np.float32)
    largest, total = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    active, block = np.empty(K, np.bool_), np.empty((7, BLOCK), np.float32)
    for i in range(start, stop):
        block[:] = blocks[i]  # aligned here, and in the first-level cache
        largest[:] = -np.inf
        total[:] = _ZERO
        for k in range(K):
            tangents_kernel(block, packed[k], v[k])
            log2_density_kernel(v[k], packed[k], largest, log2[k])
        for k in range(K):
            active[k] = exponentials_kernel(log2[k], largest, total)
        likelihood += _normalise(log2, active, largest, total, min(BLOCK, n - i * BLOCK))
        for k in range(K):
            if active[k]:
                mass[k] += _add_moments(log2[k], v[k], total, first[k], second[k])
    return likelihood
