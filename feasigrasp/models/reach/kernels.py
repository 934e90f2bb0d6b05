"""Compiled reachability test of a flange pose, with the nearest configuration.

What the pose alone decides comes first: the hand's clearance to the table and to what never moves.
Then the exact arm angles inside the joint limits; only there configurations are tried.
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.continuation import is_seeded, is_srs, other_kernel, redundancy_kernel
from feasigrasp.models.ik.redundancy import (
    RedundancySamples,
    Segments,
    make_segments,
    redundancy_samples_kernel,
    segments_kernel,
    travel_times_kernel,
)
from feasigrasp.models.ik.seeded import (
    from_seed_kernel,
    nearest_seeds_kernel,
    seed_configurations_kernel,
)
from feasigrasp.models.ik.self_motion import (
    REACHED,
    arm_angle_kernel,
    configuration_kernel,
    inside_limits_kernel,
    next_nearest_kernel,
    self_motion_kernel,
    travel_time_kernel,
)
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.numerics.vectors import dot, minus, step
from feasigrasp.models.robot.arm import LOWER, UPPER, VELOCITY
from feasigrasp.models.robot.capsule_kernels import closest_parameters, end_point, is_clear_kernel
from feasigrasp.models.robot.capsules import CapsuleModel

#: What `verdict_kernel` returns: places in `feasigrasp.models.reach.reachability.VERDICTS`. Source:
#: layout.
REACHABLE, WRIST, LIMITS, SELF_COLLISION, TABLE = 0, 1, 2, 3, 4


class Search(NamedTuple):
    """Data of arm, hand and table for the search kernels.

    Attributes:
        chain: That of the `Arm`.
        psis: Redundancies at which the nearest configuration is looked for, shape (n,) [rad].
        spacing: Largest step between the arm angles that are tried inside an interval [rad].
        limit_margin: Distance kept from the joint limits [rad].
        clearance: Distance kept between bodies [m].
        floor: Height above which all that moves is kept, for a clearance to the table [m].
        capsules: Arm and hand, with all pairs and movers to check.
        open: The same, with the pairs and movers that the flange pose alone does not decide.
        hand: Capsules that move with the flange, shape (h,).
        on_flange: Ends of the capsules in the flange frame, shape (c, 2, 3) [m]; only those of the
            hand mean anything.
        fixed: Ends of the capsules in the base frame, shape (c, 2, 3) [m]; only those of the base,
            and of link 1 on the axis of joint 1, mean anything.
        fixed_pairs: Pairs of such a capsule and one of the hand, shape (p, 2).
    """

    chain: Array
    psis: Array
    spacing: float
    limit_margin: float
    clearance: float
    floor: float
    capsules: CapsuleModel
    open: CapsuleModel
    hand: Indices
    on_flange: Array
    fixed: Array
    fixed_pairs: Indices


class Scratch(NamedTuple):
    """Scratch memory of a search, made once for many poses.

    Attributes:
        samples: Arm angles to choose the nearest configuration from, of an S-R-S arm.
        segments: The exact intervals of arm angle, likewise.
        found: Of another arm, the solutions of a pose for each redundancy and branch, shape (m, n).
        seeds: Of an arm without a closed form, the 16 nearest to a pose; and of any that is not
            S-R-S the branch of the solution in ``q``, negative for none; shape (17,).
        time: When the arm is there, infinite where it must not be, shape (m,) [s].
        q: The configuration that is being tried, shape (7,).
        ends: Ends of the hand's capsules in the base frame, shape (c, 2, 3).
    """

    samples: RedundancySamples
    segments: Segments
    found: Array
    seeds: Indices
    time: Array
    q: Array
    ends: Array


@compiled
def make_scratch(search, q_near):
    """Scratch memory of a search; the arm angle of ``q_near`` is tried beside those of ``search``.

    So the nearest solution moves smoothly with the pose.
    """
    srs, n, m = is_srs(search.chain), len(q_near), 8 * len(search.psis)
    m += 8 if n > 6 or is_seeded(search.chain) else 0
    return Scratch(
        redundancy_samples_kernel(
            search.psis, arm_angle_kernel(search.chain, q_near) if srs else np.nan
        ),
        make_segments(search.chain, search.limit_margin),
        np.empty((0 if srs else m, n)),
        np.empty(17, dtype=np.int64),
        np.empty(0 if srs else m),
        np.empty(len(q_near)),
        np.empty(search.fixed.shape),
    )


@compiled(forceinline=True)
def hand_verdict_kernel(X_WF, search, ends):
    """Verdict of the flange pose alone: TABLE, SELF_COLLISION with fixed links, or REACHABLE.

    Writes the ends of the hand's capsules into ``ends``.
    """
    local, radius, reach = search.on_flange, search.capsules.radius, search.capsules.reach
    hand, fixed, pairs, clearance = search.hand, search.fixed, search.fixed_pairs, search.clearance
    for k in range(len(hand)):
        c = hand[k]
        for e in range(2):
            x, y, z = local[c, e, 0], local[c, e, 1], local[c, e, 2]
            for i in range(3):
                ends[c, e, i] = X_WF[i, 0] * x + X_WF[i, 1] * y + X_WF[i, 2] * z + X_WF[i, 3]
        if min(ends[c, 0, 2], ends[c, 1, 2]) - radius[c] < search.floor:
            return TABLE
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        a0, a1 = end_point(fixed, i, 0), end_point(fixed, i, 1)
        b0, b1 = end_point(ends, j, 0), end_point(ends, j, 1)
        middles = minus(step(a0, 1.0, a1), step(b0, 1.0, b1))  # twice the way between them
        if dot(middles, middles) > 4.0 * (reach[i] + reach[j] + clearance) ** 2:
            continue
        _, _, d = closest_parameters(a0, a1, b0, b1)
        if dot(d, d) < (radius[i] + radius[j] + clearance) ** 2:
            return SELF_COLLISION
    return REACHABLE


@compiled(forceinline=True)
def is_admissible(q, model, search, floor):
    """Whether a configuration is inside the limits and clear of arm, hand and table."""
    return inside_limits_kernel(search.chain, q, search.limit_margin) and is_clear_kernel(
        q, model, search.clearance, floor
    )


@compiled(forceinline=True)
def _parts(segments, k, spacing):
    """Into how many equal parts, each tried in its middle, segment k is divided; and their size."""
    if segments.branches[k] == 0:
        return 0, 0.0
    length = segments.start[k + 1] - segments.start[k]
    parts = max(1, int(np.ceil(length / spacing)))
    return parts, length / parts


@compiled(forceinline=True)
def _write_candidate(circle, phi, branch, q):
    s, c = fast_sincos(phi)
    sign = 1.0 if branch < 4 else -1.0  # from the elbow angle to the arm angle
    configuration_kernel(circle, sign * s, sign * c, branch, q)


@compiled
def _first_in_segments(circle, search, scratch):
    """REACHABLE at the first admissible configuration, written to ``scratch.q``; or why not."""
    verdict, segments = LIMITS, scratch.segments
    for k in range(segments_kernel(circle, segments)):
        parts, size = _parts(segments, k, search.spacing)
        for part in range(parts):
            for branch in range(8):
                if (segments.branches[k] >> branch) & 1:
                    _write_candidate(
                        circle, segments.start[k] + (part + 0.5) * size, branch, scratch.q
                    )
                    if is_admissible(scratch.q, search.open, search, search.floor):
                        return REACHABLE
                    if verdict != TABLE:
                        without_table = is_admissible(scratch.q, search.open, search, -np.inf)
                        verdict = TABLE if without_table else SELF_COLLISION
    return verdict


@compiled
def _nearest_in_segments(circle, q_near, search, scratch, q_best):
    """As `nearest_kernel`, of the configurations that are tried inside the exact intervals."""
    shortest, segments, q = np.inf, scratch.segments, scratch.q
    for k in range(segments_kernel(circle, segments)):
        parts, size = _parts(segments, k, search.spacing)
        for part in range(parts):
            for branch in range(8):
                if (segments.branches[k] >> branch) & 1:
                    _write_candidate(circle, segments.start[k] + (part + 0.5) * size, branch, q)
                    time = travel_time_kernel(search.chain, q, q_near)
                    if time < shortest and is_admissible(q, search.open, search, search.floor):
                        shortest = time
                        q_best[:] = q
    return shortest


@compiled
def _solve_all(X_WF, q_near, search, scratch, most, again):
    """Writes the solutions (m, n) of a pose, and their travel times from ``q_near``.

    None that take longer than ``most`` [s]. Least squares begin ``again`` at the solutions of the
    pose before, else at its seeds; not yet where these take longer than half as much again.
    """
    chain, psis, found, seeded = search.chain, search.psis, scratch.found, is_seeded(search.chain)
    if seeded and not (again and np.isfinite(found[:, 0]).any()):
        nearest_seeds_kernel(chain, X_WF, scratch.seeds[:16])
        seed_configurations_kernel(chain, scratch.seeds, q_near, found)
    for k in range(len(found)):
        q, j, reached = found[k], k // 8, False
        if not seeded:
            r = psis[j] if j < len(psis) else redundancy_kernel(chain, q_near)
            q[:] = q_near
            reached = len(q) < 7 or abs(r - q_near[6]) <= most * chain[6, VELOCITY]
            reached = reached and other_kernel(chain, X_WF, k % 8, r, q)
        elif travel_time_kernel(chain, q, q_near) <= 1.5 * most:
            reached = from_seed_kernel(chain, X_WF, -1, q)
            for i in range(k):  # of solutions that are alike the first is kept
                reached &= not np.max(np.abs(found[i] - q)) < 1e-6
            q[0] = q[0] if reached else np.nan
        inside = reached and inside_limits_kernel(chain, q, search.limit_margin)
        scratch.time[k] = travel_time_kernel(chain, q, q_near) if inside else np.inf


@compiled
def _first_solution(X_WF, search, scratch):
    """As `_first_in_segments`, of an arm that is not S-R-S, among its samples of redundancy.

    Where those have none, among three more between any two. Without a closed form, from its seeds.
    """
    verdict, q, n, seeded = WRIST, scratch.q, len(search.psis), is_seeded(search.chain)
    step = search.psis[1] - search.psis[0] if n > 1 else 0.0
    if seeded:
        nearest_seeds_kernel(search.chain, X_WF, scratch.seeds[:16])
    for k in range(4 * n if n > 1 else (2 if seeded else 1)):
        r = search.psis[k % n] + (0.0, 0.5, -0.25, 0.25)[k // n] * step
        for branch in range(8):
            for i in range(len(q)):
                q[i] = 0.5 * (search.chain[i, LOWER] + search.chain[i, UPPER])
            if seeded:
                reached = from_seed_kernel(search.chain, X_WF, scratch.seeds[8 * k + branch], q)
            else:
                reached = other_kernel(search.chain, X_WF, branch, r, q)
            if not reached:
                continue
            if not inside_limits_kernel(search.chain, q, search.limit_margin):
                verdict = LIMITS if verdict == WRIST else verdict
                continue
            if is_admissible(q, search.open, search, search.floor):
                return REACHABLE
            if verdict != TABLE:
                without_table = is_admissible(q, search.open, search, -np.inf)
                verdict = TABLE if without_table else SELF_COLLISION
    return verdict


@compiled
def start_kernel(X_WF, q_near, search, scratch, most, again):
    """The `SelfMotion` of a pose, and all travel times from ``q_near``, for `next_kernel`.

    Of an arm that is not S-R-S there is none; times above ``most`` [s] may be left out. ``again``
    is whether the pose is near the last one.
    """
    if is_srs(search.chain):
        circle = self_motion_kernel(search.chain, X_WF)
        if circle.reached:
            travel_times_kernel(search.chain, circle, q_near, search.limit_margin, scratch.samples)
        return circle
    _solve_all(X_WF, q_near, search, scratch, most, again)
    return REACHED


@compiled
def next_kernel(circle, search, scratch):
    """Takes the least travel time out and writes its configuration to ``scratch.q``.

    Returns that time [s], infinite if nothing is left.
    """
    if is_srs(search.chain):
        return next_nearest_kernel(circle, scratch.samples, scratch.q)
    index = np.argmin(scratch.time)
    shortest = scratch.time[index]
    if shortest < np.inf:
        scratch.time[index] = np.inf
        scratch.q[:] = scratch.found[index]
        scratch.seeds[16] = index % 8
        if is_seeded(search.chain):
            scratch.seeds[16] = scratch.seeds[index] if index < len(scratch.time) - 1 else -1
    return shortest


@compiled
def verdict_kernel(X_WF, search, scratch):
    """Whether a flange pose can be reached: REACHABLE, or why not.

    SELF_COLLISION: every configuration inside the limits collides with itself. TABLE: not every
    one does, but all others are too close to the table; or the hand itself is.
    """
    circle = self_motion_kernel(search.chain, X_WF) if is_srs(search.chain) else REACHED
    if not circle.reached:
        return WRIST
    verdict = hand_verdict_kernel(X_WF, search, scratch.ends)
    if verdict != REACHABLE:
        return verdict
    if is_srs(search.chain):
        return _first_in_segments(circle, search, scratch)
    return _first_solution(X_WF, search, scratch)


@compiled
def nearest_kernel(X_WF, q_near, search, scratch, q_best):
    """Writes the admissible configuration that is soonest reached from ``q_near``.

    It is the best of the arm angles of ``search`` and that of ``q_near``; if none of them is
    admissible, the best inside the exact intervals of an S-R-S arm, the first that `verdict_kernel`
    finds of another. Returns the travel time [s], infinite if there is none.
    """
    if hand_verdict_kernel(X_WF, search, scratch.ends) != REACHABLE:
        return np.inf
    circle = start_kernel(X_WF, q_near, search, scratch, np.inf, False)
    if not circle.reached:
        return np.inf
    while next_kernel(circle, search, scratch) < np.inf:
        if is_admissible(scratch.q, search.open, search, search.floor):
            q_best[:] = scratch.q
            return travel_time_kernel(search.chain, scratch.q, q_near)
    if is_srs(search.chain):
        return _nearest_in_segments(circle, q_near, search, scratch, q_best)
    if _first_solution(X_WF, search, scratch) != REACHABLE:
        return np.inf
    q_best[:] = scratch.q
    return travel_time_kernel(search.chain, scratch.q, q_near)


@compiled
def nearest_batch_kernel(X_WF, q_near, search, q, times):
    """`nearest_kernel` of poses (n, 4, 4)."""
    scratch = make_scratch(search, q_near)
    for k in range(len(X_WF)):
        times[k] = nearest_kernel(X_WF[k], q_near, search, scratch, q[k])


@compiled
def verdict_batch_kernel(X_WF, search, verdicts):
    """`verdict_kernel` of poses (n, 4, 4)."""
    scratch = make_scratch(search, np.zeros(len(search.chain) - 1))
    for k in range(len(X_WF)):
        verdicts[k] = verdict_kernel(X_WF[k], search, scratch)


@compiled
def admissible_batch_kernel(Q, search, admissible):
    """Whether configurations (n, 7) are inside the limits and clear of arm, hand and table."""
    for k in range(len(Q)):
        admissible[k] = is_admissible(Q[k], search.capsules, search, search.floor)
