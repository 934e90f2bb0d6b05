"""Forward kinematics, Jacobian and manipulability (Yoshikawa 1985) of the iiwa 7.

The kernels are for loops that run inside other numba code; the public functions take any number
of leading axes. ``T`` is a tool frame fixed to the flange F: pass ``X_FT`` (identity: the flange).

The arm is S-R-S: joints 1 to 3 turn about axes through the shoulder S, joint 4 about one through
the elbow E, joints 5 to 7 about axes through the wrist W. A column of the Jacobian is therefore
``[a_i; a_i x (p_T - p)]`` with the joint's axis ``a_i`` and one of these three points.
"""

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_sincos, sincos_kernel
from feasigrasp.models.numerics.vectors import cross, dot, step, turn
from feasigrasp.models.quantities import JOINTS, POSE
from feasigrasp.models.robot.arm import LOWER, UPPER, VELOCITY, Arm
from feasigrasp.models.robot.iiwa import IIWA_7


@compiled
def arm_condition_kernel(chain, q, v):
    """Three figures of one state of the arm.

    Args:
        chain: That of the `Arm`.
        q: Joint positions [rad], shape (n,).
        v: Joint velocities [rad/s], shape (n,).

    Returns:
        Smallest distance to a joint limit, negative beyond it [rad]; largest joint speed over its
        limit; manipulability sqrt(det J J^T).
    """
    margin, ratio = np.inf, 0.0
    for i in range(len(q)):
        margin = min(margin, chain[i, UPPER] - q[i], q[i] - chain[i, LOWER])
        ratio = max(ratio, abs(v[i]) / chain[i, VELOCITY])
    return margin, ratio, manipulability_kernel(chain, q)


_BASE_SHOULDER, _SHOULDER_ELBOW, _ELBOW_WRIST, _WRIST_FLANGE = IIWA_7.lengths


@compiled(forceinline=True)
def _axes(s, c):
    """Axes of joints 2 to 7, and the x- and y-axis of link 7, from the sines and cosines."""
    x, y = (c[0] * c[1], s[0] * c[1], -s[1]), (-s[0], c[0], 0.0)
    z = (c[0] * s[1], s[0] * s[1], c[1])
    a2, a3 = y, z
    x, y = turn(x, y, s[2], c[2])
    a4 = (-y[0], -y[1], -y[2])
    z, x = turn(z, x, -s[3], c[3])
    a5 = z
    x, y = turn(x, y, s[4], c[4])
    a6 = y
    z, x = turn(z, x, s[5], c[5])
    x, y = turn(x, y, s[6], c[6])
    return a2, a3, a4, a5, a6, z, x, y


@compiled(forceinline=True)
def _write_column(J, i, axis, lever):
    """Writes column i: the axis, and what it does to the end of a lever that starts on it."""
    J[0, i], J[1, i], J[2, i] = axis
    J[3, i], J[4, i], J[5, i] = cross(axis, lever)


@compiled(forceinline=True)
def _pose_jacobian(s, c, X_FT, X_WT, J_WT):
    """As `pose_jacobian_kernel`, from sines and cosines; no Jacobian where ``J_WT`` is None."""
    a2, a3, a4, a5, a6, a7, x7, y7 = _axes(s, c)
    for j in range(4):
        x, y, z = X_FT[0, j], X_FT[1, j], X_FT[2, j]
        if j == 3:
            z += _WRIST_FLANGE
        X_WT[0, j] = x7[0] * x + y7[0] * y + a7[0] * z
        X_WT[1, j] = x7[1] * x + y7[1] * y + a7[1] * z
        X_WT[2, j] = x7[2] * x + y7[2] * y + a7[2] * z
        X_WT[3, j] = 0.0
    from_wrist = X_WT[0, 3], X_WT[1, 3], X_WT[2, 3]
    from_elbow = step(from_wrist, _ELBOW_WRIST, a5)
    from_shoulder = step(from_elbow, _SHOULDER_ELBOW, a3)
    X_WT[0, 3], X_WT[1, 3] = from_shoulder[0], from_shoulder[1]
    X_WT[2, 3] = from_shoulder[2] + _BASE_SHOULDER
    X_WT[3, 3] = 1.0
    if J_WT is not None:
        _write_column(J_WT, 0, (0.0, 0.0, 1.0), from_shoulder)
        _write_column(J_WT, 1, a2, from_shoulder)
        _write_column(J_WT, 2, a3, from_shoulder)
        _write_column(J_WT, 3, a4, from_elbow)
        _write_column(J_WT, 4, a5, from_wrist)
        _write_column(J_WT, 5, a6, from_wrist)
        _write_column(J_WT, 6, a7, from_wrist)


