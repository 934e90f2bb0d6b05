"""Pose and twist of a moving object from noisy poses, some of which are lost.

A Kalman filter with a constant-acceleration model, driven by white jerk, follows the position; a
second one with the same equations follows the rotation vector from the predicted to the measured
orientation (an error-state filter on SO(3)). Noise is isotropic, so all three axes share one
covariance (3, 3) and one gain. With noise that is zero the gains tend to those of a backward
difference of second order: nothing is smoothed, nothing lags behind. The filter is a plain vector,
so that it can be the discrete state of a system; behind it is the path of the last seconds.

Reference: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
section 6.2 (the Wiener-process acceleration model).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3_kernels import so3_exp_kernel, so3_log_kernel

#: Time between the stored points of the path [s], and their number.
PATH_STEP, PATH_LENGTH = 0.1, 45
#: Standard deviation of a measurement at least [m, rad]: keeps the covariance positive.
_FLOOR = 1e-6
#: What is known before the first measurement: standard deviations of velocity and acceleration.
_PRIOR_V, _PRIOR_A = 1.0, 2.0
#: A measurement this far from the prediction is a jump [m, rad]: the filter starts again there.
_JUMP = 0.15

# Layout of the state: time, position filter, orientation filter, then the path: when its next point
# is due, how many there are, and rows of position and rotation matrix, newest first.
_P, _V, _A, _COV = 1, 4, 7, 10
_R, _W, _ALPHA, _COV_R = 19, 28, 31, 34
_NEXT, COUNT, PATH = 43, 44, 45
ROW = 12
#: Size of the state vector.
STATE_SIZE = PATH + ROW * PATH_LENGTH


class Noise(NamedTuple):
    """What a filter assumes.

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
    state[0] = np.nan
    return state


@njit(cache=True)
def _start(covariance, sigma):
    covariance[:] = 0.0
    covariance[0], covariance[4], covariance[8] = sigma**2, _PRIOR_V**2, _PRIOR_A**2


@njit(cache=True)
def _propagate(covariance, dt, jerk):
    """Covariance (9,) of position, velocity and acceleration after ``dt``."""
    F = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    C = F @ covariance.reshape(3, 3) @ F.T
    q = jerk * jerk
    # White jerk, integrated once, twice, three times.
    C[0, 0] += q * dt**5 / 20.0
    C[0, 1] += q * dt**4 / 8.0
    C[0, 2] += q * dt**3 / 6.0
    C[1, 1] += q * dt**3 / 3.0
    C[1, 2] += q * dt**2 / 2.0
    C[2, 2] += q * dt
    C[1, 0], C[2, 0], C[2, 1] = C[0, 1], C[0, 2], C[1, 2]
    covariance[:] = C.ravel()


@njit(cache=True)
def _gain(covariance, sigma):
    """Gain of a measured position; updates the covariance (9,) in Joseph's form."""
    C = covariance.reshape(3, 3)
    K = C[:, 0] / (C[0, 0] + sigma * sigma)
    A = np.eye(3)
    A[:, 0] -= K
    C = A @ np.ascontiguousarray(C) @ A.T + sigma * sigma * np.outer(K, K)
    covariance[:] = C.ravel()
    return K


@njit(cache=True)
def pose_kernel(state, t, X):
    """Writes the pose (4, 4) that the filter expects at time t, by constant acceleration."""
    dt = t - state[0]
    turn = np.empty(3)
    for i in range(3):
        X[i, 3] = state[_P + i] + dt * (state[_V + i] + 0.5 * dt * state[_A + i])
        turn[i] = dt * (state[_W + i] + 0.5 * dt * state[_ALPHA + i])
    X[:3, :3] = so3_exp_kernel(turn) @ state[_R : _R + 9].copy().reshape(3, 3)
    X[3] = 0.0
    X[3, 3] = 1.0


@njit(cache=True)
def twist_kernel(state, t, V):
    """Writes the twist (6,) [angular; linear] that the filter expects at time t."""
    dt = t - state[0]
    for i in range(3):
        V[i] = state[_W + i] + dt * state[_ALPHA + i]
        V[3 + i] = state[_V + i] + dt * state[_A + i]


@njit(cache=True)
def _restart(state, t, X, noise):
    state[:] = 0.0
    state[0] = t
    state[_P : _P + 3] = X[:3, 3]
    state[_R : _R + 9] = X[:3, :3].copy().ravel()
    _start(state[_COV : _COV + 9], max(noise.position, _FLOOR))
    _start(state[_COV_R : _COV_R + 9], max(noise.rotation, _FLOOR))
    state[_NEXT] = t


@njit(cache=True)
def _remember(state, t):
    """Stores points of the path up to time t, newest first."""
    X = np.empty((4, 4))
    while state[_NEXT] <= t + 1e-9:
        pose_kernel(state, state[_NEXT], X)
        for i in range(STATE_SIZE - 1, PATH + ROW - 1, -1):
            state[i] = state[i - ROW]
        state[PATH : PATH + 3] = X[:3, 3]
        state[PATH + 3 : PATH + ROW] = X[:3, :3].copy().ravel()
        state[COUNT] = min(state[COUNT] + 1.0, float(PATH_LENGTH))
        state[_NEXT] += PATH_STEP


@njit(cache=True)
def measure_kernel(state, t, X, noise):
    """Takes in the pose ``X`` (4, 4), measured at time ``t``; changes ``state``.

    A pose that is not finite, or not later than the last one, is ignored. One that is far from
    where the object can be starts the filter anew.
    """
    if not np.isfinite(X.sum()) or t <= state[0]:
        return
    if np.isnan(state[0]):
        _restart(state, t, X, noise)
        _remember(state, t)
        return
    dt = t - state[0]
    expected = np.empty((4, 4))
    pose_kernel(state, t, expected)
    turn = so3_log_kernel(X[:3, :3].copy() @ expected[:3, :3].T.copy())
    covariance, covariance_r = state[_COV : _COV + 9], state[_COV_R : _COV_R + 9]
    _propagate(covariance, dt, noise.jerk)
    _propagate(covariance_r, dt, noise.angular_jerk)
    sigma, sigma_r = max(noise.position, _FLOOR), max(noise.rotation, _FLOOR)
    far, far_r = np.linalg.norm(X[:3, 3] - expected[:3, 3]), np.linalg.norm(turn)
    likely = 6.0 * np.sqrt(covariance[0] + sigma**2)
    likely_r = 6.0 * np.sqrt(covariance_r[0] + sigma_r**2)
    if far > max(_JUMP, likely) or far_r > max(_JUMP, likely_r):
        _restart(state, t, X, noise)
        _remember(state, t)
        return
    K, K_r = _gain(covariance, sigma), _gain(covariance_r, sigma_r)
    correction = np.empty(3)
    for i in range(3):
        off = X[i, 3] - expected[i, 3]
        state[_P + i] = expected[i, 3] + K[0] * off
        state[_V + i] += dt * state[_A + i] + K[1] * off
        state[_A + i] += K[2] * off
        state[_W + i] += dt * state[_ALPHA + i] + K_r[1] * turn[i]
        state[_ALPHA + i] += K_r[2] * turn[i]
        correction[i] = K_r[0] * turn[i]
    R = so3_exp_kernel(correction) @ np.ascontiguousarray(expected[:3, :3])
    state[_R : _R + 9] = R.ravel()
    state[0] = t
    _remember(state, t)
