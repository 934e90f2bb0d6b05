"""Solutions drawn anew at every update, as in the paper (section IV-D.2)."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.joint.field import distances_kernel, length_scale_kernel
from feasigrasp.models.control.joint.solutions import Solutions
from feasigrasp.models.control.joint.sources import drawn_configurations
from feasigrasp.models.control.planning.continuation import branch_kernel
from feasigrasp.models.ik.arm_circle import arm_angle_kernel
from feasigrasp.models.robot.iiwa import IIWA_7


def length_scale_of(q: Array, given: float) -> float:
    """The length scale [rad] of a field over configurations (n, 7); that of their spacing if 0."""
    if given > 0.0:
        return given
    r = np.empty((len(q), len(q)))
    distances_kernel(q, r)
    return float(length_scale_kernel(r))


def resampled_solutions(
    source: str, n: int, length_scale: float, time: float, X_OG: Array, X_WF: Array
) -> Solutions:
    """Solutions of all grasps, as many of each, from the same random numbers at every call.

    Args:
        source: ``flow`` or ``dls``.
        n: How many are drawn; those that miss their grasp are left out.
        length_scale: Of the field [rad]; 0 follows their spacing.
        time: Now [s].
        X_OG: Grasps in the object frame, shape (m, 4, 4).
        X_WF: Flange poses at them now, shape (m, 4, 4).

    Returns:
        Solutions that cost nothing and whose arm angles stay.
    """
    if len(X_OG) == 0:
        return Solutions.empty(time)
    drawn = drawn_configurations(source, X_WF, -(-n // len(X_OG)))
    # The first of every grasp, then the second, up to the number that is wanted.
    found = drawn.swapaxes(0, 1).reshape(-1, IIWA_7.joints)[:n]
    reached = np.isfinite(found).all(axis=1)
    grasp = (np.arange(len(found)) % len(X_OG))[reached]
    found = found[reached]
    still = np.zeros((len(found), 2))
    return Solutions(
        X_OG[grasp],
        np.array([branch_kernel(one) for one in found], dtype=np.int64),
        np.column_stack([[arm_angle_kernel(one) for one in found], still]),
        still,
        np.array([length_scale_of(found, length_scale), 0.0]),
        time,
    )
