"""Expectation maximization on SE(3): the compiled part of ``fit_riemannian_mixture``.

One fused pass over poses and components yields all that an M step needs: per component the sums
of r, r v and r v v^T. Memory does not grow with n x K, so three million poses are no problem.
Poses come as structure of arrays (quaternions (4, n), positions (3, n)) and are worked on in
blocks, so that the compiler turns the inner loops into SIMD code.
"""

import math
from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import (
    compose_kernel,
    exp_kernel,
    quaternion_kernel,
    quaternion_log_kernel,
)
from feasigrasp.models.numerics.fast_math import fast_exp
from feasigrasp.models.numerics.small_cholesky import cholesky_kernel

#: Poses per block: the tangents of a block to 64 components (400 kB) stay in the L2 cache. With 32,
#: a seeded fit to 24 poses takes half as long (1.8 ms), but its sums are rounded in another way.
#: Source: measured.
BLOCK = 128


class Samples(NamedTuple):
    """Poses to fit to.

    Attributes:
        quaternions: Unit, wxyz, shape (4, n).
        positions: Shape (3, n) [m].
        weights: Weight of each pose, shape (n,); a component must collect 1 to survive.
    """

    quaternions: Array
    positions: Array
    weights: Array


class Stop(NamedTuple):
    """Termination criteria of EM.

    Attributes:
        max_iterations: Bound on the number of E steps.
        tolerance: Least gain of the log likelihood per unit of sample weight.
    """

    max_iterations: int
    tolerance: float


class _Estimate(NamedTuple):
    """The mixture of an E step; ``constants`` are log normalisers plus log weights, shape (K,)."""

    means: Array
    whitening: Array
    constants: Array


@compiled(forceinline=True, fastmath={"contract"})
def block_tangents(block: Array, mean: Array, out: Array) -> None:
    """Log(mean^-1 x) of a block of poses: block (7 BLOCK,) of q and p, out (6 BLOCK,)."""
    mw, mx, my, mz = quaternion_kernel(mean)
    r00, r01, r02, t0 = mean[0, 0], mean[0, 1], mean[0, 2], mean[0, 3]
    r10, r11, r12, t1 = mean[1, 0], mean[1, 1], mean[1, 2], mean[1, 3]
    r20, r21, r22, t2 = mean[2, 0], mean[2, 1], mean[2, 2], mean[2, 3]
    for i in range(BLOCK):
        q0, q1 = block[i], block[BLOCK + i]
        q2, q3 = block[2 * BLOCK + i], block[3 * BLOCK + i]
        w = mw * q0 + mx * q1 + my * q2 + mz * q3
        sign = 1.0 if w >= 0.0 else -1.0
        dx = block[4 * BLOCK + i] - t0
        dy = block[5 * BLOCK + i] - t1
        dz = block[6 * BLOCK + i] - t2
        v0, v1, v2, v3, v4, v5 = quaternion_log_kernel(
            sign * w,
            sign * (mw * q1 - mx * q0 - my * q3 + mz * q2),
            sign * (mw * q2 - my * q0 - mz * q1 + mx * q3),
            sign * (mw * q3 - mz * q0 - mx * q2 + my * q1),
            r00 * dx + r10 * dy + r20 * dz,
            r01 * dx + r11 * dy + r21 * dz,
            r02 * dx + r12 * dy + r22 * dz,
        )
        out[i], out[BLOCK + i], out[2 * BLOCK + i] = v0, v1, v2
        out[3 * BLOCK + i], out[4 * BLOCK + i], out[5 * BLOCK + i] = v3, v4, v5


@compiled(forceinline=True, fastmath={"contract"})
def block_log_density(v: Array, W: Array, constant: float, out: Array) -> None:
    """Fills in constant - |W v|^2 / 2 of a block of tangents (6 BLOCK,); W is lower triangular."""
    out[:] = constant
    for a in range(6):
        w0, w1, w2, w3, w4, w5 = W[a, 0], W[a, 1], W[a, 2], W[a, 3], W[a, 4], W[a, 5]
        for i in range(BLOCK):
            z = w0 * v[i] + w1 * v[BLOCK + i] + w2 * v[2 * BLOCK + i]
            z += w3 * v[3 * BLOCK + i] + w4 * v[4 * BLOCK + i] + w5 * v[5 * BLOCK + i]
            out[i] -= 0.5 * z * z


