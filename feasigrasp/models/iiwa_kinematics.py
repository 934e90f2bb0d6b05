"""Forward kinematics and Jacobian of the iiwa 7, scalar in numba and batched in Python.

The kernels are for loops that run inside other numba code; the public functions take any number
of leading axes. ``T`` is a tool frame fixed to the flange F: pass ``X_FT`` (identity: the flange).
"""

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.models.iiwa import FLANGE_HEIGHT, JOINT_HEIGHTS

#: Step along the local z-axis from the previous joint to joint i; the last one leads to the flange.
_STEPS = np.diff(np.concatenate([[0.0], JOINT_HEIGHTS, [FLANGE_HEIGHT]]))
#: Joints turn about local +y or -y (sign) or about z (0).
_Y_SIGN = np.array([0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0])

FloatArray = NDArray[np.float64]


@nb.njit(cache=True)
def pose_jacobian_kernel(q, X_FT, X_WT, J_WT):  # type: ignore[no-untyped-def]
    """Writes the tool pose and the Jacobian ``V_WT = J_WT v`` at the tool origin, in the world."""
    r00, r01, r02 = 1.0, 0.0, 0.0
    r10, r11, r12 = 0.0, 1.0, 0.0
    r20, r21, r22 = 0.0, 0.0, 1.0
    px, py, pz = 0.0, 0.0, 0.0
    for i in range(7):
        px += r02 * _STEPS[i]
        py += r12 * _STEPS[i]
        pz += r22 * _STEPS[i]
        s, c = np.sin(q[i]), np.cos(q[i])
        sign = _Y_SIGN[i]
        # Until the tool position is known, rows 3..5 hold the joint's position.
        J_WT[3, i], J_WT[4, i], J_WT[5, i] = px, py, pz
        if sign == 0.0:
            J_WT[0, i], J_WT[1, i], J_WT[2, i] = r02, r12, r22
            r00, r01 = c * r00 + s * r01, c * r01 - s * r00
            r10, r11 = c * r10 + s * r11, c * r11 - s * r10
            r20, r21 = c * r20 + s * r21, c * r21 - s * r20
        else:
            s *= sign
            J_WT[0, i], J_WT[1, i], J_WT[2, i] = sign * r01, sign * r11, sign * r21
            r00, r02 = c * r00 - s * r02, s * r00 + c * r02
            r10, r12 = c * r10 - s * r12, s * r10 + c * r12
            r20, r22 = c * r20 - s * r22, s * r20 + c * r22
    px += r02 * _STEPS[7]
    py += r12 * _STEPS[7]
    pz += r22 * _STEPS[7]
    for j in range(4):
        x, y, z = X_FT[0, j], X_FT[1, j], X_FT[2, j]
        X_WT[0, j] = r00 * x + r01 * y + r02 * z
        X_WT[1, j] = r10 * x + r11 * y + r12 * z
        X_WT[2, j] = r20 * x + r21 * y + r22 * z
        X_WT[3, j] = 0.0
    X_WT[0, 3] += px
    X_WT[1, 3] += py
    X_WT[2, 3] += pz
    X_WT[3, 3] = 1.0
    for i in range(7):
        dx, dy, dz = X_WT[0, 3] - J_WT[3, i], X_WT[1, 3] - J_WT[4, i], X_WT[2, 3] - J_WT[5, i]
        ax, ay, az = J_WT[0, i], J_WT[1, i], J_WT[2, i]
        J_WT[3, i] = ay * dz - az * dy
        J_WT[4, i] = az * dx - ax * dz
        J_WT[5, i] = ax * dy - ay * dx


@nb.njit(cache=True)
def _batch_kernel(q, X_FT, X_WT, J_WT):  # type: ignore[no-untyped-def]
    for k in range(len(q)):
        pose_jacobian_kernel(q[k], X_FT, X_WT[k], J_WT[k])


def pose_and_jacobian(q: ArrayLike, X_FT: ArrayLike | None = None) -> tuple[FloatArray, FloatArray]:
    """Tool pose and geometric Jacobian.

    Args:
        q: Joint positions [rad], shape (..., 7).
        X_FT: Tool frame in the flange frame, shape (4, 4); the flange itself by default.

    Returns:
        ``X_WT``, shape (..., 4, 4) [m], and ``J_WT``, shape (..., 6, 7), with rows
        [angular; linear] at the tool origin, expressed in the world.

    Raises:
        ValueError: The last axis of ``q`` is not 7 long.
    """
    q = np.asarray(q, dtype=float)
    if q.shape[-1:] != (7,):
        raise ValueError(f"joint positions need 7 entries in the last axis, got shape {q.shape}")
    flat = np.ascontiguousarray(q.reshape(-1, 7))
    X_FT = np.eye(4) if X_FT is None else np.ascontiguousarray(X_FT, dtype=float)
    X_WT = np.empty((len(flat), 4, 4))
    J_WT = np.empty((len(flat), 6, 7))
    _batch_kernel(flat, X_FT, X_WT, J_WT)
    return X_WT.reshape(*q.shape[:-1], 4, 4), J_WT.reshape(*q.shape[:-1], 6, 7)


def forward_kinematics(q: ArrayLike, X_FT: ArrayLike | None = None) -> FloatArray:
    """Tool pose ``X_WT``, shape (..., 4, 4), of the configurations ``q``, shape (..., 7)."""
    return pose_and_jacobian(q, X_FT)[0]


def manipulability(q: ArrayLike) -> FloatArray:
    """Yoshikawa's measure sqrt(det J J^T) at the flange, J in [rad/s; m/s]; shape (...)."""
    J_WF = pose_and_jacobian(q)[1]
    det = np.linalg.det(J_WF @ np.swapaxes(J_WF, -1, -2))
    return np.asarray(np.sqrt(np.maximum(det, 0.0)))
