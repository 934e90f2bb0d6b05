"""Where new inverse-kinematics solutions of a grasp come from: closed form, flow, least squares.

All sources give configurations of one flange pose, best first, inside the limits, clear of
collisions, and apart from one another and from those that are known. The closed form finds
whatever there is; the IK flow, as in the paper, and damped least squares draw from it.
"""

from __future__ import annotations

from enum import StrEnum
from functools import lru_cache

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.planning.prices import Prices, rate_kernel
from feasigrasp.models.ik.arm_circle import (
    arm_angle_kernel,
    arm_circle_kernel,
    configuration_kernel,
)
from feasigrasp.models.ik.closed_form import inside_limits_kernel
from feasigrasp.models.ik.flow import IkFlow
from feasigrasp.models.ik.least_squares import refine
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.reach.kernels import Search
from feasigrasp.models.robot.collision_kernels import is_clear_kernel
from feasigrasp.models.robot.iiwa import IIWA_7

#: Two solutions of one grasp are at least so far apart [rad].
APART = 1.0
#: Draws for each pose of the flow and of damped least squares, unless told otherwise.
DRAWS = 8
# Steps and damping of the latter.
_STEPS, _DAMPING = 20, 0.05
# A configuration reaches its pose below these errors [m, rad].
_POSITION_TOLERANCE, _ANGLE_TOLERANCE = 1e-3, 0.02


class Source(StrEnum):
    """Where configurations of new solutions come from."""

    CLOSED_FORM = "closed_form"
    FLOW = "flow"
    DLS = "dls"


@compiled
def distance_kernel(a, b):
    """Euclidean distance of two configurations (7,) [rad]."""
    square = 0.0
    for k in range(IIWA_7.joints):
        square += (a[k] - b[k]) ** 2
    return np.sqrt(square)


@compiled
def _select(candidates, scores, known, search, found):
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
def _closed_form(X_WF, q_now, known, search, prices, worth, found):
    """All branches at the arm angles of the search and at that of now; returns how many."""
    circle = arm_circle_kernel(X_WF)
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
                scores[count] = distance_kernel(q, q_now) + worth * rate_kernel(q, 0.0, prices[0])
                count += 1
    return _select(candidates, scores[:count], known, search, found) if count > 0 else 0


@compiled
def _drawn(q, q_now, known, search, prices, worth, found):
    """Of drawn configurations (n, 7), those that are any good; returns how many."""
    scores = np.full(len(q), np.inf)
    for i in range(len(q)):
        if inside_limits_kernel(q[i], search.limit_margin):
            scores[i] = distance_kernel(q[i], q_now) + worth * rate_kernel(q[i], 0.0, prices[0])
    return _select(q, scores, known, search, found) if len(q) > 0 else 0


@lru_cache(maxsize=8)
def _random_configurations(draws: int) -> Array:
    return IIWA_7.random_positions(np.random.default_rng(0), draws)


def drawn_configurations(source: str, X_WF: Array, draws: int = DRAWS) -> Array:
    """Configurations (m, draws, 7) of flange poses (m, 4, 4), NaN where they do not reach them.

    The random numbers are the same at every call, as in the paper: what is drawn moves with the
    poses.
    """
    poses = np.repeat(X_WF, draws, axis=0)
    if source == Source.FLOW:
        q, position, angle = refine(poses, IkFlow.load_default().solve(poses, seed=0), steps=0)
    else:
        starts = np.tile(_random_configurations(draws), (len(X_WF), 1))
        q, position, angle = refine(poses, starts, _STEPS, _DAMPING, limit_margin=0.0)
    q[~((position < _POSITION_TOLERANCE) & (angle < _ANGLE_TOLERANCE))] = np.nan
    return q.reshape(len(X_WF), draws, IIWA_7.joints)


def new_configurations(
    source: str,
    X_WF: Array,
    q_now: Array,
    known: list[Array],
    per_pose: int,
    search: Search,
    prices: Prices,
    radians_per_second: float,
) -> list[Array]:
    """Configurations of flange poses that are not known yet.

    Args:
        source: How they are found, a `Source`.
        X_WF: Flange poses, shape (m, 4, 4).
        q_now: Joint positions [rad], shape (7,); near ones come first.
        known: Configurations of each pose that are known, shape (k, 7) each.
        per_pose: How many there may be of each pose, the known ones counted.
        search: Limits and clearances.
        prices: What a posture costs, over their horizon.
        radians_per_second: How far it is worth going for a second.

    Returns:
        For each pose, shape (j, 7), best first.
    """
    drawn = (
        drawn_configurations(source, X_WF) if source != Source.CLOSED_FORM and len(X_WF) else None
    )
    record, worth = prices.record, radians_per_second * prices.times[-1]
    result = []
    for i, (X, taken) in enumerate(zip(X_WF, known, strict=True)):
        found = np.empty((max(per_pose - len(taken), 0), IIWA_7.joints))
        if drawn is None:
            count = _closed_form(X, q_now, taken, search, record, worth, found)
        else:
            count = _drawn(drawn[i], q_now, taken, search, record, worth, found)
        result.append(found[:count])
    return result
