"""Inverse kinematics of the iiwa 7: closed form of the S-R-S arm, and damped least squares.

The three shoulder axes meet in S, the three wrist axes in C, so that the elbow moves on a circle
about the line S-C. The angle on this circle, the *arm angle* psi, is the redundant degree of
freedom (Shimizu et al., "Analytical inverse kinematic computation for 7-DOF redundant
manipulators with joint limits", T-RO 2008). For a flange pose and an arm angle there are up to
eight configurations: the signs of the shoulder, elbow and wrist joints 2, 4 and 6.
"""

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.models.iiwa import (
    D_BASE_SHOULDER,
    D_ELBOW_WRIST,
    D_SHOULDER_ELBOW,
    D_WRIST_FLANGE,
    POSITION_LIMITS,
    VELOCITY_LIMITS,
)
from feasigrasp.models.iiwa_kinematics import pose_jacobian_kernel

FloatArray = NDArray[np.float64]


@nb.njit(cache=True)
def _rot_zyz(a, b, c, R):  # type: ignore[no-untyped-def]
    """R = Rz(a) Ry(b) Rz(c)."""
    sa, ca, sb, cb, sc, cc = np.sin(a), np.cos(a), np.sin(b), np.cos(b), np.sin(c), np.cos(c)
    R[0, 0], R[0, 1], R[0, 2] = ca * cb * cc - sa * sc, -ca * cb * sc - sa * cc, ca * sb
    R[1, 0], R[1, 1], R[1, 2] = sa * cb * cc + ca * sc, -sa * cb * sc + ca * cc, sa * sb
    R[2, 0], R[2, 1], R[2, 2] = -sb * cc, sb * sc, cb


@nb.njit(cache=True)
def _zyz_angles(R, plus, minus):  # type: ignore[no-untyped-def]
    """Writes both sets of angles (3,) of R = Rz Ry Rz; the last is 0 where the middle one is."""
    s = np.sqrt(R[0, 2] ** 2 + R[1, 2] ** 2)
    plus[1] = np.arctan2(s, R[2, 2])
    if s > 1e-12:
        ca, sa = R[0, 2] / s, R[1, 2] / s
        plus[0] = np.arctan2(sa, ca)
        # What is left of R after the first angle: the product stays R where s is close to rounding.
        plus[2] = np.arctan2(ca * R[1, 0] - sa * R[0, 0], ca * R[1, 1] - sa * R[0, 1])
    elif R[2, 2] > 0.0:
        plus[0], plus[2] = np.arctan2(R[1, 0], R[0, 0]), 0.0
    else:
        plus[0], plus[2] = np.arctan2(-R[1, 0], -R[0, 0]), 0.0
    # Rz(a) Ry(b) Rz(c) = Rz(a + pi) Ry(-b) Rz(c + pi).
    minus[0] = plus[0] - np.pi if plus[0] > 0.0 else plus[0] + np.pi
    minus[1] = -plus[1]
    minus[2] = plus[2] - np.pi if plus[2] > 0.0 else plus[2] + np.pi


@nb.njit(cache=True)
def _reference_shoulder(X_WF, elbow_sign, R_03, axis):  # type: ignore[no-untyped-def]
    """Shoulder rotation with q3 = 0, the axis S-C, and q4; q4 is NaN where C is out of reach."""
    cx = X_WF[0, 3] - D_WRIST_FLANGE * X_WF[0, 2]
    cy = X_WF[1, 3] - D_WRIST_FLANGE * X_WF[1, 2]
    cz = X_WF[2, 3] - D_WRIST_FLANGE * X_WF[2, 2] - D_BASE_SHOULDER
    length = np.sqrt(cx * cx + cy * cy + cz * cz)
    a, b = D_SHOULDER_ELBOW, D_ELBOW_WRIST
    cos_q4 = (length * length - a * a - b * b) / (2.0 * a * b)
    if cos_q4 > 1.0 or cos_q4 < -1.0 or length < 1e-9:
        return np.nan
    q4 = elbow_sign * np.arccos(cos_q4)
    axis[0], axis[1], axis[2] = cx / length, cy / length, cz / length
    # Wrist centre in the upper arm's frame: (-b sin q4, 0, a + b cos q4).
    rho = np.hypot(cx, cy)
    q1 = np.arctan2(cy, cx) if rho > 1e-12 else 0.0
    q2 = np.arctan2(rho, cz) - np.arctan2(-b * np.sin(q4), a + b * np.cos(q4))
    _rot_zyz(q1, q2, 0.0, R_03)
    return q4


