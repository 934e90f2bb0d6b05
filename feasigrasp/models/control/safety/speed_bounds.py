"""How fast each joint may be, so that it never leaves its limits however the request changes.

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
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.iiwa import IIWA_7


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
def bounds_kernel(q, qd_last, options, lower, upper):
    """Writes joint velocity bounds into the first seven entries of ``lower`` and ``upper``.

    ``qd_last`` is the previous command (7,), or empty if accelerations are not limited;
    ``options`` are `SafetyOptions`, as a record.
    """
    gain, period = options.approach_gain, options.period
    for i in range(IIWA_7.joints):
        speed = options.speed * options.velocity_scale * IIWA_7.velocity_limits[i]
        acceleration = options.acceleration_scale * IIWA_7.acceleration_limits[i]
        deceleration = acceleration / (2.0 + gain * period)
        limit = IIWA_7.position_limits[i] - options.position_margin
        up = _approach(limit - q[i], gain, speed, deceleration, period)
        down = -_approach(limit + q[i], gain, speed, deceleration, period)
        if len(qd_last) > 0:
            v, change = qd_last[i], acceleration * period
            share = options.speed_gain * period
            most = v + min(change, max(share * (speed - v), -v, 0.0))
            least = v - min(change, max(share * (speed + v), v, 0.0))
            up, down = min(max(up, least), most), min(max(down, least), most)
        lower[i], upper[i] = down, up
