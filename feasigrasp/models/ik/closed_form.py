"""Closed-form inverse kinematics of the iiwa 7 (Shimizu et al. 2008).

For a flange pose and an arm angle there are eight configurations: the signs of the shoulder, elbow
and wrist joints 2, 4 and 6 (see `feasigrasp.models.ik.self_motion` for the formulas and the
conventions at singularities). Joint limits are looked at here, collisions in
`feasigrasp.models.reach.reachability`.
"""

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.self_motion import (
    arm_angle_kernel,
    closed_form_kernel,
    configuration_kernel,
)
from feasigrasp.models.quantities import ANY_POSES, ArrayOf
from feasigrasp.models.robot.iiwa import IIWA_7

_ANGLES = ArrayOf(("...",), "rad", finite=False)


@compiled
def inside_limits_kernel(q, margin):
    """Whether every joint stays ``margin`` [rad] away from its limits."""
    for i in range(IIWA_7.joints):  # noqa: SIM110 - numba compiles the loop, not all()
        if not abs(q[i]) <= IIWA_7.position_limits[i] - margin:
            return False
    return True


@compiled
def travel_time_kernel(q_a, q_b):
    """max_j |dq_j| / v_j: the least time from one configuration to the other [s]."""
    worst = 0.0
    for i in range(IIWA_7.joints):
        worst = max(worst, abs(q_a[i] - q_b[i]) / IIWA_7.velocity_limits[i])
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
def _closed_form_batch(X_WF, psi, out):
    for k in range(len(X_WF)):
        if closed_form_kernel(X_WF[k], psi[k], out[k]) == 0:
            out[k] = np.nan


@checked()
def closed_form(X_WF: Annotated[ArrayLike, ANY_POSES], psi: Annotated[ArrayLike, _ANGLES]) -> Array:
    """All configurations that reach flange poses with given arm angles, limits not considered.

    Args:
        X_WF: Flange poses in the base frame, shape (..., 4, 4) [m].
        psi: Arm angles [rad], one for all poses or of shape (...).

    Returns:
        Shape (..., 8, 7) [rad]; NaN where the wrist centre is out of reach, or where ``X_WF`` or
        ``psi`` are not finite. Row ``4 elbow + 2 shoulder + wrist``: 0
        where joint 4, 2 or 6 is positive, 1 where it is negative.

    Raises:
        ArgumentError: ``X_WF`` has another shape or a rotation that is none (within
            `ROTATION_TOLERANCE` it is projected), or ``psi`` has another shape.
    """
    poses, psi = np.asarray(X_WF), np.asarray(psi)
    lead = poses.shape[:-2]
    if psi.shape not in ((), lead):
        raise ArgumentError(f"closed_form: psi has shape {psi.shape}, X_WF {lead}; give as many")
    angles = np.array(np.broadcast_to(psi, lead))
    out = np.empty((*lead, 8, IIWA_7.joints))
    _closed_form_batch(
        poses.reshape(-1, 4, 4), angles.reshape(-1), out.reshape(-1, 8, IIWA_7.joints)
    )
    return out


def arm_angle(q: ArrayLike) -> float:
    """Arm angle of a configuration [rad]: with it, `closed_form` of its flange pose contains it."""
    return float(arm_angle_kernel(IIWA_7.positions(q, 1)))