@compiled(forceinline=True, fastmath={"contract", "reassoc"})
def _block_posterior(log_density: Array, weights: Array) -> float:
    """Turns log densities (K, b) into weighted responsibilities; returns the log likelihood."""
    largest, total = log_density[0].copy(), np.zeros(BLOCK)
    for i in range(1, len(log_density)):
        row = log_density[i]
        for j in range(BLOCK):
            largest[j] = max(largest[j], row[j])
    for i in range(len(log_density)):
        row = log_density[i]
        for j in range(BLOCK):
            row[j] = fast_exp(row[j] - largest[j])
            total[j] += row[j]
    likelihood = 0.0
    for j in range(BLOCK):
        likelihood += weights[j] * (largest[j] + math.log(total[j]))
        total[j] = weights[j] / total[j]
    for i in range(len(log_density)):
        row = log_density[i]
        for j in range(BLOCK):
            row[j] *= total[j]
    return likelihood


@compiled(forceinline=True, fastmath={"contract", "reassoc"})
def _add_moments(r: Array, v: Array, first: Array, second: Array) -> float:
    """Adds sum r v and the lower triangle of sum r v v^T of a block; returns sum r."""
    total, scaled = 0.0, np.empty(BLOCK)
    for j in range(BLOCK):
        total += r[j]
    for a in range(6):
        s = 0.0
        for j in range(BLOCK):
            scaled[j] = r[j] * v[a * BLOCK + j]
            s += scaled[j]
        first[a] += s
        for b in range(a + 1):
            s = 0.0
            for j in range(BLOCK):
                s += scaled[j] * v[b * BLOCK + j]
            second[a, b] += s
    return total


@compiled(forceinline=True)
def _pass(
    samples: Samples,
    estimate: _Estimate,
    targets: Array,
    moved: bool,
    mass: Array,
    first: Array,
    second: Array,
) -> float:
    """Moments about ``targets`` under the responsibilities of the given mixture.

    ``targets`` are the means themselves unless ``moved``. Returns the log likelihood.
    """
    quaternions, positions, weights = samples
    means, whitening, constants = estimate
    n, k = len(weights), len(means)
    tangents, log_density = np.empty((k, 6 * BLOCK)), np.empty((k, BLOCK))
    block, w = np.empty(7 * BLOCK), np.empty(BLOCK)
    likelihood = 0.0
    mass[:] = 0.0
    first[:] = 0.0
    second[:] = 0.0
    for start in range(0, n, BLOCK):
        for j in range(BLOCK):
            # The last block is filled up with copies of the last pose, of weight zero.
            source = min(start + j, n - 1)
            w[j] = weights[source] if start + j < n else 0.0
            for a in range(4):
                block[a * BLOCK + j] = quaternions[a, source]
            for a in range(3):
                block[(4 + a) * BLOCK + j] = positions[a, source]
        for i in range(k):
            block_tangents(block, means[i], tangents[i])
            block_log_density(tangents[i], whitening[i], constants[i], log_density[i])
        likelihood += _block_posterior(log_density, w)
        for i in range(k):
            if moved:
                block_tangents(block, targets[i], tangents[i])
            mass[i] += _add_moments(log_density[i], tangents[i], first[i], second[i])
    return likelihood


@compiled
def _whiten(covariance: Array, W: Array) -> float:
    """Writes the inverse Cholesky factor of a covariance; returns log((2 pi)^-3 |S|^-1/2)."""
    L = np.empty((6, 6))
    cholesky_kernel(covariance, L, 0.0)
    constant = -3.0 * math.log(2.0 * math.pi)
    for i in range(6):
        constant -= math.log(L[i, i])
        W[i, i] = 1.0 / L[i, i]
        for j in range(i):
            s = 0.0
            for m in range(j, i):
                s += L[i, m] * W[m, j]
            W[i, j] = -s / L[i, i]
    return constant


