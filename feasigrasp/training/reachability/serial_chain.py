"""Forward kinematics and Jacobian of any serial chain of revolute and prismatic joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.geometry import se3


@dataclass(frozen=True, eq=False)
class SerialChain(Frozen):
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
        ReachabilityError: A joint has no finite limits.
    """

    X_PJ: Array
    axes: Array
    prismatic: Mask
    X_JE: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        """Freezes the arrays and checks the limits."""
        self._freeze(**{name: np.array(array) for name, array in vars(self).items()})
        bad = np.flatnonzero(~(np.isfinite(self.lower - self.upper) & (self.lower <= self.upper)))
        if len(bad):
            raise ReachabilityError(
                f"SerialChain: joint {bad[0]} has limits {self.lower[bad[0]]} ... "
                f"{self.upper[bad[0]]}; sampling needs finite ones, set them in the model file."
            )

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
        """
        q, sliding = np.asarray(q, dtype=float), self.prismatic[:, None]
        screws = np.concatenate([self.axes * ~sliding, self.axes * sliding], axis=1)
        X = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
        axes, points = np.empty((2, *q.shape, 3))
        for k in range(len(self.axes)):
            X = X @ self.X_PJ[k]
            axes[..., k, :], points[..., k, :] = X[..., :3, :3] @ self.axes[k], X[..., :3, 3]
            X = X @ se3.exp(q[..., k, None] * screws[k])
        X = X @ self.X_JE
        lever = X[..., None, :3, 3] - points
        J = np.concatenate(
            [np.where(sliding, 0.0, axes), np.where(sliding, axes, np.cross(axes, lever))], axis=-1
        )
        return X, J.swapaxes(-1, -2)
