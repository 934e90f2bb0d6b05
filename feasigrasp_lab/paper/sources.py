"""Sampled IK solutions: the IK flow, as in the paper, or damped least squares.

The iteration is damped least squares from random configurations. The random numbers are the same at
every call, as in the paper: what is drawn moves with the poses.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.joint.sources import distance_kernel, select_kernel
from feasigrasp.models.control.planning.cost_weights import CostWeights, running_cost_kernel
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.reach.kernels import Search
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.arm.least_squares import refine
from feasigrasp_lab.paper.ik_flow import IkFlow

#: From flange poses (m, 4, 4) and the number of draws of each to configurations (m, draws, 7), NaN
#: where one misses its pose.
Draw = Callable[[Array, int], Array]


def from_flow(X_WF: Array, draws: int) -> Array:
    """Draws from the IK flow, refined by its three steps of the pseudo-inverse."""
    poses = np.repeat(X_WF, draws, axis=0)
    return _reached(
        *refine(poses, IkFlow.load_default().solve(poses, seed=0), steps=0), draws=draws
    )


def by_least_squares(X_WF: Array, draws: int) -> Array:
    """Damped least squares from random configurations, the same for every pose."""
    # Steps of damped least squares, and their damping.
    steps, damping = 20, 0.05
    poses = np.repeat(X_WF, draws, axis=0)
    starts = np.tile(_random_configurations(draws), (len(X_WF), 1))
    return _reached(*refine(poses, starts, steps, damping, limit_margin=0.0), draws=draws)


#: The values of ``control.source`` that solutions can be drawn from anew.
SOURCES: dict[str, Draw] = {"flow": from_flow, "dls": by_least_squares}


def _reached(q: Array, position: Array, angle: Array, *, draws: int) -> Array:
    # A configuration reaches its pose below these errors [m, rad].
    position_tolerance, angle_tolerance = 1e-3, 0.02
    q[~((position < position_tolerance) & (angle < angle_tolerance))] = np.nan
    return q.reshape(-1, draws, IIWA_7.joints)


@lru_cache(maxsize=8)
def _random_configurations(draws: int) -> Array:
    return IIWA_7.random_positions(np.random.default_rng(0), draws)


@compiled
def _drawn(q, q_now, known, search, costs, worth, found):
    """Of drawn configurations (n, 7), those that are any good; returns how many."""
    scores = np.full(len(q), np.inf)
    for i in range(len(q)):
        if inside_limits_kernel(q[i], search.limit_margin):
            scores[i] = distance_kernel(q[i], q_now) + worth * running_cost_kernel(
                q[i], 0.0, costs[0]
            )
    return select_kernel(q, scores, known, search, found) if len(q) > 0 else 0


def _drawn_configurations(
    draw: Draw,
    X_WF: Array,
    q_now: Array,
    known: list[Array],
    per_pose: int,
    search: Search,
    costs: CostWeights,
    radians_per_second: float,
) -> list[Array]:
    """As `feasigrasp.models.control.joint.sources.closed_form_configurations`, of what is drawn."""
    if len(X_WF) == 0:
        return []
    worth, result = radians_per_second * costs.times[-1], []
    # Draws for each pose where new solutions are looked for.
    for q, taken in zip(draw(X_WF, 8), known, strict=True):
        found = np.empty((max(per_pose - len(taken), 0), IIWA_7.joints))
        count = _drawn(q, q_now, taken, search, costs.record, worth, found)
        result.append(found[:count])
    return result


#: The values ``flow`` and ``dls`` of ``control.source``.
flow_configurations = partial(_drawn_configurations, from_flow)
least_squares_configurations = partial(_drawn_configurations, by_least_squares)
