"""Pose and twist of a moving object from noisy poses with gaps, by Kalman filtering.

A Kalman filter with a constant-acceleration model, driven by white jerk, follows the position; a
second one with the same equations follows the rotation vector from the predicted to the measured
orientation (an error-state filter on SO(3)). Noise is isotropic, so all three axes share one
covariance (3, 3) and one gain. With noise that is zero the gains tend to those of a backward
difference of second order: nothing is smoothed, nothing lags behind. The filter is a plain vector,
so that it can be the discrete state of a system; behind it is the path of the last seconds.

Reference: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
section 6.2 (the Wiener-process acceleration model).
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import so3_exp_kernel, so3_log_kernel

#: Time between the stored points of the path [s], and their number. Source: guessed.
PATH_STEP, PATH_LENGTH = 0.1, 45
#: Standard deviation of a measurement at least [m, rad]: keeps the covariance positive. Source:
#: numerical.
_FLOOR = 1e-6
#: A measurement this far from the prediction is a jump [m, rad]. It is gated until others have
#: agreed with it for this long [s]; then the filter starts again there. Source: guessed.
_JUMP, _JUMP_FOR = 0.15, 0.1

#: Size of the state vector, see `State`: 58 numbers, and 12 for every point of the path. Source:
#: layout.
STATE_SIZE = 58 + 12 * PATH_LENGTH


class State(NamedTuple):
    """The parts of a state vector, as views into it.

    Attributes:
        time: Of the last measurement [s], NaN before the first, shape (1,).
        p: Position [m], shape (3,).
        v: Velocity [m/s], shape (3,).
        a: Acceleration [m/s^2], shape (3,).
        covariance: Of these, the same for every axis, shape (3, 3).
        R: Orientation, shape (3, 3).
        w: Angular velocity [rad/s], shape (3,).
        alpha: Angular acceleration [rad/s^2], shape (3,).
        covariance_r: Of orientation, w and alpha, shape (3, 3).
        due: When the next point of the path is [s], shape (1,).
        stored: Number of points of the path, shape (1,).
        far_since: Since when measurements have said that the object jumped [s], NaN if they do not,
            shape (1,).
        far_p: Where to [m], shape (3,).
        far_R: Its orientation there, shape (3, 3).
        path: Their positions and orientations, newest first, shape (PATH_LENGTH, 4, 3).
    """

    time: Array
    p: Array
    v: Array
    a: Array
    covariance: Array
    R: Array
    w: Array
    alpha: Array
    covariance_r: Array
    due: Array
    stored: Array
    far_since: Array
    far_p: Array
    far_R: Array
    path: Array


@compiled
def parts(x):
    """The parts of a state vector (STATE_SIZE,)."""
    return State(
        time=x[:1],
        p=x[1:4],
        v=x[4:7],
        a=x[7:10],
        covariance=x[10:19].reshape(3, 3),
        R=x[19:28].reshape(3, 3),
        w=x[28:31],
        alpha=x[31:34],
        covariance_r=x[34:43].reshape(3, 3),
        due=x[43:44],
        stored=x[44:45],
        far_since=x[45:46],
        far_p=x[46:49],
        far_R=x[49:58].reshape(3, 3),
        path=x[58:].reshape(PATH_LENGTH, 4, 3),
    )


class Noise(NamedTuple):
    """Noise model of the filter.

    Attributes:
        position: Standard deviation of a measured position [m].
        rotation: The same of its orientation, about each axis [rad].
        jerk: How quickly the acceleration changes [m/s^3 in 1 s]: square root of a density.
        angular_jerk: The same for the angular acceleration.
    """

    position: float = 0.0
    rotation: float = 0.0
    jerk: float = 0.4
    angular_jerk: float = 0.3


def empty_state() -> Array:
    """The state before any measurement, shape (STATE_SIZE,)."""
    state = np.zeros(STATE_SIZE)
    s = parts(state)
    s.time[0] = s.far_since[0] = np.nan
    return state


@compiled
def _start(C, sigma):
    # What is known before the first measurement: standard deviations of velocity and acceleration.
    prior_v, prior_a = 1.0, 2.0
    C[:] = 0.0
    C[0, 0], C[1, 1], C[2, 2] = sigma**2, prior_v**2, prior_a**2


@compiled
def _propagate(covariance, dt, jerk):
    """Covariance (3, 3) of position, velocity and acceleration after ``dt``."""
    F = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    C = F @ covariance @ F.T
    q = jerk * jerk
    # White jerk, integrated once, twice, three times.
    C[0, 0] += q * dt**5 / 20.0
    C[0, 1] += q * dt**4 / 8.0
    C[0, 2] += q * dt**3 / 6.0
    C[1, 1] += q * dt**3 / 3.0
    C[1, 2] += q * dt**2 / 2.0
    C[2, 2] += q * dt
    C[1, 0], C[2, 0], C[2, 1] = C[0, 1], C[0, 2], C[1, 2]
    covariance[:] = C


@compiled
def _gain(C, sigma):
    """Gain of a measured position; updates the covariance C (3, 3) in Joseph's form."""
    K = C[:, 0] / (C[0, 0] + sigma * sigma)
    A = np.eye(3)
    A[:, 0] -= K
    C[:] = A @ C @ A.T + sigma * sigma * np.outer(K, K)
    return K


@compiled
def pose_kernel(state, t, X):
    """Writes the pose (4, 4) that the filter expects at time t, by constant acceleration."""
    s = parts(state)
    dt = t - s.time[0]
    turn = np.empty(3)
    for i in range(3):
        X[i, 3] = s.p[i] + dt * (s.v[i] + 0.5 * dt * s.a[i])
        turn[i] = dt * (s.w[i] + 0.5 * dt * s.alpha[i])
    X[:3, :3] = so3_exp_kernel(turn) @ s.R.copy()
    X[3] = 0.0
    X[3, 3] = 1.0


