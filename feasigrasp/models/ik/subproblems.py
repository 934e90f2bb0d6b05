"""Canonical subproblems of inverse kinematics (Paden 1986; Kahan 1983), for compiled loops.

Turns about the joint axes of an arm at q = 0, as its `Arm.chain` has them; vectors are tuples.
"""

import math

from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.vectors import cross, dot, minus, step
from feasigrasp.models.robot.arm import DIRECTION, LOWER, PLACE, POINT, ROTATION, UPPER


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
