"""Motion estimate of an object, and predicted poses.

For the future, the filtered path of the last seconds (`feasigrasp.models.objects.pose_filter`) is
fitted, axis by axis, by an oscillation: straight and
circular motion, ellipses, swings. How fast the object is, is that of the oscillation, as far as it
is on it. Where the path shows no oscillation, the axis goes on with its velocity and the mean
acceleration, which dies out. The orientation goes on with the mean angular velocity of the last
second.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.se3_kernels import so3_exp_kernel, so3_log_kernel
from feasigrasp.models.objects.pose_filter import PATH_STEP, parts, pose_kernel, twist_kernel

# Fit of an oscillation about a drifting mean, for one axis.
#
# With the time t from the newest point of the path on, and
#
#     S(t) = sin(omega t) / omega,    C(t) = (1 - cos(omega t)) / omega^2
#
# the axis is ``p(t) = p + v S(t) + a C(t) + d (t - S(t))``: a line, a circle, an ellipse or a
# swing, whose middle moves on with the velocity d. A tracker whose model of the object improves
# corrects itself slowly, and what it follows drifts. Where omega is small, C is ``t^2 / 2``, and
# the path a parabola.
#
# The parameters follow by weighted least squares from the points of the path; older ones count
# less. Of omega the first guess comes from differences over a lag h, for which
#
#     p(t + h) - 2 p(t) + p(t - h) = -kappa (p(t) - c),    kappa = 2 - 2 cos(omega h)
#
# is exact without a drift, but biased by noise; Gauss-Newton steps refine it.

#: The lag h, in steps of the path. Source: guessed.
_LAG = 4
#: Deviation of the path from the oscillation that noise alone explains [m]: of the differences, and
#: of a tracker. Source: guessed.
_PATH_NOISE, _NOISE = 2e-4, 1.5e-3
#: Slower than this [rad/s], nothing oscillates. Source: guessed.
STILL = 0.02


class Oscillation(NamedTuple):
    """One axis of a path, see above; p is relative to its newest point.

    Attributes:
        omega: [rad/s], at least `STILL`.
        p: [m].
        v: [m/s].
        a: [m/s^2].
        drift: d [m/s].
        beside: Mean square distance of the path from it [m^2]; infinite for a path that is too
            short.
        mean: Mean acceleration of a path that does not oscillate [m/s^2], zero of one that does.
    """

    omega: float
    p: float
    v: float
    a: float
    drift: float
    beside: float
    mean: float


@compiled
def _guess(path, count):
    """The first guess of omega [rad/s], and the mean acceleration [m/s^2] where that is zero."""
    n, h, origin = count - 2 * _LAG, _LAG * PATH_STEP, path[0]
    s, y, ss, sy = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        middle = path[k + _LAG] - origin
        change = path[k] - path[k + _LAG] - (path[k + _LAG] - path[k + 2 * _LAG])
        s += middle
        y += change
        ss += middle * middle
        sy += middle * change
    s, y, ss, sy = s / n, y / n, ss / n, sy / n
    variance = ss - s * s
    kappa = -(sy - s * y) / (variance + (_PATH_NOISE / 0.05) ** 2)
    kappa = min(max(kappa, 0.0), 3.9)
    return np.arccos(1.0 - 0.5 * kappa) / h, (y + kappa * s) / h**2


@compiled
def shape_kernel(omega, t):
    """S, C and cos(omega t)."""
    cosine, sine = np.cos(omega * t), np.sin(omega * t) / omega
    return sine, (1.0 - cosine) / omega**2, cosine


@compiled
def oscillation_kernel(path, count):
    """The `Oscillation` of the ``count`` points of one axis, newest first."""
    # What is known of the drift [m/s], and of omega after the first guess, as a share of it.
    drift_sigma, omega_share = 0.02, 0.1
    # Gauss-Newton steps, and the change of omega they may lead to at most, as a factor.
    steps, farthest = 3, 1.3
    # Points count e times less after so long [s]: objects stop and turn.
    fades = 0.6
    if count < 3 * _LAG:
        return Oscillation(STILL, 0.0, 0.0, 0.0, 0.0, np.inf, 0.0)
    guess, mean = _guess(path, count)
    swings = guess > STILL
    omega = first = guess if swings else STILL
    x, columns = np.zeros(5), np.empty(5)
    M, y = np.empty((5, 5)), np.empty(5)
    for step in range(steps + 1 if swings else 1):
        M[:], y[:] = 0.0, 0.0
        M[3, 3] = (_NOISE / drift_sigma) ** 2
        M[4, 4] = (_NOISE / (omega_share * first)) ** 2
        y[4] = M[4, 4] * (first - omega)
        for k in range(count):
            t = -k * PATH_STEP
            weight = np.exp(t / fades)
            S, C, cosine = shape_kernel(omega, t)
            columns[0], columns[1], columns[2], columns[3] = 1.0, S, C, t - S
            # d/d omega, at what was found before; at first that is nothing. At last omega stays.
            columns[4] = ((x[1] - x[3]) * (t * cosine - S) + x[2] * (t * S - 2.0 * C)) / omega
            columns[4] *= step < steps
            for i in range(5):
                y[i] += weight * columns[i] * (path[k] - path[0])
                for j in range(5):
                    M[i, j] += weight * columns[i] * columns[j]
        x[:] = np.linalg.solve(M, y)
        if step < steps and swings:
            omega = min(max(omega + x[4], first / farthest), first * farthest)
    beside, weights = 0.0, 0.0
    for k in range(count):
        t = -k * PATH_STEP
        weight = np.exp(t / fades)
        S, C, _ = shape_kernel(omega, t)
        off = path[k] - path[0] - x[0] - x[1] * S - x[2] * C - x[3] * (t - S)
        beside += weight * off * off
        weights += weight
    return Oscillation(omega, x[0], x[1], x[2], x[3], beside / weights, 0.0 if swings else mean)


@compiled
def _now(known, age, p, v):
    """Velocity and acceleration of one axis, by the `Oscillation` that is known of its path.

    The velocity is that of the filter, ``v`` [m/s], or that of the oscillation: one of two seconds
    has much less noise than one of some images. Where the oscillation is not on the path, or not
    where the object is now, since it has turned or stopped, ``v`` is all there is. The object is at
    ``p`` [m] relative to the newest point of the path, of the ``age`` [s].
    """
    # An object is on the oscillation of its path as far as it, and the path, are within this [m],
    # and as much further as it moves in this time [s].
    on_path, in_time = 2e-3, 2.5e-3
    S, C, cosine = shape_kernel(known.omega, age)
    beside = known.p + known.v * S + known.a * C + known.drift * (age - S) - p
    beside = max(known.beside, 0.5 * beside**2)
    share = 1.0 / (1.0 + (beside / (on_path + in_time * abs(v)) ** 2) ** 2)
    v += share * (known.v * cosine + known.a * S + known.drift * (1.0 - cosine) - v)
    middle = known.p + known.a / known.omega**2 + known.drift * age
    return v, known.omega**2 * (middle - p)


@compiled
def velocity_kernel(state, now, X, v):
    """Replaces a velocity ``v`` (3,) [m/s] of the origin of an object at ``X``, see `_now`."""
    s = parts(state)
    count, age = int(s.stored[0]), now - (s.due[0] - PATH_STEP)
    for i in range(3):
        known = oscillation_kernel(s.path[:, 0, i], count)
        v[i], _ = _now(known, age, X[i, 3] - s.path[0, 0, i], v[i])


@compiled
def predict_kernel(state, now, start, v_WO, ahead, X):
    """Writes poses (k, 4, 4) at the times ``now + ahead``, shape (k,) [s].

    ``start`` (4, 4) is the pose now; ``v_WO`` (3,) is how fast the object is where it is not on an
    oscillation [m/s].
    """
    # A mean acceleration dies out over this time [s].
    dying = 1.5
    # Points over which the angular velocity is averaged.
    turn = 10
    s = parts(state)
    V = np.empty(6)
    twist_kernel(state, now, V)
    w = V[:3].copy()
    count = int(s.stored[0])
    if count > turn:
        R_new, R_old = s.path[0, 1:].copy(), s.path[turn, 1:].copy()
        w[:] = so3_log_kernel(R_new @ R_old.T.copy()) / (turn * PATH_STEP)
    for k in range(len(ahead)):
        X[k] = start
        X[k, :3, :3] = so3_exp_kernel(w * ahead[k]) @ np.ascontiguousarray(start[:3, :3])
    age = now - (s.due[0] - PATH_STEP)
    for i in range(3):
        known = oscillation_kernel(s.path[:, 0, i], count)
        v, a = _now(known, age, start[i, 3] - s.path[0, 0, i], v_WO[i])
        for k in range(len(ahead)):
            t = ahead[k]
            if known.omega > STILL:
                S, C, _ = shape_kernel(known.omega, t)
                X[k, i, 3] += v * S + a * C + known.drift * (t - S)
            else:
                # The acceleration exp(-t / T), integrated twice.
                bent = dying * (t - dying * (1.0 - np.exp(-t / dying)))
                X[k, i, 3] += v * t + known.mean * bent


class Motion(Protocol):
    """Interface of motion predictors."""

    @property
    def known(self) -> bool:
        """Whether a prediction is available."""

    def predict(self, ahead: ArrayLike, v_WO: ArrayLike | None = None) -> Array:
        """Poses (k, 4, 4) of the object at times (k,) [s] from now, see `MotionEstimate`."""


@dataclass(frozen=True, eq=False)
class MotionEstimate(Frozen):
    """Motion estimate of an object at one time.

    Attributes:
        state: State of the filter, shape (STATE_SIZE,).
        time: The time [s].
        X_WO: Pose then, where a filter of its own follows it more closely, shape (4, 4).
    """

    state: Array
    time: float
    X_WO: Array | None = None

    @property
    def known(self) -> bool:
        """Whether there has been a measurement."""
        return not np.isnan(self.state[0])

    def velocity(self, v_WO: ArrayLike) -> Array:
        """Velocity (3,) of O's origin [m/s], for ``v_WO`` of a separate filter.

        As far as the path is an oscillation, it is that of the oscillation.
        """
        v = np.array(v_WO, dtype=float)
        velocity_kernel(self.state, self.time, self._pose(), v)
        return v

    def _pose(self) -> Array:
        """The pose now, shape (4, 4)."""
        if self.X_WO is not None:
            return np.array(self.X_WO)
        X = np.empty((4, 4))
        pose_kernel(self.state, self.time, X)
        return X

    def predict(self, ahead: ArrayLike, v_WO: ArrayLike | None = None) -> Array:
        """Poses (k, 4, 4) of the object in the world, ``ahead`` (k,) seconds from now.

        ``v_WO`` (3,) [m/s] is its velocity now, where a filter of its own is more accurate.
        """
        times = np.ascontiguousarray(ahead, dtype=float).reshape(-1)
        X, V = np.empty((len(times), 4, 4)), np.empty(6)
        twist_kernel(self.state, self.time, V)
        v = V[3:] if v_WO is None else np.array(v_WO, dtype=float)
        predict_kernel(self.state, self.time, self._pose(), v, times, X)
        return X


def future_poses(motion: Motion | None, X_WO: Array, V_WO: Array, ahead: ArrayLike) -> Array:
    """Poses (k, 4, 4) of the object ``ahead`` (k,) seconds from now.

    What is known of its motion predicts how it goes on from the pose ``X_WO`` (4, 4), which differs
    a little from where it has it itself. If nothing is known, or the pose is not the one that is
    followed, since the hand is to go somewhere else, it moves on with the twist ``V_WO`` (6,).
    """
    times = np.asarray(ahead, dtype=float).reshape(-1)
    if motion is not None and motion.known:
        now, *later = motion.predict(np.concatenate([[0.0], times]), V_WO[3:])
        turn, step = now[:3, :3].T @ X_WO[:3, :3], X_WO[:3, 3] - now[:3, 3]
        # A pose this far from what a filter expects is not the one that it follows [m].
        if np.linalg.norm(step) < 0.05:
            X = np.array(later).reshape(-1, 4, 4)
            X[:, :3, :3] = X[:, :3, :3] @ turn
            X[:, :3, 3] += step
            return X
    return np.array([se3.extrapolate(X_WO, V_WO, t) for t in times]).reshape(-1, 4, 4)


class PredictionModel(StrEnum):
    """Motion model of the object in a plan."""

    PREDICTED = "predicted"  # to go on as the tracker predicts
    TWIST = "twist"  # to keep its twist
    NONE = "none"  # to stay where it is


def predicted_poses(
    prediction: str, motion: Motion | None, X_WO: Array, V_WO: Array, times: Array
) -> Array:
    """Poses (k, 4, 4) of the object that a plan is made for, by a `PredictionModel`.

    See `future_poses`; ``times`` (k,) [s] are from now on.
    """
    if prediction == PredictionModel.NONE:
        return np.tile(X_WO, (len(times), 1, 1))
    known = motion if prediction == PredictionModel.PREDICTED else None
    return np.ascontiguousarray(future_poses(known, X_WO, V_WO, times))
