"""Motions of the object: harmonic translation with a constant rotation.

One formula covers the paper's circular, linear and sinusoidal tests: with the phase
``s = start_phase + rate t``, every coordinate is ``center + amplitude sin(harmonic s + offset)``,
while the object turns with constant speed about a fixed axis.
"""

from dataclasses import dataclass, field

import numba as nb
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

    def __post_init__(self) -> None:
        """Makes float arrays of whatever was given."""
        for name in ("center", "amplitude", "harmonic", "offset_deg", "spin_axis", "R_WO"):
            array = np.array(getattr(self, name), dtype=float)
            object.__setattr__(self, name, array)

    def state(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``X_WO`` (4, 4), ``V_WO`` (6,) and the acceleration of the origin (3,) at time t [s]."""
        X_WO, V_WO, acceleration = _motion_kernel(
            self.center,
            self.amplitude,
            self.harmonic,
            self.offset_deg,
            self.rate,
            self.start_phase + self.rate * t,
            self.spin_axis,
            self.spin,
            self.R_WO,
            t,
        )
        return X_WO, V_WO, acceleration

    def pose(self, t: float) -> FloatArray:
        """``X_WO`` at time t [s], shape (4, 4)."""
        return self.state(t)[0]

    def velocity(self, t: float) -> FloatArray:
        """``V_WO`` = [angular; linear] at time t, shape (6,)."""
        return self.state(t)[1]


@nb.njit(cache=True)
def _motion_kernel(  # type: ignore[no-untyped-def]
    center, amplitude, harmonic, offset_deg, rate, phase, spin_axis, spin, R_WO, t
):
    X, V, a = np.eye(4), np.empty(6), np.empty(3)
    omega = spin / np.sqrt(np.sum(spin_axis**2)) * spin_axis
    X[:3, :3] = so3_exp_kernel(omega * t) @ R_WO
    for i in range(3):
        angle, speed = harmonic[i] * phase + np.deg2rad(offset_deg[i]), harmonic[i] * rate
        X[i, 3] = center[i] + amplitude[i] * np.sin(angle)
        V[i] = omega[i]
        V[3 + i] = amplitude[i] * speed * np.cos(angle)
        a[i] = -amplitude[i] * speed**2 * np.sin(angle)
    return X, V, a
