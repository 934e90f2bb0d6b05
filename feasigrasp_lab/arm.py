"""Algorithms for the arm that studies and training use, and no run: least squares, self-collision.

Damped least-squares inverse kinematics (Wampler 1986), for one pose or a batch: a step is
``dq = J^T (J J^T + lambda^2 I)^-1 e`` with the pose error e = [angular; linear] in the world
(Nakamura and Hanafusa, "Inverse kinematic solutions with singularity robustness for robot
manipulator control", 1986). The damping lambda trades speed for boundedness next to singularities.
It ends in the solution that is close to where it starts: to continue a solution of a pose that
moves, or to refine a rough one. The closed form is in `feasigrasp.models.ik.self_motion`.

Self-collision is that of the iiwa with its hand unless another model is given; the kernels that
runs call are in `feasigrasp.models.robot.capsule_kernels`.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.arm import UPPER
from feasigrasp.models.robot.capsule_kernels import collides_kernel, doubts_kernel
from feasigrasp.models.robot.capsules import CapsuleModel, capsule_model
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

_CHAIN = IIWA_7.chain

#: The identity. Source: definition.
_IDENTITY = np.eye(4)


@compiled
def damped_velocity_kernel(J, V, damping, A, y, qd):
    """Writes ``qd = J^T (J J^T + damping^2 I)^-1 V``, shape (7,).

    ``A`` (6, 6) and ``y`` (6,) are scratch. The matrix is positive definite for any ``damping`` > 0
    and factorised by Cholesky in place; without damping a singular J gives NaN or huge velocities.
    """
    for i in range(6):
        for j in range(i + 1):
            dot = damping * damping if i == j else 0.0
            for k in range(J.shape[1]):
                dot += J[i, k] * J[j, k]
            for k in range(j):
                dot -= A[i, k] * A[j, k]
            # The diagonal holds the reciprocal of the factor's.
            A[i, j] = 1.0 / math.sqrt(dot) if i == j else dot * A[j, j]
        dot = V[i]
        for k in range(i):
            dot -= A[i, k] * y[k]
        y[i] = dot * A[i, i]
    for i in range(5, -1, -1):
        dot = y[i]
        for k in range(i + 1, 6):
            dot -= A[k, i] * y[k]
        y[i] = dot * A[i, i]
    for k in range(J.shape[1]):
        dot = 0.0
        for i in range(6):
            dot += J[i, k] * y[i]
        qd[k] = dot


@compiled
def pose_error_kernel(X, X_target, error):
    """Writes the twist (6,) from one pose to the other; returns position [m] and angle [rad]."""
    ex = ey = ez = trace = 0.0
    for j in range(3):
        ex += X[1, j] * X_target[2, j] - X[2, j] * X_target[1, j]
        ey += X[2, j] * X_target[0, j] - X[0, j] * X_target[2, j]
        ez += X[0, j] * X_target[1, j] - X[1, j] * X_target[0, j]
        trace += X[0, j] * X_target[0, j] + X[1, j] * X_target[1, j] + X[2, j] * X_target[2, j]
        error[3 + j] = X_target[j, 3] - X[j, 3]
    sine = 0.5 * math.sqrt(ex * ex + ey * ey + ez * ez)
    angle = math.atan2(sine, 0.5 * (trace - 1.0))
    scale = 0.5 * angle / sine if sine > 1e-12 else 0.5
    error[0], error[1], error[2] = scale * ex, scale * ey, scale * ez
    return math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2), angle


@compiled
def damped_least_squares_kernel(X_WF, q, steps, damping, limit_margin=-np.inf):
    """Moves ``q`` in place by damped least-squares steps towards the flange pose.

    After every step the joints are clamped to ``limit_margin`` [rad] inside their limits; minus
    infinity, the default, leaves them free. Returns the last position error [m] and angle error
    [rad].
    """
    X, J, A = np.empty((4, 4)), np.empty((6, len(q))), np.empty((6, 6))
    error, y, dq = np.empty(6), np.empty(6), np.empty(len(q))
    for _ in range(steps):
        pose_jacobian_kernel(_CHAIN, q, _IDENTITY, X, J)
        pose_error_kernel(X, X_WF, error)
        damped_velocity_kernel(J, error, damping, A, y, dq)
        for i in range(len(q)):
            limit = _CHAIN[i, UPPER] - limit_margin
            q[i] = min(max(q[i] + dq[i], -limit), limit)
    pose_jacobian_kernel(_CHAIN, q, _IDENTITY, X, J)
    return pose_error_kernel(X, X_WF, error)


@compiled
def _refine_batch(X_WF, q, steps, damping, position, angle):
    for n in range(len(q)):
        position[n], angle[n] = damped_least_squares_kernel(X_WF[n], q[n], steps, damping, 0.0)


def refine(
    X_WF: ArrayLike, q: ArrayLike, steps: int, damping: float = 0.02
) -> tuple[Array, Array, Array]:
    """Damped least-squares steps towards flange poses, each cut off at the joint limits.

    Args:
        X_WF: Flange poses in the base frame, shape (n, 4, 4) [m].
        q: Where to start, shape (n, 7) [rad]; left as it is.
        steps: How many steps.
        damping: lambda; larger is slower, and steadier next to singularities.

    Returns:
        Configurations (n, 7) [rad], and what is left of the position error [m] and of the angle
        error [rad], shape (n,). A pose or a start with NaN gives NaN.

    Raises:
        ValueError: The numbers of poses and of configurations differ, or a shape is wrong.
    """
    targets = np.ascontiguousarray(X_WF, dtype=float)
    refined = np.array(q, dtype=float, order="C")
    if targets.shape != (len(refined), 4, 4) or refined.shape != (len(targets), IIWA_7.joints):
        raise ValueError(
            f"refine: poses {targets.shape} and configurations {refined.shape}; "
            "give (n, 4, 4) and (n, 7)"
        )
    position, angle = np.empty(len(refined)), np.empty(len(refined))
    _refine_batch(targets, refined, int(steps), float(damping), position, angle)
    return refined, position, angle


#: The arm with its hand: the model that `in_collision` uses by default.
IIWA_CAPSULES = capsule_model()


@compiled(nogil=True)
def in_collision_batch_kernel(Q, model, margin, hit):
    """Writes whether configurations (n, 7) have a pair closer than ``margin`` [m]; True for NaN."""
    for k in range(len(Q)):
        doubts = doubts_kernel(model.chain, Q[k], model.balls, model.groups, margin, 0.0, 0, 0)
        hit[k] = doubts >= 2 and collides_kernel(Q[k], model, margin)


def in_collision(Q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES, margin: float = 0.0) -> Mask:
    """Whether configurations are in self-collision.

    Args:
        Q: Joint positions, shape (n, 7) [rad], at most 1e6 in size.
        model: The capsules.
        margin: Pairs closer than this count as touching [m].

    Returns:
        Shape (n,); True for a configuration with NaN, which is not free either.

    Raises:
        ValueError: ``Q`` does not have shape (n, 7).
    """
    Q = IIWA_7.positions(Q, 2)
    hit = np.empty(len(Q), dtype=np.bool_)
    in_collision_batch_kernel(Q, model, float(margin), hit)
    return hit
