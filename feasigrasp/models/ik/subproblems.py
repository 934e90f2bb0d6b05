"""Closed-form inverse kinematics of 7R and 6R arms, by canonical subproblems.

The subproblems (Paden 1986; Kahan 1983) are about turns about the joint axes of an arm at q = 0, as
its `Arm.chain` has them; vectors are tuples.

With the flange at M for q = 0, a flange pose X asks for ``e_1 ... e_n = X M^-1``, with the turn e_i
about the axis h_i (product of exponentials; Murray, Li and Sastry, "A Mathematical Introduction to
Robotic Manipulation", 1994).

7R, axes 1 to 3 meet in S, 5 and 6 in W: the last joint is the redundancy. With
``G = X M^-1 e_7^-1``,

    |e_4 W - S| = |G W - S|,    e_5 e_6 (G^-1 S) = e_4^-1 S,    e_1 e_2 h_3 = R_G R_456^-1 h_3

give q_4, (q_5, q_6) and (q_1, q_2) by subproblems 3 and 2, each with two solutions; q_3 is the
rest. Among them are the Franka Emika Panda and FR3, and the UFACTORY xArm 7.

6R, axes 2 to 4 are parallel, and axes 5 and 6 meet: with ``G = X M^-1``, turns about the parallel
axes leave what is along them, so that subproblem 4 gives q_1 from the point P where axes 5 and 6
meet, and q_5 from the direction of axis 6. Then q_6 and q_2 + q_3 + q_4 follow, and the triangle of
the axes 2, 3 and 4 gives q_3. Among them are the Universal Robots (which have this form in Hawkins,
"Analytic Inverse Kinematics for the Universal Robots UR-5/UR-10 Arms", 2013) and the Unitree Z1.
"""

import math

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.vectors import cross, dot, minus, step
from feasigrasp.models.robot.arm import DIRECTION, GEOMETRY, LOWER, PLACE, POINT, ROTATION, UPPER


@compiled(forceinline=True)
def axis_of(chain, j):
    """Direction of joint j's axis."""
    return chain[j, DIRECTION], chain[j, DIRECTION + 1], chain[j, DIRECTION + 2]


@compiled(forceinline=True)
def point_of(chain, j):
    """A point on joint j's axis."""
    return chain[j, POINT], chain[j, POINT + 1], chain[j, POINT + 2]


@compiled(forceinline=True)
def rotated(R, v):
    """A vector in the frame whose rotation has the rows R."""
    return dot(R[0], v), dot(R[1], v), dot(R[2], v)


@compiled(forceinline=True)
def rotated_back(R, v):
    """A vector by the inverse of the rotation with the rows R."""
    return (
        R[0][0] * v[0] + R[1][0] * v[1] + R[2][0] * v[2],
        R[0][1] * v[0] + R[1][1] * v[1] + R[2][1] * v[2],
        R[0][2] * v[0] + R[1][2] * v[1] + R[2][2] * v[2],
    )


@compiled(forceinline=True)
def turned_about(k, p, s, c, v):
    """A point turned about the axis k through p by an angle of sine s and cosine c (Rodrigues)."""
    u = minus(v, p)
    w, along = cross(k, u), (1.0 - c) * dot(k, u)
    return (
        p[0] + c * u[0] + s * w[0] + along * k[0],
        p[1] + c * u[1] + s * w[1] + along * k[1],
        p[2] + c * u[2] + s * w[2] + along * k[2],
    )


@compiled(forceinline=True)
def angle_about(k, p, q):
    """Subproblem 1: the angle about the axis k that takes the vector p to q."""
    return math.atan2(dot(k, cross(p, q)), dot(p, q) - dot(k, p) * dot(k, q))


@compiled(forceinline=True)
def two_turns(k_1, k_2, p, q, sign):
    """Subproblem 2: whether ``e_1 e_2 p = q`` has a solution, and its angles; one by each sign."""
    d = dot(k_1, k_2)
    u, v = dot(k_2, p), dot(k_1, q)
    alpha, beta = (d * u - v) / (d * d - 1.0), (d * v - u) / (d * d - 1.0)
    x = cross(k_1, k_2)
    gamma = dot(p, p) - alpha * alpha - beta * beta - 2.0 * alpha * beta * d
    found = gamma >= -1e-9
    gamma = sign * math.sqrt(max(gamma, 0.0) / dot(x, x))
    z = step(step(step((0.0, 0.0, 0.0), alpha, k_1), beta, k_2), gamma, x)
    return found, angle_about(k_1, z, q), angle_about(k_2, p, z)