@compiled(forceinline=True)
def _manipulability(s, c):
    r"""sqrt(det J J^T) by Cauchy and Binet: the sum of the squares of the seven 6 x 6 minors.

    The determinant is that of any tool point. With the wrist for tool, ``J = [A B; L 0]`` (the
    wrist's axes B) and ``n`` the minors of L (3 x 4), ``L n = 0``, it is
    ``det(B)^2 |n|^2 + sum_{k<l} (A n . (b_k x b_l))^2``.
    """
    a2, a3, a4, a5, a6, a7, _, _ = _axes(s, c)
    a1 = (0.0, 0.0, 1.0)
    from_elbow = step((0.0, 0.0, 0.0), _ELBOW_WRIST, a5)
    from_shoulder = step(from_elbow, _SHOULDER_ELBOW, a3)
    l1, l2 = cross(a1, from_shoulder), cross(a2, from_shoulder)
    l3, l4 = cross(a3, from_shoulder), cross(a4, from_elbow)
    l12, l34 = cross(l1, l2), cross(l3, l4)
    n1, n2, n3, n4 = dot(l2, l34), -dot(l1, l34), dot(l12, l4), -dot(l12, l3)
    turn = step(step(step(step((0.0, 0.0, 0.0), n1, a1), n2, a2), n3, a3), n4, a4)
    b56, b67, b75 = cross(a5, a6), cross(a6, a7), cross(a7, a5)
    det_b = dot(a5, b67)
    m56, m67, m75 = dot(turn, b56), dot(turn, b67), dot(turn, b75)
    n_squared = n1 * n1 + n2 * n2 + n3 * n3 + n4 * n4
    return np.sqrt(det_b * det_b * n_squared + m56 * m56 + m67 * m67 + m75 * m75)


@compiled(forceinline=True)
def _sincos(q):
    s1, c1 = fast_sincos(q[0])
    s2, c2 = fast_sincos(q[1])
    s3, c3 = fast_sincos(q[2])
    s4, c4 = fast_sincos(q[3])
    s5, c5 = fast_sincos(q[4])
    s6, c6 = fast_sincos(q[5])
    s7, c7 = fast_sincos(q[6])
    return (s1, s2, s3, s4, s5, s6, s7), (c1, c2, c3, c4, c5, c6, c7)


@compiled
def pose_jacobian_kernel(chain, q, X_FT, X_WT, J_WT):
    """Writes the tool pose and the Jacobian ``V_WT = J_WT v`` at the tool origin, in the world."""
    s, c = _sincos(q)
    _pose_jacobian(s, c, X_FT, X_WT, J_WT)


@compiled
def manipulability_kernel(chain, q):
    """Yoshikawa's measure at any tool point, see `manipulability`."""
    s, c = _sincos(q)
    return _manipulability(s, c)


@compiled(forceinline=True)
def _row(a, k):
    return a[k, 0], a[k, 1], a[k, 2], a[k, 3], a[k, 4], a[k, 5], a[k, 6]


@compiled
def _all_sincos(q):
    # In one loop over all of them, which vectorises; the matrices after it do not need to.
    sine, cosine = np.empty(q.shape), np.empty(q.shape)
    sincos_kernel(q.reshape(-1), sine.reshape(-1), cosine.reshape(-1))
    return sine, cosine


@compiled(nogil=True)
def _batch_kernel(chain, q, X_FT, X_WT, J_WT):
    sine, cosine = _all_sincos(q)
    for k in range(len(q)):
        _pose_jacobian(_row(sine, k), _row(cosine, k), X_FT, X_WT[k], J_WT[k])


@compiled(nogil=True)
def _pose_batch_kernel(chain, q, X_FT, X_WT):
    sine, cosine = _all_sincos(q)
    for k in range(len(q)):
        _pose_jacobian(_row(sine, k), _row(cosine, k), X_FT, X_WT[k], None)


@compiled(nogil=True)
def _manipulability_batch_kernel(chain, q, out):
    sine, cosine = _all_sincos(q)
    for k in range(len(q)):
        out[k] = _manipulability(_row(sine, k), _row(cosine, k))


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
        q: Joint positions [rad], shape (..., 7), at most 2 pi in size.
        X_FT: Tool frame in the flange frame, shape (4, 4); the flange itself by default.
        arm: The arm.

    Returns:
        ``X_WT``, shape (..., 4, 4) [m], and ``J_WT``, shape (..., 6, 7), with rows
        [angular; linear] at the tool origin, expressed in the world. NaN positions give NaN.

    Raises:
        ArgumentError: ``q`` or ``X_FT`` has another shape; more than a whole turn (degrees?), or no
            pose.
    """
    q = arm.positions(q)
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
    q = arm.positions(q)
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
