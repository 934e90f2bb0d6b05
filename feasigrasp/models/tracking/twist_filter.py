"""Kalman filter for pose, twist and acceleration of a moving object on SE(3).

An error-state Kalman filter. The state is X_WO, V_WO = [w; v], the twist that `se3.extrapolate`
takes, and the acceleration a of O's origin; its error is ``e = [theta, p, dw, dv, da]`` with
``R_true = exp(theta) R`` and ``p_true = p_WO + p``, all in the axes of the world, so that

    theta' = theta + dt dw,    p' = p + dt dv + dt^2 / 2 da,    dv' = dv + dt da

The angular velocity is disturbed by white noise, and so is the acceleration. Along the way it dies
away soon (Singer's model), as starts and stops are short; an object that goes round keeps it. The
mean follows a circle: what of the acceleration is across the way turns with it, by the jerk
``-|a_across|^2 / |v|^2 v``. What a registration does not determine has no information in its
measurement, and stays at what the filter expects. While nothing is measured, twist and acceleration
die away: a wrong one must not lead the hand away. The covariance of the pose grows meanwhile as
that of an object whose velocity changes: wide enough to look for it where it may have gone, and no
wider, or what is found there would be anything.

References: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
sections 6.2, and 11.7 for turns; Singer, "Estimating optimal tracking filter performance for manned
maneuvering targets", IEEE Trans. AES 6 (4), 1970; Sola, Deray, Atchuthan, "A micro Lie theory for
state estimation in robotics", arXiv 1812.01537.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.geometry import se3

#: How quickly the angular velocity changes [rad/s in 1 s], and while nothing is measured the
#: velocity [m/s in 1 s]: square root of a density. Source: guessed.
_TWIST_NOISE = 0.1
#: What is known before the first image: standard deviation of the acceleration [m/s^2]. Source:
#: guessed.
_ACCELERATION_PRIOR = 1.5
#: A twist that is not measured dies away over this time [s]. Source: guessed.
DECAY = 0.6
#: Time constant of the acceleration along the way [s], and how quickly an acceleration changes
#: [m/s^2 in 1 s], the square root of a density. Source: measured: the errors of velocity on twelve
#: recorded runs with 0.02 to 0.1 s, and with 1 to 5.
_ALONG, JERK = 0.05, 1.5
#: Without an image the way turns for so long at most, and then goes straight on [s]. Source:
#: guessed.
_BENT = 0.1


@dataclass(frozen=True, eq=False)
class TwistFilter(Frozen):
    """An estimate at one time.

    Attributes:
        time: When [s].
        X_WO: Pose, shape (4, 4).
        V_WO: Twist [angular; linear] of O's origin, shape (6,).
        a_WO: Acceleration of O's origin, shape (3,).
        covariance: Of the error [theta, p, dw, dv, da], shape (15, 15).
    """

    time: float
    X_WO: Array
    V_WO: Array
    a_WO: Array
    covariance: Array

    def __post_init__(self) -> None:
        names = ("X_WO", "V_WO", "a_WO", "covariance")
        self._freeze(**{name: np.array(getattr(self, name), dtype=float) for name in names})

    @classmethod
    def at_rest(cls, time: float, X_WO: Array) -> TwistFilter:
        """Estimate at rest, with a given pose and unknown motion."""
        # The first image defines the frame, what is left is rounding [rad, m]; the twist may be
        # any of this size [rad/s, m/s].
        sigma = np.repeat((1e-3, 1e-4, 0.5, 0.4, _ACCELERATION_PRIOR), 3)
        return cls(time, X_WO, np.zeros(6), np.zeros(3), np.diag(sigma**2))

    @property
    def pose_covariance(self) -> Array:
        """Covariance of [theta, p], shape (6, 6)."""
        return self.covariance[:6, :6]

    @cached_property
    def _along(self) -> Array:
        """Projection on the direction of motion, shape (3, 3); all is along that of one at rest."""
        stands = 0.05  # slower than this, no direction is known [m/s]
        v = self.V_WO[3:]
        return np.eye(3) if v @ v < stands**2 else np.outer(v, v) / (v @ v)

    @cached_property
    def jerk(self) -> Array:
        """Rate of the acceleration on a circle, shape (3,) [m/s^3]: it turns with the path."""
        tightest = 6.0  # what seems to turn more quickly is noise [rad/s]
        v, across = self.V_WO[3:], self.a_WO - self._along @ self.a_WO
        return -min(float(across @ across) / max(float(v @ v), 1e-12), tightest**2) * v

    def _integrals(self, dt: float) -> tuple[Array, Array, Array]:
        """What is left of an acceleration after ``dt``, and its integrals once and twice, (3, 3).

        It is integrated for `_BENT` at most.
        """
        along, across, bent = self._along, np.eye(3) - self._along, min(dt, _BENT)
        gained = _ALONG * (1.0 - np.exp(-bent / _ALONG))
        way = _ALONG * (bent - gained) + (dt - bent) * gained
        return (
            np.exp(-dt / _ALONG) * along + across,
            gained * along + bent * across,
            way * along + bent * (dt - 0.5 * bent) * across,
        )

    def pose(self, time: float, *, coasting: bool = False) -> Array:
        """The pose expected at a time, shape (4, 4)."""
        dt = time - self.time
        X_WO = se3.extrapolate(self.X_WO, self.V_WO, _way(dt) if coasting else dt)
        if not coasting:
            bent = min(dt, _BENT)
            X_WO[:3, 3] += self._integrals(dt)[2] @ self.a_WO
            X_WO[:3, 3] += bent**2 * (dt / 2.0 - bent / 3.0) * self.jerk
        return X_WO

    def twist(self, time: float, *, coasting: bool = False) -> Array:
        """The twist expected at a time, shape (6,)."""
        dt = time - self.time
        V_WO = _kept(dt, coasting) * self.V_WO
        if not coasting:
            bent = min(dt, _BENT)
            V_WO[3:] += self._integrals(dt)[1] @ self.a_WO + 0.5 * bent**2 * self.jerk
        return V_WO

    def predicted(self, time: float, *, coasting: bool = False) -> TwistFilter:
        """The estimate at a later time [s], with nothing measured in between.

        The twist of an object that is ``coasting`` dies away.
        """
        dt = time - self.time
        if dt <= 0.0:
            return self
        F, turn = np.eye(15), np.zeros(3)
        F[:6, 6:12] = dt * np.eye(6)
        F[6:12, 6:12] = np.diag(_kept(dt, coasting))
        F[12:, 12:] = 0.0
        if not coasting:
            F[12:, 12:], F[9:12, 12:], F[3:6, 12:] = self._integrals(dt)
            turn = min(dt, _BENT) * self.jerk
        return TwistFilter(
            time,
            self.pose(time, coasting=coasting),
            self.twist(time, coasting=coasting),
            F[12:, 12:] @ self.a_WO + turn,
            F @ self.covariance @ F.T + _process_noise(dt, coasting),
        )

    def gone_on(self, X_WO: Array, V_WO: Array) -> TwistFilter:
        """The estimate moved to the pose and twist of a predicted path."""
        return replace(self, X_WO=X_WO, V_WO=V_WO, a_WO=np.zeros(3))

    def carried(self, before: TwistFilter, X_WO: Array) -> TwistFilter:
        """The estimate moved with a carrier from an earlier pose."""
        return self.gone_on(X_WO, pose_error(before.X_WO, X_WO) / (self.time - before.time))

    def measured(self, X_WO: Array, information: Array) -> TwistFilter:
        """The estimate after a registration that started from this one.

        It gave the most likely pose (4, 4), given the image and this estimate, and what the image
        alone says of [theta, p], (6, 6), which may be singular.
        """
        P = self.covariance
        error = pose_error(self.X_WO, X_WO)
        # The image is about the pose alone. With P_pp before and S after it, of the whole state
        # e+ = G e_p and P+ = P - G (P_pp - S) G^T, where G = P[:, p] P_pp^-1.
        before = P[:6, :6]
        after = np.linalg.inv(np.linalg.inv(before) + information)
        gain = np.linalg.solve(before, P[:6]).T
        motion = np.concatenate([self.V_WO, self.a_WO]) + (gain @ error)[6:]
        covariance = P - gain @ (before - after) @ gain.T
        covariance = 0.5 * (covariance + covariance.T)
        return replace(self, X_WO=X_WO, V_WO=motion[:6], a_WO=motion[6:], covariance=covariance)

    def widened(self, covariance: Array) -> TwistFilter:
        """The estimate with added covariance of the pose error [theta, p], (6, 6)."""
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


def _kept(dt: float, coasting: bool) -> Array:
    """What is left of a twist, shape (6,)."""
    # An object that is observed turns steadily for about so long [s]: keeps what no image
    # determines at rest.
    left = np.exp(-dt / (DECAY if coasting else 5.0))
    return np.repeat([left, left if coasting else 1.0], 3)


def _process_noise(dt: float, coasting: bool) -> Array:
    """Covariance (15, 15) of what white noise does to angular velocity and acceleration.

    Of one that coasts it disturbs the velocity, and the acceleration is not known any more.
    """
    # Of white noise: integrated once and twice.
    once = np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    twice = np.array(
        [
            [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
            [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
            [dt**3 / 6.0, dt**2 / 2.0, dt],
        ]
    )
    noise = np.zeros((5, 5))  # of theta, p, dw, dv and da, alike for all three axes
    noise[np.ix_([0, 2], [0, 2])] = _TWIST_NOISE**2 * once
    if coasting:
        noise[np.ix_([1, 3], [1, 3])] = _TWIST_NOISE**2 * once
        noise[4, 4] = _ACCELERATION_PRIOR**2
    else:
        noise[np.ix_([1, 3, 4], [1, 3, 4])] = JERK**2 * twice
    return np.asarray(np.kron(noise, np.eye(3)))
