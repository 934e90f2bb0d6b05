"""Blocks of neighboring poses, and the EM pass over such blocks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import wide_vectors
from feasigrasp_lab.paper.float32_kernels import (
    BLOCK,
    FASTMATH,
    Float32Array,
    exponentials_kernel,
    log2_density_kernel,
    tangents_kernel,
)

#: Numbers of single precision. Source: layout.
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


@compiled
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


@compiled
def _gather(q, p, order, blocks):
    for b in range(len(blocks)):
        for j in range(BLOCK):
            source = order[min(b * BLOCK + j, len(order) - 1)]
            for i in range(4):
                blocks[b, i, j] = q[source, i]
            for i in range(3):
                blocks[b, 4 + i, j] = p[source, i]


@compiled(forceinline=True, fastmath=FASTMATH)
def _add_moments(r, v, first, second):
    """Adds sum r v and the lower triangle of sum r v v^T of a block; returns sum r.

    Three loops, each with few enough sums to stay in registers: a pass takes a quarter less time
    than with one loop a sum.
    """
    wide_vectors()
    v0, v1, v2, v3, v4, v5 = v[0], v[1], v[2], v[3], v[4], v[5]
    mass, f0, f1, f2 = _ZERO, _ZERO, _ZERO, _ZERO
    s00, s10, s11, s20, s21, s22 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for j in range(BLOCK):
        a, b, c = v0[j], v1[j], v2[j]
        ra, rb, rc = r[j] * a, r[j] * b, r[j] * c
        mass, f0, f1, f2 = mass + r[j], f0 + ra, f1 + rb, f2 + rc
        s00, s10, s11 = s00 + ra * a, s10 + rb * a, s11 + rb * b
        s20, s21, s22 = s20 + rc * a, s21 + rc * b, s22 + rc * c
    first[0] += f0
    first[1] += f1
    first[2] += f2
    second[0, 0] += s00
    second[1, 0] += s10
    second[1, 1] += s11
    second[2, 0] += s20
    second[2, 1] += s21
    second[2, 2] += s22
    s30, s31, s32, s40, s41, s42 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    s50, s51, s52 = _ZERO, _ZERO, _ZERO
    for j in range(BLOCK):
        a, b, c = v0[j], v1[j], v2[j]
        ra, rb, rc = r[j] * v3[j], r[j] * v4[j], r[j] * v5[j]
        s30, s31, s32 = s30 + ra * a, s31 + ra * b, s32 + ra * c
        s40, s41, s42 = s40 + rb * a, s41 + rb * b, s42 + rb * c
        s50, s51, s52 = s50 + rc * a, s51 + rc * b, s52 + rc * c
    second[3, 0] += s30
    second[3, 1] += s31
    second[3, 2] += s32
    second[4, 0] += s40
    second[4, 1] += s41
    second[4, 2] += s42
    second[5, 0] += s50
    second[5, 1] += s51
    second[5, 2] += s52
    f0, f1, f2 = _ZERO, _ZERO, _ZERO
    s00, s10, s11, s20, s21, s22 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for j in range(BLOCK):
        a, b, c = v3[j], v4[j], v5[j]
        ra, rb, rc = r[j] * a, r[j] * b, r[j] * c
        f0, f1, f2 = f0 + ra, f1 + rb, f2 + rc
        s00, s10, s11 = s00 + ra * a, s10 + rb * a, s11 + rb * b
        s20, s21, s22 = s20 + rc * a, s21 + rc * b, s22 + rc * c
    first[3] += f0
    first[4] += f1
    first[5] += f2
    second[3, 3] += s00
    second[4, 3] += s10
    second[4, 4] += s11
    second[5, 3] += s20
    second[5, 4] += s21
    second[5, 5] += s22
    return mass


@compiled(forceinline=True, fastmath={"contract", "nsz", "arcp"})
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


@compiled(nogil=True)
def moments_of_blocks(blocks, start, stop, n, packed, mass, first, second):
    """Adds the moments of the poses in ``blocks[start:stop]``; returns their log likelihood.

    Args:
        blocks: See `PoseBlocks`.
        start: First block.
        stop: Behind the last block.
        n: Number of poses in all blocks.
        packed: The mixture, see `feasigrasp_lab.paper.float32_kernels.pack`.
        mass: Sum of the responsibilities, shape (K,), added to.
        first: Sum of r v, shape (K, 6), added to.
        second: Lower triangle of the sum of r v v^T, shape (K, 6, 6), added to.
    """
    wide_vectors()
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
                mass[k] += _add_moments(log2[k], v[k], first[k], second[k])
    return likelihood