@compiled
def _move_means(means: Array, mass: Array, first: Array, scale: Array) -> float:
    """Moves every mean by its mean tangent; returns the largest step in units of ``scale``."""
    largest, u = 0.0, np.empty(6)
    for i in range(len(means)):
        for a in range(6):
            u[a] = first[i, a] / mass[i]
            largest = max(largest, abs(u[a]) / scale[a])
        means[i] = compose_kernel(means[i], exp_kernel(u))
    return largest


@compiled
def _covariance(mass: float, first: Array, second: Array, floor: Array, out: Array) -> None:
    """Covariance of one component from its moments about a mean one small step away."""
    for a in range(6):
        for b in range(a + 1):
            out[a, b] = second[a, b] / mass - first[a] * first[b] / (mass * mass)
            out[b, a] = out[a, b]
        out[a, a] += floor[a]


@compiled
def expectation_maximization(
    samples: Samples,
    weights: Array,
    means: Array,
    covariances: Array,
    scale: Array,
    floor: Array,
    stop: Stop,
) -> tuple[Array, Array, Array, Array]:
    """EM from a given mixture.

    Args:
        samples: What to fit to.
        weights: Initial weights, positive, shape (K,).
        means: Initial means, shape (K, 4, 4).
        covariances: Initial covariances, shape (K, 6, 6).
        scale: Size of each tangent dimension in the convergence test, shape (6,).
        floor: Variance added to the diagonal of each covariance by each M step, shape (6,).
        stop: When to end.

    Returns:
        Weights (K',), means (K', 4, 4), covariances (K', 6, 6) and the log likelihood of every
        E step; K' <= K.
    """
    # Within one M step a mean has settled when it moves less than this [rad, m / length scale];
    # over the EM iterations it converges further.
    mean_tolerance = 1e-2
    mean_iterations = 5
    k, n_total = len(means), 0.0
    for i in range(len(samples.weights)):
        n_total += samples.weights[i]
    means, covariances, targets = means.copy(), covariances.copy(), means.copy()
    weights, mass = weights.copy(), np.empty(k)
    whitening, constants = np.zeros((k, 6, 6)), np.empty(k)
    first, second = np.empty((k, 6)), np.empty((k, 6, 6))
    history = np.empty(stop.max_iterations)
    previous, steps = -np.inf, 0
    while steps < stop.max_iterations:
        for i in range(k):
            constants[i] = _whiten(covariances[i], whitening[i]) + math.log(weights[i])
        estimate = _Estimate(means[:k], whitening, constants)
        likelihood = _pass(samples, estimate, means[:k], False, mass, first, second)
        history[steps] = likelihood
        steps += 1
        weakest = 0
        for i in range(k):
            if mass[i] < mass[weakest]:
                weakest = i
        if k > 1 and mass[weakest] < 1.0 - 1e-6:
            # The last component takes the place of the starved one; then a new E step.
            k -= 1
            means[weakest], covariances[weakest] = means[k], covariances[k]
            left = 1.0 - weights[weakest]
            weights[weakest] = weights[k]
            for i in range(k):
                weights[i] /= left
            previous = -np.inf
            continue
        if likelihood - previous < stop.tolerance * n_total:
            break
        previous = likelihood
        targets[:k] = means[:k]
        for _ in range(mean_iterations):
            move = _move_means(targets[:k], mass, first, scale)
            if move < mean_tolerance:
                break
            _pass(samples, estimate, targets[:k], True, mass, first, second)
        for i in range(k):
            _covariance(mass[i], first[i], second[i], floor, covariances[i])
            weights[i] = mass[i] / n_total
        means[:k] = targets[:k]
    return weights[:k], means[:k], covariances[:k], history[:steps]