@nb.njit(cache=True)
def reference_kernel(X_WF, R0, axis, q4):  # type: ignore[no-untyped-def]
    """Writes what all arm angles share: R0 (2, 3, 3), axis (3,), q4 (2,); False if out of reach."""
    q4[0] = _reference_shoulder(X_WF, 1.0, R0[0], axis)
    q4[1] = _reference_shoulder(X_WF, -1.0, R0[1], axis)
    return not np.isnan(q4[0])


@nb.njit(cache=True)
def branches_kernel(X_WF, R0, axis, q4, psi, work, out):  # type: ignore[no-untyped-def]
    """Writes the eight configurations (8, 7) of an arm angle; ``work`` is scratch, (4, 3, 3)."""
    R_03, R_47, shoulder, wrist = work[0], work[1], work[2], work[3]
    sp, cp = np.sin(psi), np.cos(psi)
    count = 0
    for elbow in range(2):
        for j in range(3):
            x, y, z = R0[elbow, 0, j], R0[elbow, 1, j], R0[elbow, 2, j]
            dot = (1.0 - cp) * (axis[0] * x + axis[1] * y + axis[2] * z)
            R_03[0, j] = cp * x + sp * (axis[1] * z - axis[2] * y) + dot * axis[0]
            R_03[1, j] = cp * y + sp * (axis[2] * x - axis[0] * z) + dot * axis[1]
            R_03[2, j] = cp * z + sp * (axis[0] * y - axis[1] * x) + dot * axis[2]
        s4, c4 = np.sin(q4[elbow]), np.cos(q4[elbow])
        for j in range(3):
            # Rows of R_47 = Ry(-q4)^T R_03^T R_WF.
            x = R_03[0, 0] * X_WF[0, j] + R_03[1, 0] * X_WF[1, j] + R_03[2, 0] * X_WF[2, j]
            y = R_03[0, 1] * X_WF[0, j] + R_03[1, 1] * X_WF[1, j] + R_03[2, 1] * X_WF[2, j]
            z = R_03[0, 2] * X_WF[0, j] + R_03[1, 2] * X_WF[1, j] + R_03[2, 2] * X_WF[2, j]
            R_47[0, j], R_47[1, j], R_47[2, j] = c4 * x + s4 * z, y, c4 * z - s4 * x
        _zyz_angles(R_03, shoulder[0], shoulder[1])
        _zyz_angles(R_47, wrist[0], wrist[1])
        for i in range(2):
            for j in range(2):
                for k in range(3):
                    out[count, k] = shoulder[i, k]
                    out[count, 4 + k] = wrist[j, k]
                out[count, 3] = q4[elbow]
                count += 1


@nb.njit(cache=True)
def closed_form_kernel(X_WF, psi, out):  # type: ignore[no-untyped-def]
    """Writes eight configurations (8, 7) for a flange pose and an arm angle; 8, or 0 if none."""
    R0, axis, q4 = np.empty((2, 3, 3)), np.empty(3), np.empty(2)
    if not reference_kernel(X_WF, R0, axis, q4):
        return 0
    branches_kernel(X_WF, R0, axis, q4, psi, np.empty((4, 3, 3)), out)
    return 8