@compiled(forceinline=True)
def turn_to_height(h, k, p, d, sign):
    """Subproblem 4: whether ``h . e p = d`` has a solution, and its angle; one by each sign."""
    along = dot(h, k) * dot(k, p)
    s, c = dot(h, cross(k, p)), dot(h, p) - along
    length = math.sqrt(s * s + c * c)
    v = (d - along) / length
    return abs(v) <= 1.0 + 1e-12, math.atan2(s, c) + sign * math.acos(min(max(v, -1.0), 1.0))


@compiled(forceinline=True)
def next_to(angle, chain, j, near):
    """The angle less whole turns: next to ``near``, and then inside the limits of joint j."""
    turn = 2.0 * math.pi
    angle += turn * round((near - angle) / turn)
    if angle < chain[j, LOWER]:
        return angle + turn
    return angle - turn if angle > chain[j, UPPER] else angle


@compiled(forceinline=True)
def wanted_motion(chain, X_WF):
    """Rows of the rotation, and translation, of ``X M^-1`` with the flange at M for q = 0."""
    n = len(chain) - 1
    r, m = ROTATION, PLACE
    # Columns of M^T are rows of the flange's rotation.
    c_0 = chain[n, r], chain[n, r + 1], chain[n, r + 2]
    c_1 = chain[n, r + 3], chain[n, r + 4], chain[n, r + 5]
    c_2 = chain[n, r + 6], chain[n, r + 7], chain[n, r + 8]
    x = X_WF[0, 0], X_WF[0, 1], X_WF[0, 2]
    y = X_WF[1, 0], X_WF[1, 1], X_WF[1, 2]
    z = X_WF[2, 0], X_WF[2, 1], X_WF[2, 2]
    R = (
        (dot(x, c_0), dot(x, c_1), dot(x, c_2)),
        (dot(y, c_0), dot(y, c_1), dot(y, c_2)),
        (dot(z, c_0), dot(z, c_1), dot(z, c_2)),
    )
    place = chain[n, m], chain[n, m + 1], chain[n, m + 2]
    return R, minus((X_WF[0, 3], X_WF[1, 3], X_WF[2, 3]), rotated(R, place))


@compiled
def shoulder_wrist_kernel(chain, X_WF, branch, q_7, q):
    """Writes the configuration (7,) of a branch, ``4 elbow + 2 wrist + shoulder``.

    Of angles that differ by whole turns it is, inside the limits, that next to what ``q`` held.
    False without a solution, or with joint 4 outside its limits.
    """
    n = len(chain) - 1
    S = chain[n, GEOMETRY], chain[n, GEOMETRY + 1], chain[n, GEOMETRY + 2]
    W = chain[n, GEOMETRY + 3], chain[n, GEOMETRY + 4], chain[n, GEOMETRY + 5]
    R, p = wanted_motion(chain, X_WF)
    h_7, p_7 = axis_of(chain, 6), point_of(chain, 6)
    s_7, c_7 = math.sin(q_7), math.cos(q_7)
    G_W = step(p, 1.0, rotated(R, turned_about(h_7, p_7, -s_7, c_7, W)))
    Gi_S = turned_about(h_7, p_7, s_7, c_7, rotated_back(R, minus(S, p)))

    h_4, p_4 = axis_of(chain, 3), point_of(chain, 3)
    to_W, to_S = minus(W, p_4), minus(S, p_4)
    along_W, along_S = dot(h_4, to_W), dot(h_4, to_S)
    across_W, across_S = step(to_W, -along_W, h_4), step(to_S, -along_S, h_4)
    way = minus(G_W, S)
    square = dot(way, way) - (along_W - along_S) ** 2
    ww, ss = dot(across_W, across_W), dot(across_S, across_S)
    cosine = (ww + ss - square) / (2.0 * math.sqrt(ww * ss))
    if not abs(cosine) <= 1.0 + 1e-10:
        return False
    bend = math.acos(min(max(cosine, -1.0), 1.0))
    straight = angle_about(h_4, across_W, across_S)
    q_4 = next_to(straight + (bend if branch < 4 else -bend), chain, 3, q[3])
    if not chain[3, LOWER] <= q_4 <= chain[3, UPPER]:
        return False
    s_4, c_4 = math.sin(q_4), math.cos(q_4)

    h_5, h_6 = axis_of(chain, 4), axis_of(chain, 5)
    target = minus(turned_about(h_4, p_4, -s_4, c_4, S), W)
    sign = 1.0 if (branch >> 1) & 1 else -1.0
    found, q_5, q_6 = two_turns(h_5, h_6, minus(Gi_S, W), target, sign)
    if not found:
        return False
    s_5, c_5, s_6, c_6 = math.sin(q_5), math.cos(q_5), math.sin(q_6), math.cos(q_6)

    h_1, h_2, h_3 = axis_of(chain, 0), axis_of(chain, 1), axis_of(chain, 2)
    o = (0.0, 0.0, 0.0)
    v, w = h_3, h_2
    for h, s, c in ((h_4, s_4, c_4), (h_5, s_5, c_5), (h_6, s_6, c_6), (h_7, s_7, c_7)):
        v, w = turned_about(h, o, -s, c, v), turned_about(h, o, -s, c, w)
    found, q_1, q_2 = two_turns(h_1, h_2, h_3, rotated(R, v), 1.0 if branch & 1 else -1.0)
    if not found:
        return False
    w = turned_about(h_1, o, -math.sin(q_1), math.cos(q_1), rotated(R, w))
    w = turned_about(h_2, o, -math.sin(q_2), math.cos(q_2), w)
    q_3 = angle_about(h_3, h_2, w)
    for j, angle in ((0, q_1), (1, q_2), (2, q_3), (4, q_5), (5, q_6)):
        q[j] = next_to(angle, chain, j, q[j])
    q[3], q[6] = q_4, q_7
    return np.isfinite(q_1 + q_2 + q_3 + q_5 + q_6)


