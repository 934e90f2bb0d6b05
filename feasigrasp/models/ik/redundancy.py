"""Redundancy of a flange pose: feasible arm-angle intervals, travel times (Shimizu et al. 2008).

Sine and cosine of every joint angle are, up to a common positive factor,
``A sin(phi) + B cos(phi) + C`` of the elbow angle phi (`feasigrasp.models.ik.self_motion`). So is

- ``y cos(L) -+ x sin(L)``, which is zero where ``atan2(y, x)`` is ``+-L``, or half a turn from it:
  joints 1, 3, 5 and 7, in both branches at once;
- ``cos(q) - cos(L)`` for joints 2 and 6, in both branches at once.

Joint 4 does not depend on phi. Ten such functions have at most 20 zeros; they cut the circle into
segments on which each branch is either inside the limits throughout or nowhere. The branch with the
mirrored elbow is half a turn away, with half a turn added to joints 3 and 5.
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_atan2, fast_sincos
from feasigrasp.models.robot.arm import UPPER, VELOCITY

# Joint angles and travel times of one flange pose at a batch of arm angles.
#
# Both elbow branches of n arm angles are 2 n *lanes*. All loops run over lanes, without branches,
# so that the compiler vectorises them. The shoulder's sign decides joints 1 to 3 alone, the wrist's
# sign joints 5 to 7: the travel times of the eight branches are maxima of few numbers.


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
def _triple_times(chain, angle, q, first, margin, plus, minus):
    """Writes the times of three joints from ``first`` on, for both signs of the middle one."""
    m = len(plus)
    n1, n2, n3 = q[first], q[first + 1], q[first + 2]
    l1, l2 = chain[first, UPPER] - margin, chain[first + 1, UPPER] - margin
    l3 = chain[first + 2, UPPER] - margin
    v1, v2 = chain[first, VELOCITY], chain[first + 1, VELOCITY]
    v3 = chain[first + 2, VELOCITY]
    for k in range(m):
        a, b, c = angle[k], angle[m + k], angle[2 * m + k]
        time = max(_joint_time(a, n1, l1, v1), _joint_time(b, n2, l2, v2))
        plus[k] = max(time, _joint_time(c, n3, l3, v3))
        a = a - np.pi if a > 0.0 else a + np.pi
        c = c - np.pi if c > 0.0 else c + np.pi
        time = max(_joint_time(a, n1, l1, v1), _joint_time(-b, n2, l2, v2))
        minus[k] = max(time, _joint_time(c, n3, l3, v3))


@compiled
def travel_times_kernel(chain, circle, q, margin, samples):
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
    _triple_times(chain, angle[: 3 * m], q, 0, margin, shoulder[0], shoulder[1])
    _triple_times(chain, angle[3 * m :], q, 4, margin, wrist[0], wrist[1])
    limit = chain[3, UPPER] - margin
    bent = np.inf if circle.q4 > limit else 0.0
    elbow_plus = bent + abs(circle.q4 - q[3]) / chain[3, VELOCITY]
    elbow_minus = bent + abs(-circle.q4 - q[3]) / chain[3, VELOCITY]
    _branch_times(shoulder[0], shoulder[1], wrist[0], wrist[1], elbow_plus, elbow_minus, time)


@compiled
def _branch_times(s0, s1, w0, w1, elbow_plus, elbow_minus, time):
    # Where the shoulder takes longest, both signs of the wrist are equally soon, and the other way
    # round: so little of the shorter time is added that the smaller motion wins.
    tie = 1e-9
    n = len(s0) // 2
    for half in range(2):
        elbow = elbow_plus if half == 0 else elbow_minus
        for k in range(half * n, half * n + n):
            a, b = max(s0[k], elbow), max(s1[k], elbow)
            c, d = w0[k], w1[k]
            time[0, k] = max(a, c) + tie * min(a, c)
            time[1, k] = max(a, d) + tie * min(a, d)
            time[2, k] = max(b, c) + tie * min(b, c)
            time[3, k] = max(b, d) + tie * min(b, d)


#: Rows of the coefficients: x, y of joints 1, 3, 5, 7, then the cosines of joints 2 and 6. Source:
#: layout.
_TURNING = (0, 2, 4, 6)
_BENDING = (1, 5)


class Segments(NamedTuple):
    """The circle of elbow angles, cut where a joint of some branch is at its limit.

    Attributes:
        limit: Joint limits less the margin [rad], shape (7,).
        s_limit: Their sines, shape (7,).
        c_limit: Their cosines, shape (7,).
        coefficients: A, B, C of the functions above, shape (10, 3).
        start: Where each segment starts, ascending [rad], shape (20,); the last one ends where the
            first one starts.
        branches: Bit b is set if branch b is inside the limits on the segment, shape (20,).
    """

    limit: Array
    s_limit: Array
    c_limit: Array
    coefficients: Array
    start: Array
    branches: Indices


@compiled
def make_segments(chain, margin):
    """Scratch memory for the segments of one pose, ``margin`` [rad] inside the joint limits."""
    # Zeros that a joint's limits can have, at most, over the arm angle. Source: numerical.
    max_zeros = 20
    limit = np.minimum(chain[:7, UPPER] - margin, np.pi)
    start, branches = np.empty(max_zeros + 1), np.empty(max_zeros + 1, dtype=np.int64)
    return Segments(limit, np.sin(limit), np.cos(limit), np.empty((10, 3)), start, branches)


@compiled
def _write_coefficients(circle, F):
    c_a, s_a, c_g, s_g = circle.c_a, circle.s_a, circle.c_g, circle.s_g
    c_b, s_b, c_d, s_d = circle.c_b, circle.s_b, circle.c_d, circle.s_d
    w00, w01, w02, w10, w11, w12, w20, w21, w22 = circle.W
    F[0, 0], F[0, 1], F[0, 2] = -s_a * s_b, c_a * c_g * s_b, c_a * s_g * c_b
    F[1, 0], F[1, 1], F[1, 2] = c_a * s_b, s_a * c_g * s_b, s_a * s_g * c_b
    F[2, 0], F[2, 1], F[2, 2] = 0.0, c_b * s_g, s_b * c_g
    F[3, 0], F[3, 1], F[3, 2] = s_g, 0.0, 0.0
    F[4, 0], F[4, 1], F[4, 2] = c_d * w12, c_d * w02, s_d * w22
    F[5, 0], F[5, 1], F[5, 2] = -w02, w12, 0.0
    F[6, 0], F[6, 1], F[6, 2] = s_d * w10, s_d * w00, -c_d * w20
    F[7, 0], F[7, 1], F[7, 2] = -s_d * w11, -s_d * w01, c_d * w21
    F[8, 0], F[8, 1], F[8, 2] = 0.0, -s_g * s_b, c_g * c_b
    F[9, 0], F[9, 1], F[9, 2] = -s_d * w12, -s_d * w02, c_d * w22


@compiled
def _add_zeros(a, b, c, zeros, count):
    """Appends the zeros of ``a sin + b cos + c`` in [0, 2 pi); returns how many there are now."""
    amplitude = np.sqrt(a * a + b * b)
    if not abs(c) < amplitude:
        return count
    middle, half = np.arctan2(a, b), np.arccos(-c / amplitude)
    for zero in (middle - half, middle + half):
        zeros[count] = zero + 2.0 * np.pi if zero < 0.0 else zero
        zeros[count] -= 2.0 * np.pi if zeros[count] >= 2.0 * np.pi else 0.0
        count += 1
    return count


@compiled
def _cut(segments):
    """Writes all zeros, ascending, those that coincide once; returns how many."""
    F, zeros, count = segments.coefficients, segments.start, 0
    for k in range(4):
        s, c = segments.s_limit[_TURNING[k]], segments.c_limit[_TURNING[k]]
        x, y = F[2 * k], F[2 * k + 1]
        for sign in (-s, s):
            a, b = c * y[0] + sign * x[0], c * y[1] + sign * x[1]
            count = _add_zeros(a, b, c * y[2] + sign * x[2], zeros, count)
    for k in range(2):
        z = F[8 + k]
        count = _add_zeros(z[0], z[1], z[2] - segments.c_limit[_BENDING[k]], zeros, count)
    for i in range(1, count):
        zero, j = zeros[i], i
        while j > 0 and zeros[j - 1] > zero:
            zeros[j] = zeros[j - 1]
            j -= 1
        zeros[j] = zero
    distinct = min(count, 1)
    for i in range(1, count):
        # Zeros that are closer than this [rad] count as one: windows that narrow are left out.
        if zeros[i] - zeros[distinct - 1] > 1e-10:
            zeros[distinct] = zeros[i]
            distinct += 1
    return distinct


@compiled
def _inside(segments, phi):
    """The branches that are inside the limits at an elbow angle, joint 4 apart, as bits."""
    F, c_limit = segments.coefficients, segments.c_limit
    s, c = fast_sincos(phi)
    for k in range(2):
        cosine = F[8 + k, 0] * s + F[8 + k, 1] * c + F[8 + k, 2]
        if cosine < c_limit[_BENDING[k]]:
            return 0
    # Two bits for each of joints 1, 3, 5 and 7: inside the limits as it is, and after half a turn.
    inside = 0
    for k in range(4):
        x = F[2 * k, 0] * s + F[2 * k, 1] * c + F[2 * k, 2]
        y = F[2 * k + 1, 0] * s + F[2 * k + 1, 1] * c + F[2 * k + 1, 2]
        edge = np.sqrt(x * x + y * y) * c_limit[_TURNING[k]]
        inside |= ((1 if x >= edge else 0) + (2 if -x >= edge else 0)) << (2 * k)
    branches = 0
    for branch in range(8):
        elbow, shoulder, wrist = branch >> 2, (branch >> 1) & 1, branch & 1
        good = (inside >> shoulder) & (inside >> (2 + (shoulder ^ elbow)))
        good &= (inside >> (4 + (wrist ^ elbow))) & (inside >> (6 + wrist))
        branches |= (good & 1) << branch
    return branches


@compiled
def segments_kernel(circle, segments):
    """Writes the segments of a pose, at least one; returns how many, or 0 where no branch is in."""
    if not circle.reached or circle.q4 > segments.limit[3]:
        return 0
    start, branches = segments.start, segments.branches
    _write_coefficients(circle, segments.coefficients)
    count = _cut(segments)
    if count == 0:
        start[0], count = 0.0, 1
    start[count] = start[0] + 2.0 * np.pi
    some = 0
    for k in range(count):
        branches[k] = _inside(segments, 0.5 * (start[k] + start[k + 1]))
        some |= branches[k]
    return count if some else 0
