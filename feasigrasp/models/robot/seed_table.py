"""Random configurations of an arm with their flange poses: seeds of inverse kinematics."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3


def seed_table(axes: Array, points: Array, X_WF: Array, lower: Array, upper: Array) -> Array:
    """Columns of `Arm.chain` that hold seeds, shape (n + 1, 2 m).

    The first m are features of their flange poses: place [m], then quaternion, in 7 rows. The
    second m are their joint positions [rad], uniform between ``lower`` and ``upper``.
    """
    m, n = 4000, len(axes)
    Q = np.random.default_rng(0).uniform(lower, upper, (m, n))
    R, p = np.broadcast_to(np.eye(3), (m, 3, 3)), np.zeros((m, 3))
    for angle, axis, point in zip(Q.T, axes, points, strict=True):
        turn = se3.so3_exp(angle[:, None] * axis)
        p = p + np.einsum("mij,mj->mi", R, point - turn @ point)
        R = R @ turn
    X = np.tile(np.eye(4), (m, 1, 1))
    X[:, :3, :3], X[:, :3, 3] = R @ X_WF[:3, :3], p + R @ X_WF[:3, 3]
    table = np.zeros((n + 1, 2 * m))
    table[:3, :m], table[3:7, :m], table[:n, m:] = X[:, :3, 3].T, se3.quaternions(X).T, Q.T
    return table
