"""Joint velocity bounds from position, velocity and acceleration limits; one tick of the drive.

Bounds: how fast each joint may be, so that it never leaves its limits whatever the request.

With the room ``r`` to a position limit, a joint may approach it at most at::

    v_max(r) = min(v_limit, g r, v_brake(r))

``v_brake(r)`` is the largest velocity from which braking by ``b`` per second, in steps of the
control period T, ends inside the limit: a step at v uses up ``T v``, the next ones ``T (v - b T)``,
``T (v - 2 b T)`` and so on. With ``b = a / (2 + g T)``, a the joint's acceleration limit, a joint
that kept to its bounds can keep to them at the next step too without decelerating by more than a:

- on the parabola it decelerates by b;
- where the line ``g r`` is lower, ``v <= 2 b / g + b T``, and following the line from v takes
  ``g v <= (2 + g T) b = a``.

The speed limit itself is approached at no more than ``g_v (v_limit - v)``: an arm lags behind a
command that accelerates, and one whose acceleration ends at once it overshoots by what it has to
make up. Slowing down is never bounded by that, so that all of the above holds.

So the interval of admissible velocities, between the bounds and the acceleration limits, is never
empty. Should it be all the same (a joint that was pushed, or that begins outside), the acceleration
limits come first.

Drive: from a commanded velocity to the next desired position.

What the arm is sent are desired positions. With ``v_k = (q_k - q_(k-1)) / T`` they keep

    lower + margin <= q_k <= upper - margin,    |v_k| <= s velocity limit,    |v_k - v_(k-1)| <= a T

with the arm's speed s in (0, 1] and a the share `Arm.acceleration_share` of the acceleration
limits, whatever is commanded: a joint is never faster than what steps of
``a T`` stop inside the limits (`braking_speed`, exact in discrete time). Braking from an admissible
velocity is admissible again, so that the three never contradict. From a start that none of this
brought about (outside the limits, or too fast) the acceleration limits come first.

An arm that falls behind the desired position slows it down: from half of ``lead`` on, the velocity
away from the arm is bounded, at ``lead`` by zero. The desired position waits; it never goes back by
itself.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.arm import ACCELERATION, COMMANDED, LOWER, MARGIN, UPPER, VELOCITY

#: A command beyond this multiple of the velocity limits is a fault of the controller.
#: Source: guessed.
WILD = 10.0


@compiled(forceinline=True)
def braking_speed(room, deceleration, period):
    """The fastest approach that steps of ``deceleration * period`` stop within ``room`` > 0."""
    unit = deceleration * period**2
    # n whole steps of braking take n (n + 1) / 2 units of way; what is left is shared by them.
    n = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * room / unit) - 1.0))
    return deceleration * period * (0.5 * n + room / (unit * (n + 1.0)))


@compiled(forceinline=True)
def _approach(room, gain, speed, deceleration, period):
    """Bound on the velocity towards a limit; beyond the limit it is negative and leads back."""
    if room <= 0.0:
        return max(gain * room, -speed)
    return min(gain * room, braking_speed(room, deceleration, period), speed)


@compiled
def bounds_kernel(chain, q, qd_last, options, lower, upper):
    """Writes joint velocity bounds into the first n entries of ``lower`` and ``upper``.

    ``qd_last`` is the previous command (n,), or empty if accelerations are not limited;
    ``options`` are `SafetyOptions`, as a record.
    """
    gain, period = options.approach_gain, options.period
    margin = options.position_margin
    for i in range(len(q)):
        speed = options.speed * options.velocity_scale * chain[i, VELOCITY]
        acceleration = options.acceleration_scale * chain[i, ACCELERATION]
        deceleration = acceleration / (2.0 + gain * period)
        up = _approach(chain[i, UPPER] - margin - q[i], gain, speed, deceleration, period)
        down = -_approach(q[i] - (chain[i, LOWER] + margin), gain, speed, deceleration, period)
        if len(qd_last) > 0:
            v, change = qd_last[i], acceleration * period
            share = options.speed_gain * period
            most = v + min(change, max(share * (speed - v), -v, 0.0))
            least = v - min(change, max(share * (speed + v), v, 0.0))
            up, down = min(max(up, least), most), min(max(down, least), most)
        lower[i], upper[i] = down, up


@compiled
def is_fault_kernel(chain, command):
    """Whether a command (n,) [rad/s] is not finite, or beyond `WILD` times the velocity limits."""
    for i in range(len(command)):  # noqa: SIM110 - numba compiles the loop, not any()
        if not abs(command[i]) <= WILD * chain[i, VELOCITY]:
            return True
    return False


@compiled
def drive_step_kernel(chain, q, v, command, measured, bounds, q_next, v_next):
    """Writes the next desired positions and velocities (n,), inside all limits.

    Args:
        chain: That of the `Arm`.
        q: Desired positions now [rad], shape (n,).
        v: The velocity that led there [rad/s], shape (n,).
        command: Commanded velocity [rad/s], shape (n,); one that is a fault counts as zero.
        measured: Measured positions [rad], shape (n,); not looked at where not finite.
        bounds: Period of the control [s]; how far the desired position may be ahead of the measured
            one [rad]; share of the velocity limits that may be used, in (0, 1].
        q_next: Written, shape (n,).
        v_next: Written, shape (n,).

    Returns:
        Whether the command is a fault.
    """
    period, lead, speed = bounds
    fault = is_fault_kernel(chain, command)
    for i in range(len(q)):
        a, most, margin = chain[i, COMMANDED], speed * chain[i, VELOCITY], chain[i, MARGIN]
        ahead = q[i] - measured[i]
        up = _bound(chain[i, UPPER] - margin - q[i], ahead, most, a, period, lead)
        down = -_bound(q[i] - (chain[i, LOWER] + margin), -ahead, most, a, period, lead)
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
