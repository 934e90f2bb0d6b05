"""Fit of an oscillation about a drifting mean, for one axis.

With the time t from the newest point of the path on, and

    S(t) = sin(omega t) / omega,    C(t) = (1 - cos(omega t)) / omega^2

the axis is ``p(t) = p + v S(t) + a C(t) + d (t - S(t))``: a line, a circle, an ellipse or a swing,
whose middle moves on with the velocity d. A tracker whose model of the object improves
corrects itself slowly, and what it follows drifts. Where omega is small, C is ``t^2 / 2``, and the
path a parabola.

The parameters follow by weighted least squares from the points of the path; older ones count less.
Of omega the first guess comes from differences over a lag h, for which

    p(t + h) - 2 p(t) + p(t - h) = -kappa (p(t) - c),    kappa = 2 - 2 cos(omega h)

is exact without a drift, but biased by noise; Gauss-Newton steps refine it.
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.objects.pose_filter import PATH_STEP

#: The lag h, in steps of the path.
_LAG = 4
#: Deviation of the path from the oscillation that noise alone explains [m]: of the differences, and
#: of a tracker.
_PATH_NOISE, _NOISE = 2e-4, 1.5e-3
#: Slower than this [rad/s], nothing oscillates.
STILL = 0.02
#: Points count e times less after so long [s]: objects stop and turn.
_FADES = 0.6
#: What is known of the drift [m/s], and of omega after the first guess, as a share of it.
_DRIFT, _OMEGA = 0.02, 0.1
#: Gauss-Newton steps, and the change of omega they may lead to at most, as a factor.
_STEPS, _FARTHEST = 3, 1.3


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
    if count < 3 * _LAG:
        return Oscillation(STILL, 0.0, 0.0, 0.0, 0.0, np.inf, 0.0)
    guess, mean = _guess(path, count)
    swings = guess > STILL
    omega = first = guess if swings else STILL
    x, columns = np.zeros(5), np.empty(5)
    M, y = np.empty((5, 5)), np.empty(5)
    for step in range(_STEPS + 1 if swings else 1):
        M[:], y[:] = 0.0, 0.0
        M[3, 3] = (_NOISE / _DRIFT) ** 2
        M[4, 4] = (_NOISE / (_OMEGA * first)) ** 2
        y[4] = M[4, 4] * (first - omega)
        for k in range(count):
            t = -k * PATH_STEP
            weight = np.exp(t / _FADES)
            S, C, cosine = shape_kernel(omega, t)
            columns[0], columns[1], columns[2], columns[3] = 1.0, S, C, t - S
            # d/d omega, at what was found before; at first that is nothing. At last omega stays.
            columns[4] = ((x[1] - x[3]) * (t * cosine - S) + x[2] * (t * S - 2.0 * C)) / omega
            columns[4] *= step < _STEPS
            for i in range(5):
                y[i] += weight * columns[i] * (path[k] - path[0])
                for j in range(5):
                    M[i, j] += weight * columns[i] * columns[j]
        x[:] = np.linalg.solve(M, y)
        if step < _STEPS and swings:
            omega = min(max(omega + x[4], first / _FARTHEST), first * _FARTHEST)
    beside, weights = 0.0, 0.0
    for k in range(count):
        t = -k * PATH_STEP
        weight = np.exp(t / _FADES)
        S, C, _ = shape_kernel(omega, t)
        off = path[k] - path[0] - x[0] - x[1] * S - x[2] * C - x[3] * (t - S)
        beside += weight * off * off
        weights += weight
    return Oscillation(omega, x[0], x[1], x[2], x[3], beside / weights, 0.0 if swings else mean)
