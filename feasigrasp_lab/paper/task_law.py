"""The paper's task-space law (section IV-D.1): gradient ascent of a mixture's log density.

As printed, ``qd = J^+ grad log p``, with the right Jacobian where it belongs
(`ascent_kernel`). Corrected, the hand follows the direction preconditioned
so that every component is approached along its geodesic, about grasps in place of means, while it
is carried along with the object's twist: without that feed-forward it lags behind by speed over
gain.
"""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import (
    compose_kernel,
    exp_kernel,
    inverse_kernel,
    right_jacobian_inverse_kernel,
)
from feasigrasp.models.numerics.small_cholesky import cholesky_kernel, cholesky_solve_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel
from feasigrasp_lab.mixtures.mixture import Parameters, evaluate_kernel, posterior_kernel
from feasigrasp_lab.paper.grasp_mixture import LENGTH_PER_RADIAN, GraspMixture
from feasigrasp_lab.paper.options import Law, PaperOptions, Targets

_CHAIN = IIWA_7.chain
#: Gains of the law ``preconditioned`` [1/s], and of the ``gradient``. Source: guessed.
GAINS = (5.0, 0.0005)

# Gradient ascent of a mixture's log density, with an added pull towards better points.
#
# The direction that is followed, ``u = -sum_i r_i Log_mu_i(x)``, vanishes where the pulls of
# several components cancel: half-way between two of them, for instance. The paper samples
# surrounding points there and adds a disturbance if the density is higher at one of them (section
# IV-D.1). So does this, with two changes: the samples are not random, so that the law stays a
# function of the pose; and beside the six axes, both ways, they lie on the geodesics to the
# components, because one of those leads uphill whatever the covariances are like.

#: ... and surrounding points are this share of the mean pull away. Source: guessed.
RADIUS = 0.1


@compiled
def _length(v: Array) -> float:
    angular = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    linear = v[3] * v[3] + v[4] * v[4] + v[5] * v[5]
    return np.sqrt(angular + linear / LENGTH_PER_RADIAN**2)


@compiled
def ascent_kernel(X: Array, parameters: Parameters, gradient: bool, out: Array) -> None:
    """Writes the preconditioned ascent direction (6,) at a pose, disturbed where pulls cancel.

    Or, with ``gradient``, that of the log density for a body perturbation ``x exp(eps)``:
    ``sum_i r_i J_r^-T(xi_i) (-Sigma_i^-1 xi_i)`` with ``xi_i = Log_mu_i(x)``. The paper prints
    ``J_r^-1(mu^-1)`` instead (section IV-D.1), which disagrees with finite differences. Where the
    pulls cancel, so does the gradient; there the disturbance is added, in units of the gradient:
    times the mean of the inverse covariances.
    """
    # Pulls cancel where their sum is shorter than this share of their lengths ...
    cancel = 0.2
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
    disturbed = share < cancel and pull > 1e-9
    if not gradient:
        if disturbed:
            _disturb(X, parameters, here, tangents, pull, 1.0 - share / cancel, out)
        return
    step = np.zeros(6)
    if disturbed:
        _disturb(X, parameters, here, tangents, pull, 1.0 - share / cancel, step)
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


@compiled
def hand_twist_kernel(u_H, X_WH, X_WO, V_WO, max_angular, max_linear):
    """Twist of the hand in the world [angular; linear] from one relative to the object.

    ``u_H`` is the body twist relative to the object. It is shortened, direction kept, so that
    neither part is faster than its limit; then the twist is added that the hand would have if it
    were fixed to the object, whose twist at its own origin is ``V_WO``.
    """
    angular = np.sqrt(u_H[0] ** 2 + u_H[1] ** 2 + u_H[2] ** 2)
    linear = np.sqrt(u_H[3] ** 2 + u_H[4] ** 2 + u_H[5] ** 2)
    scale = 1.0 / max(1.0, angular / max_angular, linear / max_linear)
    V = np.empty(6)
    x, y, z = X_WH[0, 3] - X_WO[0, 3], X_WH[1, 3] - X_WO[1, 3], X_WH[2, 3] - X_WO[2, 3]
    wx, wy, wz = V_WO[0], V_WO[1], V_WO[2]
    V[0], V[1], V[2] = wx, wy, wz
    V[3] = V_WO[3] + wy * z - wz * y
    V[4] = V_WO[4] + wz * x - wx * z
    V[5] = V_WO[5] + wx * y - wy * x
    for i in range(3):
        for j in range(3):
            V[i] += scale * X_WH[i, j] * u_H[j]
            V[3 + i] += scale * X_WH[i, j] * u_H[3 + j]
    return V


@compiled
def least_norm_kernel(J: Array, V: Array, damping: float) -> Array:
    """The velocity (7,) that minimises ``|J qd - V|^2 + d^2 |qd|^2``, at most ``|V| / (2 d)`` long.

    It is ``J^T (J J^T + d^2 I)^-1 V``, by Cholesky factorisation; without damping the shortest one,
    large where J loses rank, but finite.
    """
    # Least damping: no singular value is taken for smaller.
    square = max(damping, 1e-6) ** 2
    A, y, qd = np.empty((6, 6)), V.copy(), np.zeros(J.shape[1])
    for i in range(6):
        for j in range(i + 1):
            s = square if i == j else 0.0
            for k in range(J.shape[1]):
                s += J[i, k] * J[j, k]
            A[i, j] = s
    # Least pivot of the factorisation, in case rounding eats up even that.
    cholesky_kernel(A, A, 1e-14)
    cholesky_solve_kernel(A, y)
    for i in range(6):
        for k in range(J.shape[1]):
            qd[k] += J[i, k] * y[i]
    return qd


@compiled
def _paper_kernel(q, X_FG, X_WO, V_WO, parameters, gain, gradient, damping):
    X_WH, J_WH, u_H = np.empty((4, 4)), np.empty((6, len(q))), np.empty(6)
    pose_jacobian_kernel(_CHAIN, q, X_FG, X_WH, J_WH)
    X_OH = compose_kernel(inverse_kernel(X_WO), X_WH)
    ascent_kernel(X_OH, parameters, gradient, u_H)
    V_WH = hand_twist_kernel(gain * u_H, X_WH, X_WO, V_WO, np.inf, np.inf)
    qd = least_norm_kernel(J_WH, V_WH, damping)
    return qd if np.isfinite(np.sum(qd)) else np.zeros(len(q))


def paper_task_space_velocity(
    q: Array, grasps: GraspMixture, X_WO: Array, V_WO: Array, X_FG: Array, options: PaperOptions
) -> Array:
    """The paper's law, printed or corrected as the options say: ``qd = J^+ V``, nothing enforced.

    The twist V is ``gain`` times the gradient of the log density of the grasps, or the
    preconditioned direction, plus the object's own twist if it is fed forward. Neither is cut
    anywhere. Where the pulls of components cancel, surrounding points decide
    (`feasigrasp_lab.paper.task_law`).

    Args:
        q: Joint positions [rad], shape (7,).
        grasps: Mixture over the grasps, in the object frame.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        X_FG: The grasp frame on the flange, shape (4, 4).
        options: Law, gain, damping, feed-forward, targets.

    Returns:
        Joint velocity [rad/s], shape (7,); zero if anything is not finite.
    """
    mixture = grasps.targets if options.targets == Targets.MEDOIDS else grasps.mixture
    qd: Array = _paper_kernel(
        q,
        X_FG,
        X_WO,
        V_WO if options.feed_forward else np.zeros(6),
        mixture.parameters,
        options.gain_or(*GAINS),
        options.law == Law.GRADIENT,
        float(options.damping),
    )
    return qd
