"""Sources of IK solutions: the closed form, or the IK flow as in the paper.

The flow's random numbers are the same at every call, as in the paper: what is drawn moves with the
poses.

Solutions are inside the limits, clear of collisions, and apart from one another and from those that
were kept.
"""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.self_motion import (
    arm_angle_kernel,
    configuration_kernel,
    inside_limits_kernel,
    self_motion_kernel,
)
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.reach.kernels import Search
from feasigrasp.models.robot.capsule_kernels import is_clear_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.arm import refine
from feasigrasp_lab.paper.ik_flow import load_ik_flow

#: Two solutions of one grasp are at least this distance apart [rad]. Source: guessed.
APART = 1.0


def from_flow(X_WF: Array, draws: int) -> Array:
    """Draws from the IK flow, refined by its three steps of the pseudo-inverse.

    Args:
        X_WF: Flange poses, shape (m, 4, 4).
        draws: How many of each.

    Returns:
        Configurations, shape (m, draws, 7) [rad], NaN where one misses its pose.
    """
    # A configuration reaches its pose below these errors [m, rad].
    position_tolerance, angle_tolerance = 1e-3, 0.02
    poses = np.repeat(X_WF, draws, axis=0)
    q, position, angle = refine(poses, load_ik_flow().solve(poses), steps=0)
    q[~((position < position_tolerance) & (angle < angle_tolerance))] = np.nan
    return q.reshape(-1, draws, IIWA_7.joints)


@compiled
def distance_kernel(a, b):
    """Euclidean distance of two configurations (7,) [rad]."""
    square = 0.0
    for k in range(len(a)):
        square += (a[k] - b[k]) ** 2
    return np.sqrt(square)


@compiled
def _select_kernel(candidates, q_now, previous, search, found):
    """Writes candidates (n, 7) inside the limits, nearest first, clear and apart; returns how many.

    One that is not finite is not inside.
    """
    distances = np.full(len(candidates), np.inf)
    for i in range(len(candidates)):
        if inside_limits_kernel(search.chain, candidates[i], search.limit_margin):
            distances[i] = distance_kernel(candidates[i], q_now)
    count = 0
    while count < len(found):
        i = int(np.argmin(distances))
        if not distances[i] < np.inf:
            break
        distances[i] = np.inf
        apart = True
        for k in range(len(previous)):
            apart = apart and distance_kernel(candidates[i], previous[k]) > APART
        for k in range(count):
            apart = apart and distance_kernel(candidates[i], found[k]) > APART
        if apart and is_clear_kernel(
            candidates[i], search.capsules, search.clearance, search.floor
        ):
            found[count] = candidates[i]
            count += 1
    return count


@compiled
def _closed_form_kernel(chain, X_WF, q_now, psis, q):
    """Writes all branches at k arm angles and at that of now (8 (k + 1), 7).

    False, and nothing written, if the wrist is out of reach.
    """
    circle = self_motion_kernel(chain, X_WF)
    if not circle.reached:
        return False
    for j in range(len(psis) + 1):
        s, c = fast_sincos(psis[j] if j < len(psis) else arm_angle_kernel(chain, q_now))
        for branch in range(8):
            configuration_kernel(circle, s, c, branch, q[8 * j + branch])
    return True


def closed_form_configurations(
    X_WF: Array, q_now: Array, previous: list[Array], per_pose: int, search: Search
) -> list[Array]:
    """New configurations of flange poses, by closed-form inverse kinematics.

    Args:
        X_WF: Flange poses, shape (m, 4, 4).
        q_now: Joint positions [rad], shape (7,); near ones come first.
        previous: Configurations of each pose from the last update, shape (k, 7) each.
        per_pose: How many there may be of each pose, those of the last update counted.
        search: Limits and clearances.

    Returns:
        For each pose, shape (j, 7), nearest first.
    """
    q, found = np.empty((8 * (len(search.psis) + 1), IIWA_7.joints)), []
    for X, taken in zip(X_WF, previous, strict=True):
        reached = _closed_form_kernel(search.chain, X, q_now, search.psis, q)
        found.append(_selected(q, q_now, taken, per_pose if reached else 0, search))
    return found


def flow_configurations(
    X_WF: Array, q_now: Array, previous: list[Array], per_pose: int, search: Search
) -> list[Array]:
    """As `closed_form_configurations`, of draws from the flow."""
    if len(X_WF) == 0:
        return []
    # Draws for each pose where new solutions are looked for.
    pairs = zip(from_flow(X_WF, 8), previous, strict=True)
    return [_selected(q, q_now, taken, per_pose, search) for q, taken in pairs]


def _selected(q: Array, q_now: Array, previous: Array, per_pose: int, search: Search) -> Array:
    """Of configurations (n, 7) those that are any good, nearest first."""
    found = np.empty((max(per_pose - len(previous), 0), IIWA_7.joints))
    return found[: _select_kernel(q, q_now, previous, search, found)]
