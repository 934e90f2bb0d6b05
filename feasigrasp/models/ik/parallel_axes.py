"""Closed-form inverse kinematics of 6R arms whose axes 2 to 4 are parallel, and axes 5 and 6 meet.

With ``G = X M^-1`` as in `feasigrasp.models.ik.shoulder_wrist`: turns about the parallel axes leave
what is along them, so that subproblem 4 gives q_1 from the point P where axes 5 and 6 meet, and q_5
from the direction of axis 6. Then q_6 and q_2 + q_3 + q_4 follow, and the triangle of the axes 2, 3
and 4 gives q_3. Among them are the Universal Robots (which have this form in Hawkins, "Analytic
Inverse Kinematics for the Universal Robots UR-5/UR-10 Arms", 2013) and the Unitree Z1.
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
    turn_to_height,
    turned_about,
    wanted_motion,
)
from feasigrasp.models.numerics.vectors import dot, minus, step
from feasigrasp.models.robot.arm import GEOMETRY


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