@nb.njit(cache=True)
def inside_limits_kernel(q, margin):  # type: ignore[no-untyped-def]
    """Whether every joint stays ``margin`` [rad] away from its limits."""
    for i in range(7):  # noqa: SIM110 - numba compiles the loop, not all()
        if abs(q[i]) > POSITION_LIMITS[i] - margin:
            return False
    return True


@nb.njit(cache=True)
def travel_time_kernel(q_a, q_b):  # type: ignore[no-untyped-def]
    """max_j |dq_j| / v_j: the least time from one configuration to the other [s]."""
    worst = 0.0
    for i in range(7):
        worst = max(worst, abs(q_a[i] - q_b[i]) / VELOCITY_LIMITS[i])
    return worst


@nb.njit(cache=True)
def damped_least_squares_kernel(X_WF, q, iterations, damping):  # type: ignore[no-untyped-def]
    """Moves ``q`` in place by damped least-squares steps towards the flange pose.

    Returns the last position error [m] and angle error [rad].
    """
    identity, X, J = np.eye(4), np.empty((4, 4)), np.empty((6, 7))
    error = np.empty(6)
    position_error, angle_error = np.inf, np.inf
    for k in range(iterations + 1):
        pose_jacobian_kernel(q, identity, X, J)
        # Rotation error as the vector of R_target R^T, exact in its direction for small angles.
        ex = ey = ez = 0.0
        for j in range(3):
            ex += X[1, j] * X_WF[2, j] - X[2, j] * X_WF[1, j]
            ey += X[2, j] * X_WF[0, j] - X[0, j] * X_WF[2, j]
            ez += X[0, j] * X_WF[1, j] - X[1, j] * X_WF[0, j]
        error[0], error[1], error[2] = 0.5 * ex, 0.5 * ey, 0.5 * ez
        trace = 0.0
        for i in range(3):
            error[3 + i] = X_WF[i, 3] - X[i, 3]
            for j in range(3):
                trace += X[i, j] * X_WF[i, j]
        sine = np.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
        angle_error = np.arctan2(sine, 0.5 * (trace - 1.0))
        position_error = np.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
        if k == iterations:
            break
        if sine > 1e-12:
            error[:3] *= angle_error / sine
        A = J @ J.T
        for i in range(6):
            A[i, i] += damping * damping
        q += J.T @ np.linalg.solve(A, error)
    return position_error, angle_error


@nb.njit(cache=True)
def arm_angle_kernel(q):  # type: ignore[no-untyped-def]
    """Arm angle of a configuration [rad]; 0 where it is undefined."""
    X_WF, J = np.empty((4, 4)), np.empty((6, 7))
    pose_jacobian_kernel(q, np.eye(4), X_WF, J)
    R0, R_03, axis = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    if np.isnan(_reference_shoulder(X_WF, 1.0 if q[3] >= 0 else -1.0, R0, axis)):
        return 0.0
    _rot_zyz(q[0], q[1], q[2], R_03)
    R = R_03 @ R0.T
    sine = axis[0] * (R[2, 1] - R[1, 2])
    sine += axis[1] * (R[0, 2] - R[2, 0]) + axis[2] * (R[1, 0] - R[0, 1])
    return np.arctan2(sine, R[0, 0] + R[1, 1] + R[2, 2] - 1.0)


def closed_form(X_WF: ArrayLike, psi: float) -> FloatArray:
    """All configurations that reach a flange pose with a given arm angle, limits not considered.

    Args:
        X_WF: Flange pose, shape (4, 4) [m].
        psi: Arm angle [rad].

    Returns:
        Shape (8, 7) [rad], or (0, 7) if the wrist centre is out of reach.
    """
    out = np.empty((8, 7))
    count = closed_form_kernel(np.ascontiguousarray(X_WF, dtype=float), float(psi), out)
    return out[:count]


def arm_angle(q: ArrayLike) -> float:
    """Arm angle of a configuration [rad]: with it, `closed_form` of its flange pose contains it."""
    return float(arm_angle_kernel(np.asarray(q, dtype=float)))
