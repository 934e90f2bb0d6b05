"""Joint angles and travel times of one flange pose at a batch of arm angles.

Both elbow branches of n arm angles are 2 n *lanes*. All loops run over lanes, without branches, so
that the compiler vectorises them. The shoulder's sign decides joints 1 to 3 alone, the wrist's sign
joints 5 to 7: the travel times of the eight branches are maxima of few numbers.
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_atan2
from feasigrasp.models.robot.iiwa import IIWA_7

_PI = float(np.pi)
#: Where the shoulder takes longest, both signs of the wrist are equally soon, and the other way
#: round: so little of the shorter time is added that the smaller motion wins.
_TIE = 1e-9


class RedundancySamples(NamedTuple):
    """Arm angles, each for both elbow branches, and room for what belongs to them.

    Attributes:
        sine: Of the elbow angle, shape (m,).
        cosine: Of the elbow angle, shape (m,).
        elbow: Sign of joint 4, shape (m,).
        y: Of the angles of joints 1, 2, 3, 5, 6 and 7 of the positive branches, shape (6 m,).
        x: The other arguments of the arctangents, shape (6 m,).
        angle: The arctangents [rad], shape (6 m,).
        time: Travel times [s], shape (4, m): rows are ``2 shoulder + wrist``, see
            `configuration_kernel`; infinite outside the limits. Of equal ones, that with less
            motion of the other joints is shorter by about 1e-9 of it.
    """

    sine: Array
    cosine: Array
    elbow: Array
    y: Array
    x: Array
    angle: Array
    time: Array


@compiled
def redundancy_samples_kernel(psis, extra):
    """The `RedundancySamples` of the arm angles ``psis`` and, unless it is NaN, one more."""
    n = len(psis) + (0 if np.isnan(extra) else 1)
    m = 2 * n
    sine, cosine, elbow = np.empty(m), np.empty(m), np.empty(m)
    for k in range(n):
        psi = psis[k] if k < len(psis) else extra
        s, c = np.sin(psi), np.cos(psi)
        sine[k], cosine[k], elbow[k] = s, c, 1.0
        sine[n + k], cosine[n + k], elbow[n + k] = -s, -c, -1.0
    y, x, angle = np.empty(6 * m), np.empty(6 * m), np.empty(6 * m)
    return RedundancySamples(sine, cosine, elbow, y, x, angle, np.empty((4, m)))


@compiled
def _arguments(circle, sine, cosine, elbow, y, x):
    """Writes sines and cosines, up to a factor, of the angles of the positive branches."""
    m = len(sine)
    c_a, s_a, c_g, s_g = circle.c_a, circle.s_a, circle.c_g, circle.s_g
    c_b, s_b, c_d, s_d = circle.c_b, circle.s_b, circle.c_d, circle.s_d
    w00, w01, w02, w10, w11, w12, w20, w21, w22 = circle.W
    for k in range(m):
        s, c, e = sine[k], cosine[k], elbow[k]
        x_1, y_1 = c_g * s_b * c + s_g * c_b, s_b * s
        y[k], x[k] = s_a * x_1 + c_a * y_1, c_a * x_1 - s_a * y_1
        y[m + k], x[m + k] = np.sqrt(x_1 * x_1 + y_1 * y_1), c_g * c_b - s_g * s_b * c
        y[2 * m + k], x[2 * m + k] = e * (s_g * s), e * (s_b * c_g + c_b * s_g * c)
    for k in range(m):
        s, c, e = sine[k], cosine[k], elbow[k]
        t0, t1, t2 = c * w00 + s * w10, c * w01 + s * w11, c * w02 + s * w12
        x_5, y_5 = c_d * t2 + s_d * w22, c * w12 - s * w02
        y[3 * m + k], x[3 * m + k] = e * y_5, e * x_5
        y[4 * m + k], x[4 * m + k] = np.sqrt(x_5 * x_5 + y_5 * y_5), c_d * w22 - s_d * t2
        y[5 * m + k], x[5 * m + k] = c_d * w21 - s_d * t1, s_d * t0 - c_d * w20


@compiled
def _arctangents(y, x, angle):
    for k in range(len(y)):
        angle[k] = fast_atan2(y[k], x[k])


@compiled(inline="always")
def _joint_time(angle, near, limit, speed):
    time = abs(angle - near) / speed
    return time if abs(angle) <= limit else np.inf


@compiled
def _triple_times(angle, q, first, margin, plus, minus):
    """Writes the times of three joints from ``first`` on, for both signs of the middle one."""
    m = len(plus)
    n1, n2, n3 = q[first], q[first + 1], q[first + 2]
    l1, l2 = IIWA_7.position_limits[first] - margin, IIWA_7.position_limits[first + 1] - margin
    l3 = IIWA_7.position_limits[first + 2] - margin
    v1, v2, v3 = (
        IIWA_7.velocity_limits[first],
        IIWA_7.velocity_limits[first + 1],
        IIWA_7.velocity_limits[first + 2],
    )
    for k in range(m):
        a, b, c = angle[k], angle[m + k], angle[2 * m + k]
        time = max(_joint_time(a, n1, l1, v1), _joint_time(b, n2, l2, v2))
        plus[k] = max(time, _joint_time(c, n3, l3, v3))
        a = a - _PI if a > 0.0 else a + _PI
        c = c - _PI if c > 0.0 else c + _PI
        time = max(_joint_time(a, n1, l1, v1), _joint_time(-b, n2, l2, v2))
        minus[k] = max(time, _joint_time(c, n3, l3, v3))


@compiled
def travel_times_kernel(circle, q, margin, samples):
    """Writes the travel time from ``q`` of every sample and branch into ``samples.time``.

    Branches that are not ``margin`` [rad] inside the limits get infinity. Next to a singularity
    the times of the joints with a common axis are rough; `configuration_kernel` is exact there.
    """
    m = len(samples.sine)
    y, x, angle, time = samples.y, samples.x, samples.angle, samples.time
    _arguments(circle, samples.sine, samples.cosine, samples.elbow, y, x)
    _arctangents(y, x, angle)
    # Rows of y and x are used up: they hold the shoulder's and the wrist's times.
    shoulder, wrist = (y[:m], y[m : 2 * m]), (y[2 * m : 3 * m], y[3 * m : 4 * m])
    _triple_times(angle[: 3 * m], q, 0, margin, shoulder[0], shoulder[1])
    _triple_times(angle[3 * m :], q, 4, margin, wrist[0], wrist[1])
    limit = IIWA_7.position_limits[3] - margin
    bent = np.inf if circle.q4 > limit else 0.0
    elbow_plus = bent + abs(circle.q4 - q[3]) / IIWA_7.velocity_limits[3]
    elbow_minus = bent + abs(-circle.q4 - q[3]) / IIWA_7.velocity_limits[3]
    _branch_times(shoulder[0], shoulder[1], wrist[0], wrist[1], elbow_plus, elbow_minus, time)


@compiled
def _branch_times(s0, s1, w0, w1, elbow_plus, elbow_minus, time):
    n = len(s0) // 2
    for half in range(2):
        elbow = elbow_plus if half == 0 else elbow_minus
        for k in range(half * n, half * n + n):
            a, b = max(s0[k], elbow), max(s1[k], elbow)
            c, d = w0[k], w1[k]
            time[0, k] = max(a, c) + _TIE * min(a, c)
            time[1, k] = max(a, d) + _TIE * min(a, d)
            time[2, k] = max(b, c) + _TIE * min(b, c)
            time[3, k] = max(b, d) + _TIE * min(b, d)
