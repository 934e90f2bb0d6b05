"""Contact reaction: collision detection by external joint torques, and retreat.

Torques that nothing but contact explains are what an iiwa's controller estimates and reports, with
an error that hardly changes: its slow mean, taken while nothing touches, is subtracted. Where
on the arm it was touched need not be known: the contact pushes the arm along ``tau``, since it does
the work ``tau . qd`` on it. So a motion with ``tau . qd > 0`` yields to the contact, whatever body
it is at.
"""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.arm import EFFORT

#: A torque above this share of a joint's limit is a touch: a choice, more than what is left of
#: twice the published error of an iiwa (`feasigrasp.models.sensors.joint_errors`). Source:
#: reasoned.
THRESHOLD = 0.03
#: What stays of a torque without a touch is the sensor's own error: it is followed with this time
#: constant [s], longer than contacts last and shorter than the arm takes to turn. Source: reasoned.
_ZEROING = 1.0
#: Time constant of the low-pass filter in front of it [s]. Source: guessed.
_SMOOTHING = 0.01
#: The arm gives way so long after the last touch [s], and so fast [m/s]. Source: guessed.
_YIELDS_FOR, _SPEED = 0.2, 0.1


def touch_state(joints: int) -> Array:
    """The state at first: filtered torque (n,), torque of the touch (n,), time that is left.

    Then the number of touches, the sensor's own error (n,), how long that has been measured [s].
    """
    return np.zeros(3 * joints + 3)


@compiled
def touch_step_kernel(chain, state, torque, period, after):
    """Writes the state one period [s] later into ``after``, see `touch_state`.

    It is zero at first, when nothing touches the arm. ``torque`` (n,) [Nm] are external torques of
    the joints; one that is not finite is none.
    """
    n = len(torque)
    touches, zero = 2 * n + 1, 2 * n + 2
    after[:] = state
    share = 0.0
    for i in range(n):
        wish = torque[i] if np.isfinite(torque[i]) else 0.0
        if state[-1] == 0.0:
            after[i], after[zero + i] = wish, wish
            continue
        after[i] = state[i] + (wish - state[i]) * period / (_SMOOTHING + period)
        if state[2 * n] <= 0.0:  # at first the mean of all that has been measured
            after[zero + i] += (after[i] - state[zero + i]) * period / min(_ZEROING, state[-1])
        share = max(share, abs(after[i] - after[zero + i]) / chain[i, EFFORT])
    after[-1] = state[-1] + period
    left = state[2 * n] - period
    if share > THRESHOLD:
        if state[2 * n] <= 0.0:
            after[touches] += 1.0
        left = _YIELDS_FOR
        after[n : 2 * n] = after[:n] - after[zero : zero + n]
    elif left <= 0.0:
        after[n : 2 * n] = 0.0
    after[2 * n] = max(left, 0.0)


def yielding_velocity(qd: Array, torque: Array, J_WH: Array) -> Array:
    """The velocity (7,) [rad/s] nearest to ``qd`` that gives way to a touch; else ``qd`` itself.

    It is the one with ``tau . qd >= |F| v`` for the external torques tau (7,) [Nm], with the force
    F at the hand, of Jacobian ``J_WH`` (6, 7), that explains the torques best; so a hand that is
    touched moves at v, 0.1 m/s, along the force.
    """
    square = float(torque @ torque)
    if square == 0.0:
        return qd
    F_W = np.linalg.lstsq(J_WH[3:].T, torque, rcond=1e-3)[0]
    lack = float(np.linalg.norm(F_W)) * _SPEED - float(torque @ qd)
    return qd + max(lack, 0.0) / square * torque
