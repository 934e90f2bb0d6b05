"""Pose and twist of an object that turns and moves steadily, with what is known of them.

An error-state Kalman filter. The state is X_WO and V_WO = [w; v], the twist that `se3.extrapolate`
takes; its error is ``e = [theta, p, dw, dv]`` with ``R_true = exp(theta) R`` and
``p_true = p_WO + p``, all in the axes of the world, so that

    theta' = theta + dt dw,    p' = p + dt dv

and the twist is disturbed by white noise. What a registration does not determine has no
information in its measurement, and stays at what the filter expects. While nothing is measured, the
twist dies away: a wrong one must not carry the hand off.

Reference: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
section 6.2; Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics",
arXiv 1812.01537.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.geometry import se3

#: How quickly the twist changes [rad/s, m/s in 1 s]: square roots of densities.
TWIST_NOISE = (0.1, 0.1)
#: What is known before the first image: standard deviations of the twist [rad/s, m/s].
TWIST_PRIOR = (0.5, 0.25)
#: The first image defines the frame; what is left is rounding [rad, m].
_POSE_PRIOR = (1e-3, 1e-4)
#: A twist that is not measured dies away over this time [s] ...
DECAY = 0.6
#: ... and one that is turns steadily for about so long [s]: keeps what no image determines at rest.
_STEADY = 5.0


@dataclass(frozen=True, eq=False)
class TwistFilter(Frozen):
    """An estimate at one time.

    Attributes:
        time: When [s].
        X_WO: Pose, shape (4, 4).
        V_WO: Twist [angular; linear] of O's origin, shape (6,).
        covariance: Of the error [theta, p, dw, dv], shape (12, 12).
    """

    time: float
    X_WO: Array
    V_WO: Array
    covariance: Array

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        names = ("X_WO", "V_WO", "covariance")
        self._freeze(**{name: np.array(getattr(self, name), dtype=float) for name in names})

    @classmethod
    def at_rest(cls, time: float, X_WO: Array) -> TwistFilter:
        """An object whose pose is known, and of whose motion nothing is."""
        sigma = np.repeat([*_POSE_PRIOR, *TWIST_PRIOR], 3)
        return cls(time, X_WO, np.zeros(6), np.diag(sigma**2))

    @property
    def pose_covariance(self) -> Array:
        """Covariance of [theta, p], shape (6, 6)."""
        return self.covariance[:6, :6]

    def pose(self, time: float, *, coasting: bool = False) -> Array:
        """The pose expected at a time, shape (4, 4)."""
        dt = time - self.time
        return se3.extrapolate(self.X_WO, self.V_WO, _way(dt) if coasting else dt)

    def predicted(self, time: float, *, coasting: bool = False) -> TwistFilter:
        """The estimate at a later time, with nothing measured in between.

        Args:
            time: When [s].
            coasting: Whether the twist dies away.
        """
        dt = time - self.time
        if dt <= 0.0:
            return self
        left = np.exp(-dt / (DECAY if coasting else _STEADY))
        keep = np.repeat([left, left if coasting else 1.0], 3)
        F = np.eye(12)
        F[:6, 6:] = dt * np.eye(6)
        F[6:, 6:] = np.diag(keep)
        density = np.repeat(np.square(TWIST_NOISE), 3)
        Q = np.zeros((12, 12))
        steps = np.arange(6)
        Q[steps, steps] = density * dt**3 / 3.0
        Q[steps, steps + 6] = Q[steps + 6, steps] = density * dt**2 / 2.0
        Q[steps + 6, steps + 6] = density * dt
        return TwistFilter(
            time,
            self.pose(time, coasting=coasting),
            keep * self.V_WO,
            F @ self.covariance @ F.T + Q,
        )

    def carried(self, before: TwistFilter, X_WO: Array) -> TwistFilter:
        """The same estimate at the pose that something has carried it to from an earlier one."""
        V_WO = pose_error(before.X_WO, X_WO) / (self.time - before.time)
        return replace(self, X_WO=X_WO, V_WO=V_WO)

    def measured(self, X_WO: Array, information: Array) -> TwistFilter:
        """The estimate after a registration that started from this one.

        Args:
            X_WO: The most likely pose, given the image and this estimate, shape (4, 4).
            information: What the image alone says of [theta, p], shape (6, 6); may be singular.
        """
        P = self.covariance
        error = pose_error(self.X_WO, X_WO)
        # The image is about the pose alone. With P_pp before and S after it, of the whole state
        # e+ = G e_p and P+ = P - G (P_pp - S) G^T, where G = P[:, p] P_pp^-1.
        before = P[:6, :6]
        after = np.linalg.inv(np.linalg.inv(before) + information)
        gain = np.linalg.solve(before, P[:6]).T
        twist = self.V_WO + (gain @ error)[6:]
        covariance = P - gain @ (before - after) @ gain.T
        return replace(self, X_WO=X_WO, V_WO=twist, covariance=0.5 * (covariance + covariance.T))

    def widened(self, covariance: Array) -> TwistFilter:
        """The same with a further covariance of the pose's error [theta, p], (6, 6)."""
        P = self.covariance.copy()
        P[:6, :6] += covariance
        return replace(self, covariance=P)


def pose_error(X_expected: Array, X: Array) -> Array:
    """[theta, p] of ``X`` relative to what was expected, shape (6,)."""
    theta = se3.so3_log(X[:3, :3] @ X_expected[:3, :3].T)
    return np.concatenate([theta, X[:3, 3] - X_expected[:3, 3]])


def moved(X: Array, error: Array) -> Array:
    """The pose (4, 4) that is [theta, p] away from ``X``; the inverse of `pose_error`."""
    return se3.make_pose(se3.so3_exp(error[:3]) @ X[:3, :3], X[:3, 3] + error[3:])


def _way(dt: float) -> float:
    """Time that a steady motion takes as far as one that dies away goes in ``dt`` [s]."""
    return float(DECAY * (1.0 - np.exp(-dt / DECAY)))