@compiled
def twist_kernel(state, t, V):
    """Writes the twist (6,) [angular; linear] that the filter expects at time t."""
    s = parts(state)
    dt = t - s.time[0]
    for i in range(3):
        V[i] = s.w[i] + dt * s.alpha[i]
        V[3 + i] = s.v[i] + dt * s.a[i]


@compiled
def _restart(state, t, X, noise):
    state[:] = 0.0
    s = parts(state)
    s.time[0] = s.due[0] = t
    s.far_since[0] = np.nan
    s.p[:], s.R[:] = X[:3, 3], X[:3, :3]
    _start(s.covariance, max(noise.position, _FLOOR))
    _start(s.covariance_r, max(noise.rotation, _FLOOR))


@compiled
def _remember(state, t):
    """Stores points of the path up to time t, newest first."""
    s = parts(state)
    X = np.empty((4, 4))
    while s.due[0] <= t + 1e-9:
        pose_kernel(state, s.due[0], X)
        for k in range(PATH_LENGTH - 1, 0, -1):
            s.path[k] = s.path[k - 1]
        s.path[0, 0], s.path[0, 1:] = X[:3, 3], X[:3, :3]
        s.stored[0] = min(s.stored[0] + 1.0, float(PATH_LENGTH))
        s.due[0] += PATH_STEP


@compiled
def _is_a_jump(s, t, X):
    """Notes that ``X`` is far from what was expected; whether that has gone on for long enough."""
    turn = so3_log_kernel(X[:3, :3].copy() @ s.far_R.T.copy())
    elsewhere = np.linalg.norm(X[:3, 3] - s.far_p) > _JUMP or np.linalg.norm(turn) > _JUMP
    if np.isnan(s.far_since[0]) or elsewhere:
        s.far_since[0] = t
    s.far_p[:], s.far_R[:] = X[:3, 3], X[:3, :3]
    return t - s.far_since[0] >= _JUMP_FOR - 1e-9


@compiled
def _turn_over(s, X, expected, noise):
    """Goes on as before with another orientation, as if the object had always been in it.

    An object that is where it was expected has hardly been turned over: it looks much the same from
    two sides, or the estimate of its tracker has improved. Its path is still its path.
    """
    turn = np.ascontiguousarray(expected[:3, :3].T) @ np.ascontiguousarray(X[:3, :3])
    s.alpha[:] = 0.0
    _start(s.covariance_r, max(noise.rotation, _FLOOR))
    for k in range(int(s.stored[0])):
        s.path[k, 1:] = s.path[k, 1:].copy() @ turn
    expected[:3, :3] = X[:3, :3]


@compiled
def measure_kernel(state, t, X, noise):
    """Takes in the pose ``X`` (4, 4), measured at time ``t``; changes ``state``.

    A pose that is not finite, or not later than the last one, is ignored. So is one that is far
    from where the object can be, until others confirm it; then the filter starts anew there, as it
    does after a long silence. An orientation that jumps where the position does not is not taken
    in either until it is confirmed; the position is, and the motion goes on.
    """
    s = parts(state)
    if not np.isfinite(X.sum()) or t <= s.time[0]:
        return
    dt = t - s.time[0]
    # After this long without a measurement nothing of the motion before is worth anything [s].
    if np.isnan(dt) or dt > 1.0:
        _restart(state, t, X, noise)
        _remember(state, t)
        return
    expected = np.empty((4, 4))
    pose_kernel(state, t, expected)
    turn = so3_log_kernel(X[:3, :3].copy() @ expected[:3, :3].T.copy())
    C, C_r = s.covariance.copy(), s.covariance_r.copy()
    _propagate(C, dt, noise.jerk)
    _propagate(C_r, dt, noise.angular_jerk)
    sigma, sigma_r = max(noise.position, _FLOOR), max(noise.rotation, _FLOOR)
    far, far_r = np.linalg.norm(X[:3, 3] - expected[:3, 3]), np.linalg.norm(turn)
    likely, likely_r = 6.0 * np.sqrt(C[0, 0] + sigma**2), 6.0 * np.sqrt(C_r[0, 0] + sigma_r**2)
    elsewhere, turned = far > max(_JUMP, likely), far_r > max(_JUMP, likely_r)
    lasts = (elsewhere or turned) and _is_a_jump(s, t, X)
    if elsewhere:
        if lasts:
            _restart(state, t, X, noise)
            _remember(state, t)
        return
    s.covariance[:], s.covariance_r[:] = C, C_r
    if lasts:
        _turn_over(s, X, expected, noise)
    if lasts or not turned:
        s.far_since[0] = np.nan
    K, K_r = _gain(s.covariance, sigma), np.zeros(3)
    if not turned:
        K_r = _gain(s.covariance_r, sigma_r)
    correction = np.empty(3)
    for i in range(3):
        off = X[i, 3] - expected[i, 3]
        s.p[i] = expected[i, 3] + K[0] * off
        s.v[i] += dt * s.a[i] + K[1] * off
        s.a[i] += K[2] * off
        s.w[i] += dt * s.alpha[i] + K_r[1] * turn[i]
        s.alpha[i] += K_r[2] * turn[i]
        correction[i] = K_r[0] * turn[i]
    s.R[:] = so3_exp_kernel(correction) @ np.ascontiguousarray(expected[:3, :3])
    s.time[0] = t
    _remember(state, t)
