"""What is known of an object's motion, and where it will be.

For the future, the filtered path of the last seconds (`feasigrasp.models.objects.pose_filter`) is
fitted, axis by axis, by the oscillator ``a = -omega^2 (p - c)``: straight and circular motion,
ellipses, swings. Its two parameters follow by least squares from differences over a lag h, for
which

    p(t + h) - 2 p(t) + p(t - h) = -kappa (p(t) - c),    kappa = 2 - 2 cos(omega h)

is exact. How fast the object is, is that of the oscillator through the last two seconds, as far as
it is on them. Where the path shows no oscillation, the axis goes on with its velocity and the mean
acceleration, which dies out. The orientation goes on with the mean angular velocity of the last
second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.se3_kernels import so3_exp_kernel, so3_log_kernel
from feasigrasp.models.objects.pose_filter import PATH_STEP, parts, pose_kernel, twist_kernel

#: The lag h, in steps of the path.
_LAG = 4
#: Points over which the angular velocity is averaged.
_TURN = 10
#: Deviation of the path from the oscillator that noise alone explains [m].
_PATH_NOISE = 2e-4
#: Slower than this [rad/s], nothing oscillates.
_STILL = 0.02
#: A mean acceleration dies out over this time [s].
_DYING = 1.5
#: Points of the path that say how fast the object is. It is on the oscillator as far as these are:
#: within this [m], and as much further as it moves in this time [s].
_RECENT, _ON_PATH, _IN_TIME = 20, 2e-3, 2.5e-3


@compiled
def _oscillator(path, count):
    """omega^2 [1/s^2] and mean acceleration term b of ``a = b - omega^2 p``, one axis.

    ``p`` is taken relative to the newest of the ``count`` points of the path.
    """
    n, h = count - 2 * _LAG, _LAG * PATH_STEP
    if n < _LAG:
        return 0.0, 0.0, False
    origin = path[0]
    s, y, ss, sy = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        first = path[k] - origin
        middle = path[k + _LAG] - origin
        last = path[k + 2 * _LAG] - origin
        change = first - 2.0 * middle + last
        s += middle
        y += change
        ss += middle * middle
        sy += middle * change
    s, y, ss, sy = s / n, y / n, ss / n, sy / n
    variance = ss - s * s
    kappa = -(sy - s * y) / (variance + (_PATH_NOISE / 0.05) ** 2)
    kappa = min(max(kappa, 0.0), 3.9)
    b = (y + kappa * s) / h**2
    omega = np.arccos(1.0 - 0.5 * kappa) / h
    # b is that of the differences; of the differential equation it is larger by this factor.
    factor = omega**2 * h**2 / kappa if kappa > 1e-9 else 1.0
    return omega**2, b * factor, True


@compiled
def _speed(path, count, age, square, b, p, v):
    """Velocity of one axis: ``v``, or that of the oscillator through the last points of the path.

    One of two seconds has much less noise than one of some images. Where the oscillator is not on
    the path, or not where the object is now, since it has turned or stopped, ``v`` is all there is.

    Args:
        path: The axis of the path, newest first.
        count: Number of its points.
        age: Of the newest one [s].
        square: omega^2 [1/s^2].
        b: See `_oscillator`.
        p: Where the object is now [m].
        v: What the filter has [m/s].
    """
    n, omega = min(count, _RECENT), np.sqrt(square)
    if n < 2 * _LAG or omega < _STILL:
        return v
    c = path[0] + b / square
    cc, cs, ss, cy, sy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        phase, y = -omega * (age + k * PATH_STEP), path[k] - c
        cosine, sine = np.cos(phase), np.sin(phase)
        cc, cs, ss = cc + cosine * cosine, cs + cosine * sine, ss + sine * sine
        cy, sy, yy = cy + cosine * y, sy + sine * y, yy + y * y
    determinant = cc * ss - cs * cs
    if determinant <= 1e-12:
        return v
    even, odd = (ss * cy - cs * sy) / determinant, (cc * sy - cs * cy) / determinant
    beside = max(yy - even * cy - odd * sy, 0.0) / n
    beside = max(beside, 0.5 * (p - c - even) ** 2)
    share = 1.0 / (1.0 + (beside / (_ON_PATH + _IN_TIME * abs(v)) ** 2) ** 2)
    return v + share * (omega * odd - v)


@compiled
def velocity_kernel(state, now, v):
    """Replaces a velocity ``v`` (3,) [m/s] of the object's origin, see `_speed`."""
    s, X = parts(state), np.empty((4, 4))
    pose_kernel(state, now, X)
    count, age = int(s.stored[0]), now - (s.due[0] - PATH_STEP)
    for i in range(3):
        square, b, _ = _oscillator(s.path[:, 0, i], count)
        v[i] = _speed(s.path[:, 0, i], count, age, square, b, X[i, 3], v[i])


