"""Sources of new IK solutions: closed form.

They are inside the limits, clear of collisions, and apart from one another and from the known ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.planning.cost_weights import CostWeights, running_cost_kernel
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

#: Two solutions of one grasp are at least this distance apart [rad]. Source: guessed.
APART = 1.0


#: A function with the arguments of `closed_form_configurations`, and its results.
FindConfigurations = Callable[
    [Array, Array, list[Array], int, Search, CostWeights, float], list[Array]
]


@compiled
def distance_kernel(a, b):
    """Euclidean distance of two configurations (7,) [rad]."""
    square = 0.0
    for k in range(IIWA_7.joints):
        square += (a[k] - b[k]) ** 2
    return np.sqrt(square)


@compiled
def select_kernel(candidates, scores, known, search, found):
    """Writes candidates (n, 7), best score first, clear and apart; uses the scores (n,) up."""
    count = 0
    while count < len(found):
        i = int(np.argmin(scores))
        if not scores[i] < np.inf:
            break
        scores[i] = np.inf
        apart = True
        for k in range(len(known)):
            apart = apart and distance_kernel(candidates[i], known[k]) > APART
        for k in range(count):
            apart = apart and distance_kernel(candidates[i], found[k]) > APART
        if apart and is_clear_kernel(
            candidates[i], search.capsules, search.clearance, search.floor
        ):
            found[count] = candidates[i]
            count += 1
    return count


@compiled
def _closed_form(X_WF, q_now, known, search, costs, worth, found):
    """All branches at the arm angles of the search and at that of now; returns how many."""
    circle = self_motion_kernel(X_WF)
    if not circle.reached or len(found) == 0:
        return 0
    psis = search.psis
    n = len(psis) + 1
    candidates, scores = np.empty((8 * n, IIWA_7.joints)), np.empty(8 * n)
    count = 0
    for j in range(n):
        s, c = fast_sincos(psis[j] if j < len(psis) else arm_angle_kernel(q_now))
        for branch in range(8):
            q = candidates[count]
            configuration_kernel(circle, s, c, branch, q)
            if inside_limits_kernel(q, search.limit_margin):
                scores[count] = distance_kernel(q, q_now) + worth * running_cost_kernel(
                    q, 0.0, costs[0]
                )
                count += 1
    return select_kernel(candidates, scores[:count], known, search, found) if count > 0 else 0


def closed_form_configurations(
    X_WF: Array,
    q_now: Array,
    known: list[Array],
    per_pose: int,
    search: Search,
    costs: CostWeights,
    radians_per_second: float,
) -> list[Array]:
    """New configurations of flange poses, by closed-form inverse kinematics.

    Args:
        X_WF: Flange poses, shape (m, 4, 4).
        q_now: Joint positions [rad], shape (7,); near ones come first.
        known: Configurations of each pose that are known, shape (k, 7) each.
        per_pose: How many there may be of each pose, the known ones counted.
        search: Limits and clearances.
        costs: What a posture costs, over their horizon.
        radians_per_second: How far it is worth going for a second.

    Returns:
        For each pose, shape (j, 7), best first.
    """
    worth = radians_per_second * costs.times[-1]
    result = []
    for X, taken in zip(X_WF, known, strict=True):
        found = np.empty((max(per_pose - len(taken), 0), IIWA_7.joints))
        count = _closed_form(X, q_now, taken, search, costs.record, worth, found)
        result.append(found[:count])
    return result
