"""Forward kinematics and Jacobian of any serial chain of revolute and prismatic joints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arrays import Array, Mask


@njit(cache=True, nogil=True)
def _multiply(X, Y):
    """X <- X Y for poses (4, 4)."""
    for i in range(3):
        a, b, c, d = X[i, 0], X[i, 1], X[i, 2], X[i, 3]
        for j in range(4):
            X[i, j] = a * Y[0, j] + b * Y[1, j] + c * Y[2, j]
        X[i, 3] += d


@njit(cache=True, nogil=True)
def chain_kernel(q, X_PJ, axes, prismatic, X_JE, X, J):
    """Writes the pose (4, 4) of the end frame and its Jacobian (6, n) for joint positions (n,).

    The Jacobian maps joint speeds to the end frame's [angular; linear] velocity, in the base frame.
    """
    motion = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            X[i, j] = 1.0 if i == j else 0.0
    for k in range(len(q)):
        _multiply(X, X_PJ[k])
        x, y, z = axes[k, 0], axes[k, 1], axes[k, 2]
        for i in range(3):
            along = X[i, 0] * x + X[i, 1] * y + X[i, 2] * z
            if prismatic[k]:
                J[i, k], J[3 + i, k] = 0.0, along
                X[i, 3] += q[k] * along
            else:
                # Until the end is known, the lower half holds the joint's position.
                J[i, k], J[3 + i, k] = along, X[i, 3]
        if prismatic[k]:
            continue
        s, c = math.sin(q[k]), math.cos(q[k])
        v = 1.0 - c
        motion[0, 0], motion[0, 1], motion[0, 2] = (
            c + v * x * x,
            v * x * y - s * z,
            v * x * z + s * y,
        )
        motion[1, 0], motion[1, 1], motion[1, 2] = (
            v * x * y + s * z,
            c + v * y * y,
            v * y * z - s * x,
        )
        motion[2, 0], motion[2, 1], motion[2, 2] = (
            v * x * z - s * y,
            v * y * z + s * x,
            c + v * z * z,
        )
        motion[0, 3] = motion[1, 3] = motion[2, 3] = 0.0
        _multiply(X, motion)
    _multiply(X, X_JE)
    for k in range(len(q)):
        if not prismatic[k]:
            ax, ay, az = J[0, k], J[1, k], J[2, k]
            dx, dy, dz = X[0, 3] - J[3, k], X[1, 3] - J[4, k], X[2, 3] - J[5, k]
            J[3, k], J[4, k], J[5, k] = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx


@njit(cache=True, nogil=True)
def _batch(Q, X_PJ, axes, prismatic, X_JE, X, J):
    for k in range(len(Q)):
        chain_kernel(Q[k], X_PJ, axes, prismatic, X_JE, X[k], J[k])


@dataclass(frozen=True, eq=False)
class SerialChain:
    """A chain of n joints from a base frame to an end frame.

    Attributes:
        X_PJ: Frame of each joint at position 0 in the frame that the joint before it moves (in the
            base frame for the first), shape (n, 4, 4) [m].
        axes: Unit axes in these frames, shape (n, 3).
        prismatic: Whether a joint slides along its axis instead of turning about it, shape (n,).
        X_JE: End frame in the frame that the last joint moves, shape (4, 4) [m].
        lower: Lower limits, shape (n,) [rad or m].
        upper: Upper limits, shape (n,) [rad or m].

    Raises:
        ReachabilityError: The shapes disagree, or a joint has no finite limits.
    """

    X_PJ: Array
    axes: Array
    prismatic: Mask
    X_JE: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        """Checks and freezes the arrays."""
        n = len(self.axes)
        shapes: dict[str, tuple[tuple[int, ...], Any]] = {
            "X_PJ": ((n, 4, 4), float),
            "axes": ((n, 3), float),
            "prismatic": ((n,), bool),
            "X_JE": ((4, 4), float),
            "lower": ((n,), float),
            "upper": ((n,), float),
        }
        for name, (shape, dtype) in shapes.items():
            array = np.array(getattr(self, name), dtype=dtype)
            if array.shape != shape or n == 0:
                raise ReachabilityError(
                    f"SerialChain.{name} has shape {array.shape}, expected {shape} for {n} joints."
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        bad = np.flatnonzero(~(np.isfinite(self.lower - self.upper) & (self.lower <= self.upper)))
        if len(bad):
            raise ReachabilityError(
                f"SerialChain: joint {bad[0]} has limits {self.lower[bad[0]]} ... "
                f"{self.upper[bad[0]]}; sampling needs finite ones, set them in the model file."
            )

    def __len__(self) -> int:
        """Number of joints n."""
        return len(self.axes)

    def forward_kinematics(self, q: ArrayLike) -> Array:
        """Poses of the end frame in the base frame, shape (..., 4, 4), of positions (..., n)."""
        return self.pose_and_jacobian(q)[0]

    def manipulability(self, q: ArrayLike) -> Array:
        """Yoshikawa's measure sqrt(det J J^T), shape (...); 0 with fewer than six joints."""
        J = self.pose_and_jacobian(q)[1]
        return np.asarray(np.sqrt(np.maximum(np.linalg.det(J @ J.swapaxes(-1, -2)), 0.0)))

    def pose_and_jacobian(self, q: ArrayLike) -> tuple[Array, Array]:
        """Pose and geometric Jacobian of the end frame in the base frame.

        Args:
            q: Joint positions, shape (..., n) [rad or m].

        Returns:
            Poses, shape (..., 4, 4) [m], and Jacobians, shape (..., 6, n), with rows
            [angular; linear] at the end frame's origin.

        Raises:
            ValueError: The last axis of ``q`` is not n long.
        """
        q, n = np.asarray(q, dtype=float), len(self)
        if q.shape[-1:] != (n,):
            raise ValueError(f"joint positions need {n} entries in the last axis, got {q.shape}")
        flat = np.ascontiguousarray(q.reshape(-1, n))
        X, J = np.empty((len(flat), 4, 4)), np.empty((len(flat), 6, n))
        _batch(flat, self.X_PJ, self.axes, self.prismatic, self.X_JE, X, J)
        return X.reshape(*q.shape[:-1], 4, 4), J.reshape(*q.shape[:-1], 6, n)
