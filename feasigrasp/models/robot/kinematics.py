"""Forward kinematics, Jacobian and manipulability (Yoshikawa 1985) of an arm.

The kernels are for loops that run inside other numba code; the public functions take any number
of leading axes. ``T`` is a tool frame fixed to the flange F: pass ``X_FT`` (identity: the flange).
A column of the Jacobian is ``[a_i; a_i x (p_T - p_i)]`` with the joint's axis ``a_i`` through
``p_i``; ``chain`` is that of an `Arm`.
"""

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.vectors import cross
from feasigrasp.models.quantities import JOINTS, POSE
from feasigrasp.models.robot.arm import LOWER, ROTATION, SIGN, UPPER, VELOCITY, Arm
from feasigrasp.models.robot.capsule_kernels import next_link, next_origin
from feasigrasp.models.robot.iiwa import IIWA_7


@compiled
def arm_condition_kernel(chain, q, v):
    """Three figures of an arm with joint positions q (n,) [rad] and velocities v (n,) [rad/s].

    Smallest distance to a joint limit, negative beyond it [rad]; largest joint speed over its
    limit; manipulability sqrt(det J J^T).
    """
    margin, ratio = np.inf, 0.0
    for i in range(len(q)):
        margin = min(margin, chain[i, UPPER] - q[i], q[i] - chain[i, LOWER])
        ratio = max(ratio, abs(v[i]) / chain[i, VELOCITY])
    return margin, ratio, manipulability_kernel(chain, q)


@compiled
def pose_jacobian_kernel(chain, q, X_FT, X_WT, J_WT):
    """Writes the tool pose and the Jacobian ``V_WT = J_WT v`` at the tool origin, in the world.

    There is no Jacobian where ``J_WT`` is None.
    """
    n, origin = len(q), (0.0, 0.0, 0.0)
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for j in range(n):
        origin, x, y, z, axis = next_link(chain, j, q[j], origin, x, y, z)
        if J_WT is not None:
            sign = chain[j, SIGN]
            J_WT[0, j], J_WT[1, j], J_WT[2, j] = sign * axis[0], sign * axis[1], sign * axis[2]
            J_WT[3, j], J_WT[4, j], J_WT[5, j] = origin
    origin = next_origin(chain, n, origin, x, y, z)
    for j in range(4):
        for i in range(3):
            X_WT[i, j] = origin[i] if j == 3 else 0.0
        for k in range(3):
            # Component k, in the last link's frame, of column j of the tool's pose on the flange.
            u = chain[n, ROTATION + 3 * k] * X_FT[0, j]
            u += chain[n, ROTATION + 3 * k + 1] * X_FT[1, j]
            u += chain[n, ROTATION + 3 * k + 2] * X_FT[2, j]
            a = x if k == 0 else (y if k == 1 else z)
            for i in range(3):
                X_WT[i, j] += a[i] * u
        X_WT[3, j] = 1.0 if j == 3 else 0.0
    if J_WT is not None:
        for j in range(n):
            lever = X_WT[0, 3] - J_WT[3, j], X_WT[1, 3] - J_WT[4, j], X_WT[2, 3] - J_WT[5, j]
            J_WT[3, j], J_WT[4, j], J_WT[5, j] = cross((J_WT[0, j], J_WT[1, j], J_WT[2, j]), lever)


@compiled
def manipulability_kernel(chain, q):
    """Yoshikawa's measure at any tool point, see `manipulability`: by Cholesky factors of J J^T."""
    X, J, L, product = np.empty((4, 4)), np.empty((6, len(q))), np.empty((6, 6)), 1.0
    pose_jacobian_kernel(chain, q, np.eye(4), X, J)
    for i in range(6):
        for j in range(i + 1):
            s = 0.0
            for k in range(len(q)):
                s += J[i, k] * J[j, k]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j and not s > 0.0:
                return s * 0.0
            L[i, j] = np.sqrt(s) if i == j else s / L[j, j]
        product *= L[i, i]
    return product


