"""Motions of the object: harmonic, or along Bezier curves with stops, with a constant rotation.

One formula covers the paper's circular, linear and sinusoidal tests: with the phase
``s = start_phase + rate t``, every coordinate is ``center + amplitude sin(harmonic s + offset)``,
while the object turns with constant speed about a fixed axis.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicSpline

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3 import so3_exp
from feasigrasp.models.geometry.se3_kernels import so3_exp_kernel
from feasigrasp.models.quantities import POINT, ArrayOf

#: A vector of three numbers. Source: layout.
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
        """Makes float arrays; raises ArgumentError where one has another shape or is none."""
        check_fields(self)
        if not self.spin_axis.any():
            raise ArgumentError("HarmonicMotion.spin_axis is zero; give a direction")

    @checked()
    def state(self, t: float) -> tuple[Array, Array, Array]:
        """``X_WO`` (4, 4), ``V_WO`` (6,) and the acceleration of the origin (3,) at time t [s]."""
        return motion_kernel(self.parameters, t)

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


#: How quickly the object gains speed after a stop, and loses it before one [m/s^2]. Source:
#: guessed.
ACCELERATION = 3.0


def bezier_legs(rng: np.random.Generator, center: Array, size: Array) -> Array:
    """Control points (16, 4, 3) [m] of cubic Bezier curves through random places of a box.

    The box has its middle at ``center`` (3,) and edges of ``size`` (3,) [m]. A Bezier curve stays
    in the convex hull of its control points, so the path stays in the box. Every leg starts where
    the one before ends, in another direction, and the last ends where the first starts.
    """
    count, low, high = 16, center - 0.5 * size, center + 0.5 * size
    places = [rng.uniform(low, high)]
    for _ in range(count - 1):
        # Number of places drawn for a leg, which goes to the farthest of them.
        drawn = rng.uniform(low, high, (4, 3))
        places.append(drawn[np.argmax(np.linalg.norm(drawn - places[-1], axis=1))])
    start, end = np.array(places), np.roll(places, -1, axis=0)
    way = end - start
    aside = rng.uniform(-1.0, 1.0, (2, count, 3)) / np.sqrt(3.0)
    # Inner control points are this far off the straight way at most, per length of it.
    aside *= 0.3 * np.linalg.norm(way, axis=1)[:, None]
    inner = start + way / 3.0 + aside[0], end - way / 3.0 + aside[1]
    return np.stack([start, *np.clip(inner, low, high), end], axis=1)


@dataclass(frozen=True, eq=False)
class BezierMotion(ObjectMotion):
    """From leg to leg, with a stop at each.

    On a leg the object gains speed with `ACCELERATION`, keeps ``speed`` along the curve and loses
    it again (a leg that is too short for that has a lower peak), then rests. After the last leg it
    begins anew. Beside that it turns with constant speed about a fixed axis.

    Attributes:
        legs: Control points of cubic Bezier curves, shape (n, 4, 3) [m].
        speed: On the legs [m/s].
        stop: Rest after each of them [s].
        spin_axis: Axis of the rotation, in W.
        spin: Rotation speed [rad/s].
        R_WO: Orientation at t = 0, shape (3, 3).
    """

    legs: Array
    speed: float
    stop: float
    spin_axis: Array
    spin: float
    R_WO: Array = field(default_factory=lambda: np.eye(3))

    def state(self, t: float) -> tuple[Array, Array, Array]:
        """``X_WO`` (4, 4), ``V_WO`` (6,) and the acceleration of the origin (3,) at time t [s].

        With the place c(s) at the length s of a leg, velocity and acceleration are ``c' s'`` and
        ``c'' s'^2 + c' s''``.
        """
        curves, starts = self._curves, self._starts
        t_lap = t % starts[-1]
        leg = min(int(np.searchsorted(starts, t_lap, side="right")) - 1, len(curves) - 1)
        curve = curves[leg]
        s, ds, dds = self._along(float(curve.x[-1]), t_lap - starts[leg])
        axis = np.asarray(self.spin_axis, dtype=float)
        omega = self.spin * axis / np.linalg.norm(axis)
        X, V = np.eye(4), np.empty(6)
        X[:3, :3] = so3_exp(omega * t) @ self.R_WO
        X[:3, 3] = curve(s)
        V[:3], V[3:] = omega, ds * curve(s, 1)
        return X, V, ds**2 * curve(s, 2) + dds * curve(s, 1)

    @cached_property
    def _curves(self) -> list[CubicSpline]:
        """The legs as functions of the length along them."""
        # Points of a leg at which its length is measured.
        u = np.linspace(0.0, 1.0, 200)[:, None]
        curves = []
        for a, b, c, d in self.legs:
            p = (1 - u) ** 3 * a + 3 * (1 - u) ** 2 * u * b + 3 * (1 - u) * u**2 * c + u**3 * d
            steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
            curves.append(CubicSpline(np.concatenate([[0.0], np.cumsum(steps)]), p))
        return curves

    @cached_property
    def _starts(self) -> Array:
        """When each leg begins, and when all of them are over [s], shape (n + 1,)."""
        times = [self._profile(float(c.x[-1]))[1:] for c in self._curves]
        durations = [ramp + keep + ramp + self.stop for ramp, keep in times]
        return np.concatenate([[0.0], np.cumsum(durations)])

    def _profile(self, length: float) -> tuple[float, float, float]:
        """Peak speed on a leg [m/s]; how long it gains, or loses, speed, and keeps it [s]."""
        peak = min(self.speed, float(np.sqrt(ACCELERATION * length)))
        ramp = peak / ACCELERATION
        return peak, ramp, length / peak - ramp

    def _along(self, length: float, t: float) -> tuple[float, float, float]:
        """Way along a leg at time t of it [m], and two derivatives by time."""
        peak, gain, keep = self._profile(length)
        if t < gain:
            return 0.5 * ACCELERATION * t**2, ACCELERATION * t, ACCELERATION
        if t < gain + keep:
            return peak * (t - 0.5 * gain), peak, 0.0
        left = max(0.0, 2.0 * gain + keep - t)
        rate = -ACCELERATION if left > 0.0 else 0.0
        return length - 0.5 * ACCELERATION * left**2, ACCELERATION * left, rate
