"""Object motion along Bezier curves with stops and turns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3 import so3_exp
from feasigrasp.models.objects.motion import ObjectMotion

#: How quickly the object gains speed after a stop, and loses it before one [m/s^2].
ACCELERATION = 3.0
#: Points of a leg at which its length is measured.
_POINTS = 200
#: Of so many places that are drawn, a leg goes to the farthest.
_CHOICE = 4
#: Inner control points are this far off the straight way at most, per length of it.
_BEND = 0.3


def bezier_legs(rng: np.random.Generator, center: Array, size: Array, count: int = 16) -> Array:
    """Control points of cubic Bezier curves through random places of a box, back to the first.

    A Bezier curve stays in the convex hull of its control points, so the path stays in the box.

    Args:
        rng: Draws them.
        center: Middle of the box, shape (3,) [m].
        size: Its edges, shape (3,) [m].
        count: How many legs.

    Returns:
        Shape (count, 4, 3) [m]; every leg starts where the one before ends, in another direction.
    """
    low, high = center - 0.5 * size, center + 0.5 * size
    places = [rng.uniform(low, high)]
    for _ in range(count - 1):
        drawn = rng.uniform(low, high, (_CHOICE, 3))
        places.append(drawn[np.argmax(np.linalg.norm(drawn - places[-1], axis=1))])
    start, end = np.array(places), np.roll(places, -1, axis=0)
    way = end - start
    aside = rng.uniform(-1.0, 1.0, (2, count, 3)) / np.sqrt(3.0)
    aside *= _BEND * np.linalg.norm(way, axis=1)[:, None]
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
        u = np.linspace(0.0, 1.0, _POINTS)[:, None]
        curves = []
        for a, b, c, d in self.legs:
            p = (1 - u) ** 3 * a + 3 * (1 - u) ** 2 * u * b + 3 * (1 - u) * u**2 * c + u**3 * d
            steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
            curves.append(CubicSpline(np.concatenate([[0.0], np.cumsum(steps)]), p))
        return curves

    @cached_property
    def _starts(self) -> Array:
        """When each leg begins, and when all of them are over [s], shape (n + 1,)."""
        durations = [sum(self._profile(float(c.x[-1]))[1:]) + self.stop for c in self._curves]
        return np.concatenate([[0.0], np.cumsum(durations)])

    def _profile(self, length: float) -> tuple[float, float, float, float]:
        """Peak speed on a leg [m/s]; how long it gains, keeps and loses speed [s]."""
        peak = min(self.speed, float(np.sqrt(ACCELERATION * length)))
        ramp = peak / ACCELERATION
        return peak, ramp, length / peak - ramp, ramp

    def _along(self, length: float, t: float) -> tuple[float, float, float]:
        """Way along a leg at time t of it [m], and two derivatives by time."""
        peak, gain, keep, _ = self._profile(length)
        if t < gain:
            return 0.5 * ACCELERATION * t**2, ACCELERATION * t, ACCELERATION
        if t < gain + keep:
            return peak * (t - 0.5 * gain), peak, 0.0
        left = max(0.0, 2.0 * gain + keep - t)
        rate = -ACCELERATION if left > 0.0 else 0.0
        return length - 0.5 * ACCELERATION * left**2, ACCELERATION * left, rate
