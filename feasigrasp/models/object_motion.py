"""Motions of the object: harmonic translation with a constant rotation.

One formula covers the paper's circular, linear and sinusoidal tests: with the phase
``s = start_phase + rate t``, every coordinate is ``center + amplitude sin(harmonic s + offset)``,
while the object turns with constant speed about a fixed axis.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.se3 import so3_exp_kernel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class HarmonicMotion:
    """Where the object is at time t, in the world frame W (the robot's base).

    Attributes:
        center: Centre of the motion [m], 3 numbers.
        amplitude: Amplitude along x, y, z [m].
        harmonic: Multiple of the phase along x, y, z.
        offset_deg: Phase offset along x, y, z [deg]; 90 makes a cosine.
        rate: Phase rate [rad/s]; one lap lasts 2 pi / rate.
        start_phase: Phase at t = 0 [rad].
        spin_axis: Axis of the rotation, in W.
        spin: Rotation speed [rad/s].
        R_WO: Orientation at t = 0, shape (3, 3).
    """

    center: FloatArray
    amplitude: FloatArray
    harmonic: FloatArray
    offset_deg: FloatArray
    rate: float
    start_phase: float
    spin_axis: FloatArray
    spin: float
    R_WO: FloatArray = field(default_factory=lambda: np.eye(3))

    def _angles(self, t: float) -> FloatArray:
        phase = self.start_phase + self.rate * t
        return np.asarray(self.harmonic * phase + np.deg2rad(self.offset_deg))

    def angular_velocity(self) -> FloatArray:
        """Constant angular velocity w_WO [rad/s], shape (3,)."""
        axis = np.asarray(self.spin_axis, dtype=float)
        return np.asarray(self.spin * axis / np.linalg.norm(axis))

    def pose(self, t: float) -> FloatArray:
        """``X_WO`` at time t [s], shape (4, 4)."""
        X_WO = np.eye(4)
        X_WO[:3, :3] = so3_exp_kernel(self.angular_velocity() * t) @ self.R_WO
        X_WO[:3, 3] = self.center + self.amplitude * np.sin(self._angles(t))
        return X_WO

    def velocity(self, t: float) -> FloatArray:
        """``V_WO`` = [angular; linear] at time t, shape (6,)."""
        linear = self.amplitude * self.harmonic * self.rate * np.cos(self._angles(t))
        return np.concatenate([self.angular_velocity(), linear])

    def linear_acceleration(self, t: float) -> FloatArray:
        """Acceleration of the object's origin at time t [m/s^2], shape (3,)."""
        return np.asarray(
            -self.amplitude * (self.harmonic * self.rate) ** 2 * np.sin(self._angles(t))
        )