@compiled
def predict_kernel(state, now, ahead, X):
    """Writes poses (k, 4, 4) at the times ``now + ahead``, shape (k,) [s]."""
    s = parts(state)
    start, V = np.empty((4, 4)), np.empty(6)
    pose_kernel(state, now, start)
    twist_kernel(state, now, V)
    w = V[:3].copy()
    count = int(s.stored[0])
    if count > _TURN:
        R_new, R_old = s.path[0, 1:].copy(), s.path[_TURN, 1:].copy()
        w[:] = so3_log_kernel(R_new @ R_old.T.copy()) / (_TURN * PATH_STEP)
    for k in range(len(ahead)):
        X[k] = start
        X[k, :3, :3] = so3_exp_kernel(w * ahead[k]) @ np.ascontiguousarray(start[:3, :3])
    age = now - (s.due[0] - PATH_STEP)
    for i in range(3):
        square, b, known = _oscillator(s.path[:, 0, i], count)
        p = start[i, 3] - s.path[0, 0, i]
        v = _speed(s.path[:, 0, i], count, age, square, b, start[i, 3], V[3 + i])
        omega = np.sqrt(square)
        for k in range(len(ahead)):
            t = ahead[k]
            if omega > _STILL:
                c = b / square
                x = c + (p - c) * np.cos(omega * t) + v / omega * np.sin(omega * t)
            else:
                a = b if known else 0.0
                # The acceleration a exp(-t / T), integrated twice.
                x = p + v * t + a * _DYING * (t - _DYING * (1.0 - np.exp(-t / _DYING)))
            X[k, i, 3] = s.path[0, 0, i] + x


@dataclass(frozen=True, eq=False)
class MotionEstimate(Frozen):
    """What is known of an object's motion at one time.

    Attributes:
        state: State of the filter, shape (STATE_SIZE,).
        time: The time [s].
    """

    state: Array
    time: float

    @property
    def known(self) -> bool:
        """Whether there has been a measurement."""
        return not np.isnan(self.state[0])

    def velocity(self, v_WO: ArrayLike) -> Array:
        """The velocity (3,) of O's origin [m/s] now, if that of a filter of its own is ``v_WO``.

        As far as the last two seconds are on one oscillator, it is that of the oscillator.
        """
        v = np.array(v_WO, dtype=float)
        velocity_kernel(self.state, self.time, v)
        return v

    def predict(self, ahead: ArrayLike) -> Array:
        """Poses (k, 4, 4) of the object in the world, ``ahead`` (k,) seconds from now."""
        times = np.ascontiguousarray(ahead, dtype=float).reshape(-1)
        X = np.empty((len(times), 4, 4))
        predict_kernel(self.state, self.time, times, X)
        return X


#: A pose this far from what a filter expects is not the one that it follows [m].
_ELSEWHERE = 0.05


def future_poses(
    motion: MotionEstimate | None, X_WO: Array, V_WO: Array, ahead: ArrayLike
) -> Array:
    """Poses (k, 4, 4) of the object ``ahead`` (k,) seconds from now.

    Args:
        motion: What the tracker knows; None if nothing. It predicts how the object goes on from
            ``X_WO``, which differs a little from where its filter has it.
        X_WO: Pose now, shape (4, 4). If it is not the one that ``motion`` follows, since the hand
            is to go somewhere else, it moves on with its twist.
        V_WO: Twist now [angular; linear], shape (6,).
        ahead: Times from now on [s].
    """
    times = np.asarray(ahead, dtype=float).reshape(-1)
    if motion is not None and motion.known:
        now, *later = motion.predict(np.concatenate([[0.0], times]))
        turn, step = now[:3, :3].T @ X_WO[:3, :3], X_WO[:3, 3] - now[:3, 3]
        if np.linalg.norm(step) < _ELSEWHERE:
            X = np.array(later).reshape(-1, 4, 4)
            X[:, :3, :3] = X[:, :3, :3] @ turn
            X[:, :3, 3] += step
            return X
    return np.array([se3.extrapolate(X_WO, V_WO, t) for t in times]).reshape(-1, 4, 4)
