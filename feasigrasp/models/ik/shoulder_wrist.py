"""Closed-form inverse kinematics of 7R arms whose axes 1 to 3 meet in S, and 5 and 6 in W.

With the flange at M for q = 0, a flange pose X asks for ``e_1 ... e_7 = X M^-1``, with the turn e_i
about the axis h_i (product of exponentials; Murray, Li and Sastry, "A Mathematical Introduction to
Robotic Manipulation", 1994). The last joint is the redundancy. With ``G = X M^-1 e_7^-1``,

    |e_4 W - S| = |G W - S|,    e_5 e_6 (G^-1 S) = e_4^-1 S,    e_1 e_2 h_3 = R_G R_456^-1 h_3

give q_4, (q_5, q_6) and (q_1, q_2) by Paden's and Kahan's subproblems 3 and 2, each with two
solutions; q_3 is the rest. Among them are the Franka Emika Panda and FR3, and the UFACTORY xArm 7.
"""

import math

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.subproblems import (
    angle_about,
    axis_of,
    next_to,
    point_of,
    rotated,
    rotated_back,
    turned_about,
    two_turns,
    wanted_motion,
)
from feasigrasp.models.numerics.vectors import dot, minus, step
from feasigrasp.models.robot.arm import GEOMETRY, LOWER, UPPER


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
