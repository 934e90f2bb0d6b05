"""Feasible arm-angle intervals of a flange pose, per IK branch (Shimizu et al. 2008).

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
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.robot.iiwa import IIWA_7

_TWO_PI = 2.0 * np.pi
_MAX_ZEROS = 20
#: Zeros that are closer than this [rad] count as one: windows that narrow are left out.
_RESOLUTION = 1e-10
# Rows of the coefficients: x, y of joints 1, 3, 5, 7, then the cosines of joints 2 and 6.
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
def make_segments(margin):
    """Scratch memory for the segments of one pose, ``margin`` [rad] inside the joint limits."""
    limit = np.minimum(IIWA_7.position_limits - margin, np.pi)
    start, branches = np.empty(_MAX_ZEROS + 1), np.empty(_MAX_ZEROS + 1, dtype=np.int64)
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
        zeros[count] = zero + _TWO_PI if zero < 0.0 else zero
        zeros[count] -= _TWO_PI if zeros[count] >= _TWO_PI else 0.0
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
        if zeros[i] - zeros[distinct - 1] > _RESOLUTION:
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
    # Bit 0: the angle is inside the limits; bit 1: it is after half a turn.
    first = third = fifth = seventh = 0
    for k in range(4):
        x = F[2 * k, 0] * s + F[2 * k, 1] * c + F[2 * k, 2]
        y = F[2 * k + 1, 0] * s + F[2 * k + 1, 1] * c + F[2 * k + 1, 2]
        edge = np.sqrt(x * x + y * y) * c_limit[_TURNING[k]]
        inside = (1 if x >= edge else 0) + (2 if -x >= edge else 0)
        if k == 0:
            first = inside
        elif k == 1:
            third = inside
        elif k == 2:
            fifth = inside
        else:
            seventh = inside
    branches = 0
    for branch in range(8):
        elbow, shoulder, wrist = branch >> 2, (branch >> 1) & 1, branch & 1
        good = (first >> shoulder) & (third >> (shoulder ^ elbow))
        good &= (fifth >> (wrist ^ elbow)) & (seventh >> wrist)
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
    start[count] = start[0] + _TWO_PI
    some = 0
    for k in range(count):
        branches[k] = _inside(segments, 0.5 * (start[k] + start[k + 1]))
        some |= branches[k]
    return count if some else 0