@compiled
def parallel_axes_kernel(chain, X_WF, branch, q):
    """Writes the configuration (6,) of a branch, ``4 elbow + 2 wrist + shoulder``.

    Of angles that differ by whole turns it is that next to what ``q`` held. False without one.
    """
    n, o = len(chain) - 1, (0.0, 0.0, 0.0)
    P = chain[n, GEOMETRY], chain[n, GEOMETRY + 1], chain[n, GEOMETRY + 2]
    R, p = wanted_motion(chain, X_WF)
    h_1, h_2, h_5, h_6 = axis_of(chain, 0), axis_of(chain, 1), axis_of(chain, 4), axis_of(chain, 5)
    p_1, p_2, p_3 = point_of(chain, 0), point_of(chain, 1), point_of(chain, 2)
    p_4 = point_of(chain, 3)
    G_P = step(p, 1.0, rotated(R, P))
    shoulder = 1.0 if branch & 1 else -1.0
    found, back = turn_to_height(h_2, h_1, minus(G_P, p_1), dot(h_2, minus(P, p_1)), shoulder)
    if not found:
        return False
    q_1 = -back
    s_1, c_1 = math.sin(q_1), math.cos(q_1)
    seen = turned_about(h_1, o, -s_1, c_1, rotated(R, h_6))
    found, q_5 = turn_to_height(h_2, h_5, h_6, dot(h_2, seen), 1.0 if branch & 2 else -1.0)
    if not found:
        return False
    s_5, c_5 = math.sin(q_5), math.cos(q_5)
    u = rotated_back(R, turned_about(h_1, o, s_1, c_1, h_2))
    q_6 = -angle_about(h_6, turned_about(h_5, o, -s_5, c_5, h_2), u)
    all_three = angle_about(h_2, turned_about(h_5, o, s_5, c_5, h_6), seen)

    y = turned_about(h_6, P, -math.sin(q_6), math.cos(q_6), turned_about(h_5, P, -s_5, c_5, p_4))
    z = turned_about(h_1, p_1, -s_1, c_1, step(p, 1.0, rotated(R, y)))
    to_4, to_2, way = minus(p_4, p_3), minus(p_2, p_3), minus(z, p_2)
    to_4, to_2 = step(to_4, -dot(h_2, to_4), h_2), step(to_2, -dot(h_2, to_2), h_2)
    way = step(way, -dot(h_2, way), h_2)
    fore, upper = dot(to_4, to_4), dot(to_2, to_2)
    cosine = (fore + upper - dot(way, way)) / (2.0 * math.sqrt(fore * upper))
    if not abs(cosine) <= 1.0 + 1e-12:
        return False
    bend = math.acos(min(max(cosine, -1.0), 1.0))
    q_3 = angle_about(h_2, to_4, to_2) + (bend if branch & 4 else -bend)
    q_2 = angle_about(
        h_2, minus(turned_about(h_2, p_3, math.sin(q_3), math.cos(q_3), p_4), p_2), minus(z, p_2)
    )
    q_4 = all_three - q_2 - q_3
    # Above, both turn about axis 2; an axis that points against it counts the other way.
    q_3 *= 1.0 if dot(h_2, axis_of(chain, 2)) > 0.0 else -1.0
    q_4 *= 1.0 if dot(h_2, axis_of(chain, 3)) > 0.0 else -1.0
    for j, angle in enumerate((q_1, q_2, q_3, q_4, q_5, q_6)):
        q[j] = next_to(angle, chain, j, q[j])
    return np.isfinite(q_1 + q_2 + q_3 + q_4 + q_5 + q_6)
