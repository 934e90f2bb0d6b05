"""Gradient ascent of a mixture's log density, with an added pull towards better points.

The direction that is followed, ``u = -sum_i r_i Log_mu_i(x)``, vanishes where the pulls of several
components cancel: half-way between two of them, for instance. The paper samples surrounding points
there and adds a disturbance if the density is higher at one of them (section IV-D.1). So does
this, with two changes: the samples are not random, so that the law stays a function of the pose;
and beside the six axes, both ways, they lie on the geodesics to the components, because one of
those leads uphill whatever the covariances are like.
"""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.task.target import LENGTH_PER_RADIAN
from feasigrasp.models.geometry.se3_kernels import (
    compose_kernel,
    exp_kernel,
    right_jacobian_inverse_kernel,
)
from feasigrasp.models.mixtures.kernels import Parameters, evaluate_kernel, posterior_kernel

#: Pulls cancel where their sum is shorter than this share of their lengths ...
CANCEL = 0.2
#: ... and surrounding points are this share of the mean pull away.
RADIUS = 0.1


@compiled
def _length(v: Array) -> float:
    angular = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    linear = v[3] * v[3] + v[4] * v[4] + v[5] * v[5]
    return np.sqrt(angular + linear / LENGTH_PER_RADIAN**2)


@compiled
def ascent_kernel(X: Array, parameters: Parameters, out: Array) -> None:
    """Writes the preconditioned ascent direction (6,) at a pose, disturbed where pulls cancel."""
    _ascent(X, parameters, False, out)


@compiled
def gradient_kernel(X: Array, parameters: Parameters, out: Array) -> None:
    """Writes the gradient of the log density at one pose, as `RiemannianMixture` has it.

    Where the pulls cancel, so does the gradient; there the disturbance of `ascent_kernel` is
    added, in units of the gradient: times the mean of the inverse covariances.
    """
    _ascent(X, parameters, True, out)


@compiled
def _ascent(X: Array, parameters: Parameters, gradient: bool, out: Array) -> None:
    n = len(parameters.means)
    tangents, log_densities, r = np.empty((n, 6)), np.empty(n), np.empty(n)
    evaluate_kernel(X, parameters, tangents, log_densities)
    here = posterior_kernel(parameters.log_weights, log_densities, r)
    out[:] = 0.0
    pull = 0.0
    for k in range(n):
        pull += r[k] * _length(tangents[k])
        for i in range(6):
            out[i] -= r[k] * tangents[k, i]
    share = _length(out) / max(pull, 1e-12)
    disturbed = share < CANCEL and pull > 1e-9
    if not gradient:
        if disturbed:
            _disturb(X, parameters, here, tangents, pull, 1.0 - share / CANCEL, out)
        return
    step = np.zeros(6)
    if disturbed:
        _disturb(X, parameters, here, tangents, pull, 1.0 - share / CANCEL, step)
    out[:] = 0.0
    pulls = np.empty((2, 6))
    for k in range(n):
        J = right_jacobian_inverse_kernel(tangents[k])
        _weighed(parameters.whitening[k], tangents[k], pulls[0])
        _weighed(parameters.whitening[k], step, pulls[1])
        for i in range(6):
            out[i] += r[k] * pulls[1, i]
            for j in range(6):
                out[i] -= r[k] * J[j, i] * pulls[0, j]


@compiled
def _weighed(W: Array, v: Array, out: Array) -> None:
    """Writes Sigma^-1 v (6,), with Sigma^-1 = W^T W and W lower triangular."""
    out[:] = 0.0
    for i in range(6):
        z = 0.0
        for j in range(i + 1):
            z += W[i, j] * v[j]
        for j in range(i + 1):
            out[j] += W[i, j] * z


@compiled
def _disturb(
    X: Array,
    parameters: Parameters,
    here: float,
    tangents: Array,
    pull: float,
    strength: float,
    out: Array,
) -> None:
    """Adds a pull towards the surrounding point of highest density, if it exceeds that here."""
    n, radius = len(tangents), RADIUS * pull
    room, log_densities, r = np.empty((n, 6)), np.empty(n), np.empty(n)
    best, best_step, step = here, np.zeros(6), np.empty(6)
    for sample in range(12 + n):
        if sample < 12:
            step[:] = 0.0
            axis = sample // 2
            size = radius if axis < 3 else radius * LENGTH_PER_RADIAN
            step[axis] = size if sample % 2 == 0 else -size
        else:
            length = _length(tangents[sample - 12])
            if length < radius:
                continue
            for i in range(6):
                step[i] = -tangents[sample - 12, i] * radius / length
        evaluate_kernel(compose_kernel(X, exp_kernel(step)), parameters, room, log_densities)
        there = posterior_kernel(parameters.log_weights, log_densities, r)
        if there > best:
            best = there
            best_step[:] = step
    for i in range(6):
        out[i] += strength * best_step[i] / RADIUS
