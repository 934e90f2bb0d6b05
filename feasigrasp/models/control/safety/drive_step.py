"""One tick of the drive: from a commanded velocity to the next desired position.

What the arm is sent are desired positions. With ``v_k = (q_k - q_(k-1)) / T`` they keep

    |q_k| <= limit - margin,    |v_k| <= s velocity limit,    |v_k - v_(k-1)| <= a T

with the arm's speed s in (0, 1], whatever is commanded: a joint is never faster than what steps of
``a T`` stop inside the limits (`braking_speed`, exact in discrete time). Braking from an admissible
velocity is admissible again, so that the three never contradict. From a start that none of this
brought about (outside the limits, or too fast) the acceleration limits come first.

An arm that falls behind the desired position slows it down: from half of ``lead`` on, the velocity
away from the arm is bounded, at ``lead`` by zero. The desired position waits; it never goes back by
itself.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.safety.speed_bounds import braking_speed
from feasigrasp.models.robot.iiwa import IIWA_7

#: A command beyond so many times the velocity limits is none, but a fault of the controller.
WILD = 10.0


@compiled
def is_fault_kernel(command):
    """Whether a command (7,) [rad/s] is not finite, or beyond `WILD` times the velocity limits."""
    for i in range(IIWA_7.joints):
        if not abs(command[i]) <= WILD * IIWA_7.velocity_limits[i]:
            return True
    return False


@compiled
def drive_step_kernel(q, v, command, measured, period, lead, speed, q_next, v_next):
    """Writes the next desired positions and velocities (7,), inside all limits.

    Args:
        q: Desired positions now [rad], shape (7,).
        v: The velocity that led there [rad/s], shape (7,).
        command: Commanded velocity [rad/s], shape (7,); one that is a fault counts as zero.
        measured: Measured positions [rad], shape (7,); not looked at where not finite.
        period: Of the control [s].
        lead: How far the desired position may be ahead of the measured one [rad].
        speed: Share of the velocity limits that may be used, in (0, 1].
        q_next: Written, shape (7,).
        v_next: Written, shape (7,).

    Returns:
        Whether the command is a fault.
    """
    fault = is_fault_kernel(command)
    for i in range(IIWA_7.joints):
        a, most = IIWA_7.acceleration_limits[i], speed * IIWA_7.velocity_limits[i]
        limit = IIWA_7.position_limits[i] - IIWA_7.position_margin
        ahead = q[i] - measured[i]
        up = _bound(limit - q[i], ahead, most, a, period, lead)
        down = -_bound(limit + q[i], -ahead, most, a, period, lead)
        wish = 0.0 if fault else min(max(command[i], down), up)
        v_next[i] = min(max(wish, v[i] - a * period), v[i] + a * period)
        q_next[i] = q[i] + period * v_next[i]
    return fault


@compiled(forceinline=True)
def _bound(room, ahead, most, a, period, lead):
    """The fastest towards a limit ``room`` away, by a joint that is ``ahead`` of the arm.

    ``most`` is its speed limit [rad/s].
    """
    if not room > 0.0:
        return 0.0
    speed = min(most, braking_speed(room, a, period))
    if ahead > 0.5 * lead:
        speed = min(speed, most * max(0.0, 2.0 - 2.0 * ahead / lead))
    return speed


@compiled
def free_step_kernel(q, command, period, q_next, v_next):
    """As `drive_step_kernel`, with nothing bounded; a command that is not finite counts as zero."""
    finite = np.isfinite(command.sum())
    for i in range(IIWA_7.joints):
        v_next[i] = command[i] if finite else 0.0
        q_next[i] = q[i] + period * v_next[i]
    return is_fault_kernel(command)