@compiled(nogil=True)
def _batch_kernel(chain, q, X_FT, X_WT, J_WT):
    for k in range(len(q)):
        pose_jacobian_kernel(chain, q[k], X_FT, X_WT[k], J_WT[k])


@compiled(nogil=True)
def _pose_batch_kernel(chain, q, X_FT, X_WT):
    for k in range(len(q)):
        pose_jacobian_kernel(chain, q[k], X_FT, X_WT[k], None)


@compiled(nogil=True)
def _manipulability_batch_kernel(chain, q, out):
    for k in range(len(q)):
        out[k] = manipulability_kernel(chain, q[k])


def _tool(X_FT: ArrayLike | None) -> Array:
    # Writable, since a kernel is compiled once more for read-only arguments.
    return np.eye(4) if X_FT is None else np.ascontiguousarray(X_FT, dtype=float)


@checked()
def pose_and_jacobian(
    q: Annotated[ArrayLike, JOINTS],
    X_FT: Annotated[ArrayLike, POSE] | None = None,
    arm: Arm = IIWA_7,
) -> tuple[Array, Array]:
    """Tool pose and geometric Jacobian.

    Args:
        q: Joint positions [rad], shape (..., 7).
        X_FT: Tool frame in the flange frame, shape (4, 4); the flange itself by default.
        arm: The arm.

    Returns:
        ``X_WT``, shape (..., 4, 4) [m], and ``J_WT``, shape (..., 6, 7), with rows
        [angular; linear] at the tool origin, expressed in the world. NaN positions give NaN.

    Raises:
        ArgumentError: ``q`` or ``X_FT`` has another shape; more than 2.5 turns (degrees?), or no
            pose.
    """
    return tool_pose_and_jacobian(arm.positions(q), X_FT, arm)


def tool_pose_and_jacobian(q: Array, X_FT: ArrayLike | None, arm: Arm) -> tuple[Array, Array]:
    """As `pose_and_jacobian`, of measured positions: without limits these are of many turns."""
    q = np.ascontiguousarray(q, dtype=float)
    lead = q.shape[:-1]
    X_WT, J_WT = np.empty((*lead, 4, 4)), np.empty((*lead, 6, arm.joints))
    _batch_kernel(
        arm.chain,
        q.reshape(-1, arm.joints),
        _tool(X_FT),
        X_WT.reshape(-1, 4, 4),
        J_WT.reshape(-1, 6, arm.joints),
    )
    return X_WT, J_WT


@checked()
def forward_kinematics(
    q: Annotated[ArrayLike, JOINTS],
    X_FT: Annotated[ArrayLike, POSE] | None = None,
    arm: Arm = IIWA_7,
) -> Array:
    """Tool pose ``X_WT``, shape (..., 4, 4). Arguments and errors as `pose_and_jacobian`."""
    return tool_pose(arm.positions(q), X_FT, arm)


def tool_pose(q: Array, X_FT: ArrayLike | None, arm: Arm) -> Array:
    """As `forward_kinematics`, see `tool_pose_and_jacobian`."""
    q = np.ascontiguousarray(q, dtype=float)
    X_WT = np.empty((*q.shape[:-1], 4, 4))
    _pose_batch_kernel(arm.chain, q.reshape(-1, arm.joints), _tool(X_FT), X_WT.reshape(-1, 4, 4))
    return X_WT


@checked()
def manipulability(q: Annotated[ArrayLike, JOINTS], arm: Arm = IIWA_7) -> Array:
    """Yoshikawa's measure sqrt(det J J^T), J in [rad/s; m/s].

    It is the same at every tool point. Arguments and errors as `pose_and_jacobian`; shape (...).
    """
    q = arm.positions(q)
    out = np.empty(q.shape[:-1])
    _manipulability_batch_kernel(arm.chain, q.reshape(-1, arm.joints), out.reshape(-1))
    return out
