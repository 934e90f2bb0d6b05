"""Motions of the object: harmonic translation with a constant rotation.

One formula covers the paper's circular, linear and sinusoidal tests: with the phase
``s = start_phase + rate t``, every coordinate is ``center + amplitude sin(harmonic s + offset)``,
while the object turns with constant speed about a fixed axis.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import so3_exp_kernel
from feasigrasp.models.quantities import POINT, ArrayOf

_THREE, _ROTATION = ArrayOf((3,)), ArrayOf((3, 3), rotation=True)


class ObjectMotion:
    """Base class of object motions: pose at time t in the world frame W (the robot's base)."""

    def state(self, t: float) -> tuple[Array, Array, Array]:
        """``X_WO`` (4, 4), ``V_WO`` (6,) and the acceleration of the origin (3,) at time t [s]."""
        raise NotImplementedError

    def pose(self, t: float) -> Array:
        """``X_WO`` at time t [s], shape (4, 4)."""
        return self.state(t)[0]

    def velocity(self, t: float) -> Array:
        """``V_WO`` = [angular; linear] at time t [s], shape (6,)."""
        return self.state(t)[1]


@dataclass(frozen=True)
class HarmonicMotion(ObjectMotion):
    """A circle, a line or a wave: every coordinate is a sine of the phase; with a constant turn.

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

    center: Annotated[Array, POINT]
    amplitude: Annotated[Array, POINT]
    harmonic: Annotated[Array, _THREE]
    offset_deg: Annotated[Array, _THREE]
    rate: float
    start_phase: float
    spin_axis: Annotated[Array, _THREE]
    spin: float
    R_WO: Annotated[Array, _ROTATION] = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        """Makes float arrays of whatever was given.

        Raises:
            ArgumentError: An entry has another shape or is not finite, ``R_WO`` is no rotation, or
                ``spin_axis`` is zero.
        """
        check_fields(self)
        if not self.spin_axis.any():
            raise ArgumentError("HarmonicMotion.spin_axis is zero; give a direction")

    @checked()
    def state(self, t: float) -> tuple[Array, Array, Array]:
        """``X_WO`` (4, 4), ``V_WO`` (6,) and the acceleration of the origin (3,) at time t [s]."""
        X_WO, V_WO, acceleration = motion_kernel(self.parameters, t)
        return X_WO, V_WO, acceleration

    @cached_property
    def parameters(self) -> Array:
        """All numbers in one array, for `motion_kernel`, shape (26,)."""
        return np.concatenate(
            [
                self.center,
                self.amplitude,
                self.harmonic,
                np.deg2rad(self.offset_deg),
                [self.rate, self.start_phase],
                self.spin * self.spin_axis / np.linalg.norm(self.spin_axis),
                self.R_WO.ravel(),
            ]
        )


@compiled
def motion_kernel(parameters, t):
    """Pose, twist and acceleration of `HarmonicMotion.state` from its parameters."""
    center, amplitude, harmonic = parameters[0:3], parameters[3:6], parameters[6:9]
    offset, rate, start_phase = parameters[9:12], parameters[12], parameters[13]
    omega, R_WO = parameters[14:17], parameters[17:26].copy().reshape(3, 3)
    X, V, a = np.eye(4), np.empty(6), np.empty(3)
    X[:3, :3] = so3_exp_kernel(omega * t) @ R_WO
    for i in range(3):
        speed = harmonic[i] * rate
        angle = harmonic[i] * start_phase + speed * t + offset[i]
        X[i, 3] = center[i] + amplitude[i] * np.sin(angle)
        V[i] = omega[i]
        V[3 + i] = amplitude[i] * speed * np.cos(angle)
        a[i] = -amplitude[i] * speed**2 * np.sin(angle)
    return X, V, a
