"""Closed-form inverse kinematics of the iiwa 7 over its self-motion manifold (Shimizu 2008).

The three shoulder axes meet in S, the three wrist axes in C. For a flange pose the triangle S,
elbow, C is rigid and turns about the line S-C; its angle is the arm's redundant degree of freedom
(Shimizu et al., "Analytical inverse kinematic computation for 7-DOF redundant manipulators with
joint limits", T-RO 2008). With the frame ``U = Rz(a) Ry(gamma)``, whose z-axis points from S to C,

    R_03 = U Rz(phi) Ry(beta)              R_47 = Ry(delta) Rz(-phi) W,    W = U^T R_WF,

where beta and delta are the triangle's angles at S and at C, ``beta + delta = |q4|``. Every entry
of both is ``A sin(phi) + B cos(phi) + C``, and the joint angles are their z-y-z Euler angles:
(q1, q2, q3) and (q5, q6, q7).

The *elbow angle* phi is the place of the elbow. Since ``Ry(-x) = Rz(pi) Ry(x) Rz(pi)``, the elbow
branch with q4 < 0 has its elbow at the same place after half a turn of q3 and of q5. The *arm
angle* psi is phi where q4 > 0 and ``phi - pi`` where q4 < 0: zero where the arm of either branch is
as it would be with q3 = 0, in the vertical plane through S and C.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.quantities import ANY_POSES, ArrayOf
from feasigrasp.models.robot.arm import GEOMETRY, LOWER, UPPER, VELOCITY, Arm
from feasigrasp.models.robot.iiwa import IIWA_7

#: Largest deviation of a pose's rotation matrix from a rotation, summed. Source: numerical.
ROTATION_TOLERANCE = 1e-4


class SelfMotion(NamedTuple):
    """Constants of the self-motion of a flange pose; ``c_``, ``s_``: cosine and sine.

    Attributes:
        reached: Whether the pose is one, and its wrist centre within reach; if not, nothing else
            means anything.
        q4: Joint 4 of the branch with q4 > 0 [rad].
        c_a: Azimuth of the wrist centre about the base axis (0 on the axis).
        s_a: Its sine.
        c_g: gamma, angle between the base axis and the line S-C.
        s_g: Its sine.
        c_b: beta, angle of the triangle at S.
        s_b: Its sine.
        c_d: delta, angle of the triangle at C.
        s_d: Its sine.
        W: R_WF in the frame U, row by row.
    """

    reached: bool
    q4: float
    c_a: float
    s_a: float
    c_g: float
    s_g: float
    c_b: float
    s_b: float
    c_d: float
    s_d: float
    W: tuple[float, float, float, float, float, float, float, float, float]


_NO_CIRCLE = SelfMotion(False, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, (0.0,) * 9)
#: Of an arm that is not S-R-S.
REACHED = _NO_CIRCLE._replace(reached=True)


@compiled(forceinline=True)
def _lengths(chain):
    """`Arm.lengths`."""
    n = len(chain) - 1
    return (
        *(chain[n, GEOMETRY], chain[n, GEOMETRY + 1]),
        *(chain[n, GEOMETRY + 2], chain[n, GEOMETRY + 3]),
    )


@compiled
def self_motion_kernel(chain, X_WF):
    """The `SelfMotion` of a flange pose (4, 4); not ``reached`` if it is too far, or no pose."""
    # So much farther than the stretched arm [m] the wrist may be: rounding of a pose on the edge.
    reach_tolerance = 1e-12
    r00, r01, r02 = X_WF[0, 0], X_WF[0, 1], X_WF[0, 2]
    r10, r11, r12 = X_WF[1, 0], X_WF[1, 1], X_WF[1, 2]
    r20, r21, r22 = X_WF[2, 0], X_WF[2, 1], X_WF[2, 2]
    shoulder, upper, lower, flange = _lengths(chain)
    x = X_WF[0, 3] - flange * r02
    y = X_WF[1, 3] - flange * r12
    z = X_WF[2, 3] - flange * r22 - shoulder
    length = np.sqrt(x * x + y * y + z * z)
    far, near = upper + lower - length, length - abs(upper - lower)
    # The columns: two unit vectors at right angles, and their cross product. False for NaN.
    error = abs(r00 * r00 + r10 * r10 + r20 * r20 - 1.0) + abs(r00 * r01 + r10 * r11 + r20 * r21)
    error += abs(r01 * r01 + r11 * r11 + r21 * r21 - 1.0) + abs(r10 * r21 - r20 * r11 - r02)
    error += abs(r20 * r01 - r00 * r21 - r12) + abs(r00 * r11 - r10 * r01 - r22)
    reached = far >= -reach_tolerance and near >= -reach_tolerance and length >= 1e-9
    if not (reached and error < ROTATION_TOLERANCE):
        return _NO_CIRCLE
    # Half of q4 from the triangle's sides: no cancellation next to a stretched or folded arm.
    s_half = np.sqrt(max(far, 0.0) * (upper + lower + length))
    c_half = np.sqrt(max(near, 0.0) * (length + abs(upper - lower)))
    q4 = 2.0 * np.arctan2(s_half, c_half)
    four = 4.0 * upper * lower
    s_4, c_4 = 2.0 * s_half * c_half / four, (c_half * c_half - s_half * s_half) / four
    s_b, c_b = lower * s_4 / length, (upper + lower * c_4) / length
    s_d, c_d = upper * s_4 / length, (lower + upper * c_4) / length
    rho = np.sqrt(x * x + y * y)
    c_a, s_a = (x / rho, y / rho) if rho > 1e-12 else (1.0, 0.0)
    c_g, s_g = z / length, rho / length
    # W = Ry(gamma)^T Rz(a)^T R_WF.
    x0, x1, x2 = c_a * r00 + s_a * r10, c_a * r01 + s_a * r11, c_a * r02 + s_a * r12
    y0, y1, y2 = c_a * r10 - s_a * r00, c_a * r11 - s_a * r01, c_a * r12 - s_a * r02
    W = (
        *(c_g * x0 - s_g * r20, c_g * x1 - s_g * r21, c_g * x2 - s_g * r22),
        *(y0, y1, y2),
        *(s_g * x0 + c_g * r20, s_g * x1 + c_g * r21, s_g * x2 + c_g * r22),
    )
    return SelfMotion(True, q4, c_a, s_a, c_g, s_g, c_b, s_b, c_d, s_d, W)


@compiled
def _turned(angle):
    """Half a turn further, in [-pi, pi]."""
    return angle - np.pi if angle > 0.0 else angle + np.pi


@compiled
def configuration_kernel(circle, s_psi, c_psi, branch, q):
    """Writes the configuration (7,) of an arm angle, given by sine and cosine, and a branch.

    Branches are ``4 elbow + 2 shoulder + wrist``, each 0 where joint 4, 2 or 6 is positive and 1
    where it is negative. The last angle of each triple is what is left of the rotation after the
    first, so that the product is exact next to the singularities too. Where joint 2 or 6 is zero,
    the joints beside it have a common axis: then joint 3 or 7 is zero (pi in the other branch).
    """
    # Below this sine of joint 2 or 6, the axes of the joints beside it count as parallel.
    singular = 1e-12
    elbow = 1.0 if branch < 4 else -1.0
    s, c = elbow * s_psi, elbow * c_psi  # of the elbow angle phi
    c_a, s_a, c_g, s_g = circle.c_a, circle.s_a, circle.c_g, circle.s_g
    c_b, s_b, c_d, s_d = circle.c_b, circle.s_b, circle.c_d, circle.s_d
    w00, w01, w02, w10, w11, w12, w20, w21, w22 = circle.W

    # Shoulder: Ry(gamma) Rz(phi) Ry(beta), and Rz(a) before it.
    x, y = c_g * s_b * c + s_g * c_b, s_b * s
    z = c_g * c_b - s_g * s_b * c
    r = np.sqrt(x * x + y * y)
    m00, m01 = c_g * c * c_b - s_g * s_b, -c_g * s
    m10, m11 = s * c_b, c
    if r > singular:
        c_1, s_1 = x / r, y / r
    else:
        c_1, s_1 = elbow * m11, -elbow * m01
    q[0] = np.arctan2(s_a * c_1 + c_a * s_1, c_a * c_1 - s_a * s_1)
    q[1] = np.arctan2(r, z)
    q[2] = np.arctan2(elbow * (c_1 * m10 - s_1 * m00), elbow * (c_1 * m11 - s_1 * m01))
    q[3] = elbow * circle.q4

    # Wrist: Ry(delta) Rz(-phi) W.
    t0, t1, t2 = c * w00 + s * w10, c * w01 + s * w11, c * w02 + s * w12
    x, y = c_d * t2 + s_d * w22, c * w12 - s * w02
    z = c_d * w22 - s_d * t2
    r = np.sqrt(x * x + y * y)
    m00, m01 = c_d * t0 + s_d * w20, c_d * t1 + s_d * w21
    m10, m11 = c * w10 - s * w00, c * w11 - s * w01
    if r > singular:
        c_5, s_5 = x / r, y / r
    else:
        c_5, s_5 = m11, -m01
    q[4] = np.arctan2(elbow * s_5, elbow * c_5)
    q[5] = np.arctan2(r, z)
    q[6] = np.arctan2(c_5 * m10 - s_5 * m00, c_5 * m11 - s_5 * m01)

    # Rz(a) Ry(b) Rz(c) = Rz(a + pi) Ry(-b) Rz(c + pi).
    if (branch >> 1) & 1:
        q[0], q[1], q[2] = _turned(q[0]), -q[1], _turned(q[2])
    if branch & 1:
        q[4], q[5], q[6] = _turned(q[4]), -q[5], _turned(q[6])


@compiled
def arm_angle_kernel(chain, q):
    """Arm angle of a configuration [rad]."""
    _, upper, lower, _ = _lengths(chain)
    s1, c1, s2, c2 = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1])
    s3, c3, s4, c4 = np.sin(q[2]), np.cos(q[2]), np.sin(q[3]), np.cos(q[3])
    # Upper arm R_03 e_z, forearm R_04 e_z, and the elbow's axis R_03 e_y.
    vx, vy = c1 * c2 * c3 - s1 * s3, s1 * c2 * c3 + c1 * s3
    x = upper * c1 * s2 + lower * (c4 * c1 * s2 - s4 * vx)
    y = upper * s1 * s2 + lower * (c4 * s1 * s2 - s4 * vy)
    z = upper * c2 + lower * (c4 * c2 + s4 * s2 * c3)
    ex, ey, ez = -c1 * c2 * s3 - s1 * c3, c1 * c3 - s1 * c2 * s3, s2 * s3
    # U^T R_03 = Rz(psi) Ry(+-beta): its y-axis is (-sin psi, cos psi, 0).
    rho = np.sqrt(x * x + y * y)
    length = np.sqrt(rho * rho + z * z)
    c_a, s_a = (x / rho, y / rho) if rho > 1e-12 else (1.0, 0.0)
    return np.arctan2(-(z * (c_a * ex + s_a * ey) - rho * ez) / length, c_a * ey - s_a * ex)


_ANGLES = ArrayOf(("...",), "rad", finite=False)


@compiled
def inside_limits_kernel(chain, q, margin):
    """Whether every joint stays ``margin`` [rad] away from its limits."""
    for i in range(len(q)):  # noqa: SIM110 - numba compiles the loop, not all()
        if not chain[i, LOWER] + margin <= q[i] <= chain[i, UPPER] - margin:
            return False
    return True


@compiled
def travel_time_kernel(chain, q_a, q_b):
    """max_j |dq_j| / v_j: the least time from one configuration to the other [s]."""
    worst = 0.0
    for i in range(len(q_a)):
        worst = max(worst, abs(q_a[i] - q_b[i]) / chain[i, VELOCITY])
    return worst


@compiled
def next_nearest_kernel(circle, samples, q):
    """Takes the least travel time out of the lanes and writes its configuration (7,).

    Returns that time [s], infinite if nothing is left.
    """
    m = len(samples.sine)
    times = samples.time.reshape(-1)
    index = np.argmin(times)
    shortest = times[index]
    if shortest < np.inf:
        times[index] = np.inf
        row, sample = index // m, index % m
        elbow = samples.elbow[sample]
        branch = row if elbow > 0.0 else 4 + row
        configuration_kernel(
            circle, elbow * samples.sine[sample], elbow * samples.cosine[sample], branch, q
        )
    return shortest


@compiled
def _closed_form_batch(chain, X_WF, psi, out):
    for k in range(len(X_WF)):
        circle = self_motion_kernel(chain, X_WF[k])
        if not circle.reached or not np.isfinite(psi[k]):
            out[k] = np.nan
            continue
        s, c = np.sin(psi[k]), np.cos(psi[k])
        for branch in range(8):
            configuration_kernel(circle, s, c, branch, out[k, branch])


@checked()
def closed_form(
    X_WF: Annotated[ArrayLike, ANY_POSES], psi: Annotated[ArrayLike, _ANGLES], arm: Arm = IIWA_7
) -> Array:
    """All configurations that reach flange poses with given arm angles, limits not considered.

    Args:
        X_WF: Flange poses in the base frame, shape (..., 4, 4) [m].
        psi: Arm angles [rad], one for all poses or of shape (...).
        arm: An S-R-S arm.

    Returns:
        Shape (..., 8, 7) [rad], row ``4 elbow + 2 shoulder + wrist``, each 0 where joint 4, 2 or 6
        is positive and 1 where it is negative; NaN where the wrist centre is out of reach, or where
        ``X_WF`` or ``psi`` are not finite.

    Raises:
        ArgumentError: ``X_WF`` has another shape or a rotation that is none (within
            `ROTATION_TOLERANCE` it is projected), or ``psi`` has another shape.
    """
    poses, psi = np.asarray(X_WF), np.asarray(psi)
    lead = poses.shape[:-2]
    if psi.shape not in ((), lead):
        raise ArgumentError(f"closed_form: psi has shape {psi.shape}, X_WF {lead}; give as many")
    angles = np.array(np.broadcast_to(psi, lead))
    out = np.empty((*lead, 8, arm.joints))
    _closed_form_batch(
        arm.chain, poses.reshape(-1, 4, 4), angles.reshape(-1), out.reshape(-1, 8, arm.joints)
    )
    return out


def arm_angle(q: ArrayLike, arm: Arm = IIWA_7) -> float:
    """Arm angle of a configuration [rad]: with it, `closed_form` of its flange pose contains it."""
    return float(arm_angle_kernel(arm.chain, arm.positions(q, 1)))
