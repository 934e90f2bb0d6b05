"""Where configurations come from: closed form, damped least squares or the flow, on the same poses.

All sources get the same random reachable poses: those of configurations that are uniform inside the
limits and free of self-collision. A solution *reaches* its pose below 1 mm and 1 degree.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.arm_circle import closed_form_kernel
from feasigrasp.models.ik.closed_form import inside_limits_kernel
from feasigrasp.models.ik.flow import IkFlow
from feasigrasp.models.ik.least_squares import refine
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.robot.self_collision import in_collision
from feasigrasp.results.markdown import markdown_table
from feasigrasp.results.rows import Row
from feasigrasp.results.statistics import Estimate, mean, proportion

#: Draws one configuration (n, 7) of each pose (n, 4, 4); NaN where it finds none.
Source = Callable[[Array, int], Array]

#: A solution reaches its pose below these errors.
POSITION_TOLERANCE, ANGLE_TOLERANCE = 1e-3, np.deg2rad(1.0)
#: Arm angles that the closed form tries for a pose before it gives up.
LARGEST_TRIES = 1000
#: Steps of damped least squares from a random seed before it gives up, and their damping.
LARGEST_STEPS, DAMPING = 100, 0.05
#: Steps between two looks at which poses are reached.
_STEPS_AT_ONCE = 5
#: Configurations of a pose, to see how different they are.
PER_POSE = 20
#: How far a pose moves [m, rad] to see whether its solution follows, and what counts as a jump.
MOVE, TURN, JUMP = 2e-3, np.deg2rad(0.2), 0.2
_REPEATS = 5
# Entries of the random seed that keep the poses apart from all that the flow was trained on.
_STREAM = (0, 1)


@dataclass(frozen=True)
class Sizes:
    """How many poses errors are taken from, diversity is taken from, and are timed at once."""

    errors: int
    diversity: int
    timed: int


FULL, QUICK = Sizes(20_000, 1000, 1000), Sizes(2000, 200, 1000)


@njit(cache=True)
def _closed_form_kernel(X_WF, psi, choice, q):
    """Writes for each pose a random branch inside the limits at the first arm angle with any."""
    candidates = np.empty((8, IIWA_7.joints))
    inside = np.empty(8, dtype=np.int64)
    for n in range(len(X_WF)):
        for k in range(psi.shape[1]):
            count = 0
            for branch in range(closed_form_kernel(X_WF[n], psi[n, k], candidates)):
                if inside_limits_kernel(candidates[branch], 0.0):
                    inside[count] = branch
                    count += 1
            # A random one of the eight, or another arm angle: uniform over what is inside.
            slot = int(8 * choice[n, k])
            if slot < count:
                q[n] = candidates[inside[slot]]
                break


def from_closed_form(X_WF: Array, seed: int) -> Array:
    """Uniform over arm angle and branch among those inside the limits: exact and diverse."""
    rng = np.random.default_rng(seed)
    q = np.full((len(X_WF), IIWA_7.joints), np.nan)
    missing = np.arange(len(X_WF))
    tries, left = 16, LARGEST_TRIES
    while len(missing) and left > 0:
        psi = rng.uniform(-np.pi, np.pi, (len(missing), tries))
        found = q[missing]
        _closed_form_kernel(X_WF[missing], psi, rng.random(psi.shape), found)
        q[missing] = found
        missing = missing[np.isnan(found[:, 0])]
        left -= tries
    return q


def from_random_seeds(X_WF: Array, seed: int) -> Array:
    """Damped least squares from uniform configurations, within the limits, until it is there."""
    q = IIWA_7.random_positions(np.random.default_rng(seed), len(X_WF))
    active = np.arange(len(X_WF))
    for _ in range(LARGEST_STEPS // _STEPS_AT_ONCE):
        q[active], position, angle = refine(
            X_WF[active], q[active], _STEPS_AT_ONCE, DAMPING, limit_margin=0.0
        )
        active = active[~_reached(position, angle)]
        if len(active) == 0:
            break
    return q


SOURCES: dict[str, Source] = {
    "closed_form": from_closed_form,
    "dls": from_random_seeds,
    "flow": lambda X_WF, seed: IkFlow.load_default().solve(X_WF, seed),  # three refinement steps
    "flow_unrefined": lambda X_WF, seed: IkFlow.load_default().sample(X_WF, seed)[:, 0],
}


def reachable_poses(n: int, seed: int) -> Array:
    """Flange poses (n, 4, 4) of uniform configurations inside limits, free of self-collision."""
    # Entries that are left out count as zero: [seed] alone would be the flow's first batch.
    rng = np.random.default_rng([seed, *_STREAM])
    q = np.empty((0, IIWA_7.joints))
    while len(q) < n:
        more = IIWA_7.random_positions(rng, n)
        q = np.concatenate([q, more[~in_collision(more)]])
    return forward_kinematics(q[:n])


def ik_source_rows(seed: int, quick: bool) -> list[Row]:
    """Compares the sources: speed, error, validity and diversity.

    Args:
        seed: Of the poses and of all draws.
        quick: Whether a tenth of the poses is enough.

    Returns:
        Rows with presets ``closed_form``, ``dls``, ``flow`` and, for its errors before refinement,
        ``flow_unrefined``: ``kinematics.solutions_per_s`` (those that reach their poses, per CPU
        second on one thread), ``kinematics.position_error_mm`` and ``kinematics.angle_error_deg``
        with ``_median`` and ``_mean``, ``kinematics.reached_percent``, and of the solutions that
        reach their poses: ``kinematics.inside_limits_percent``,
        ``kinematics.collision_free_percent``, ``kinematics.diversity_rad`` (mean distance of two
        of 20 configurations of a pose), ``kinematics.diversity_ratio`` (to that of the closed
        form), ``kinematics.branches`` (of 8, among those 20) and ``kinematics.jump_percent`` (any
        joint moves by more than 0.2 rad as the pose moves by 2 mm and 0.2 degrees, with the same
        seed). Beside them, ``kinematics.flow_refined_percent``: solutions of the flow below 1 mm.
    """
    sizes = QUICK if quick else FULL
    poses = reachable_poses(sizes.errors, seed)
    rows: list[Row] = []
    with threadpool_limits(1):
        exact_diversity = None
        for name, source in tqdm(SOURCES.items(), desc="sources", leave=False):
            rows += _error_rows(name, source(poses, seed), poses)
            if name == "flow_unrefined":
                continue
            rows.append(_speed_row(name, source, poses[: sizes.timed], seed))
            distance, branches = _diversity(source, poses[: sizes.diversity], seed)
            if exact_diversity is None:
                exact_diversity = distance.value
            ratio = distance.value / exact_diversity
            rows += [
                Row.of("kinematics.diversity_rad", name, distance, "rad"),
                Row.plain("kinematics.diversity_ratio", name, ratio, "1", sizes.diversity),
                Row.of("kinematics.branches", name, branches, "1"),
                Row.of("kinematics.jump_percent", name, _jumps(source, poses, seed), "%", 100.0),
            ]
    return rows


def format_source_table(rows: Sequence[Row]) -> str:
    """The rows as a table for people: one line for each source."""
    columns = (
        ("solutions/s", "solutions_per_s", ".0f"),
        ("mm median", "position_error_mm_median", ".3g"),
        ("mm mean", "position_error_mm_mean", ".3g"),
        ("deg median", "angle_error_deg_median", ".3g"),
        ("deg mean", "angle_error_deg_mean", ".3g"),
        ("reached %", "reached_percent", ".1f"),
        ("in limits %", "inside_limits_percent", ".1f"),
        ("coll.-free %", "collision_free_percent", ".1f"),
        ("diversity", "diversity_ratio", ".2f"),
        ("branches", "branches", ".1f"),
        ("jumps %", "jump_percent", ".1f"),
    )
    values = {(row.name, row.preset): row.value for row in rows}
    lines = []
    for source in SOURCES:
        found = [values.get((f"kinematics.{name}", source)) for _, name, _ in columns]
        forms = zip(found, (form for _, _, form in columns), strict=True)
        lines.append([source, *("-" if v is None else format(v, form) for v, form in forms)])
    return markdown_table(["source", *(head for head, _, _ in columns)], lines)


def _reached(position: Array, angle: Array) -> Mask:
    return (position < POSITION_TOLERANCE) & (angle < ANGLE_TOLERANCE)


def _error_rows(name: str, q: Array, X_WF: Array) -> list[Row]:
    _, position, angle = refine(X_WF, q, 0)
    found, n = np.isfinite(position), len(q)
    reached = found & _reached(position, angle)
    inside = np.asarray((np.abs(q[reached]) <= IIWA_7.position_limits).all(axis=1))
    free = ~in_collision(q[reached])
    mm, deg = 1e3 * position[found], np.rad2deg(angle[found])

    def percent(figure: str, yes: Mask, preset: str = name) -> Row:
        estimate = proportion(int(yes.sum()), len(yes))
        return Row.of(f"kinematics.{figure}", preset, estimate, "%", 100.0)

    rows = [
        Row.plain("kinematics.position_error_mm_median", name, np.median(mm), "mm", len(mm)),
        Row.of("kinematics.position_error_mm_mean", name, mean(list(mm), lower=0.0), "mm"),
        Row.plain("kinematics.angle_error_deg_median", name, np.median(deg), "deg", len(deg)),
        Row.of("kinematics.angle_error_deg_mean", name, mean(list(deg), lower=0.0), "deg"),
        percent("reached_percent", reached),
    ]
    if reached.any():
        rows += [percent("inside_limits_percent", inside), percent("collision_free_percent", free)]
    if name == "flow":
        below = np.zeros(n, dtype=bool)
        below[found] = position[found] < POSITION_TOLERANCE
        rows.append(percent("flow_refined_percent", below, "default"))
    return rows


def _speed_row(name: str, source: Source, X_WF: Array, seed: int) -> Row:
    source(X_WF[:10], seed)  # compiles
    speeds = []
    for repeat in range(_REPEATS):
        started = time.process_time()
        q = source(X_WF, seed + repeat)
        spent = time.process_time() - started
        _, position, angle = refine(X_WF, q, 0)
        speeds.append(float(_reached(position, angle).sum()) / spent)
    value = float(np.median(speeds))
    return Row.plain("kinematics.solutions_per_s", name, value, "1/s", _REPEATS)


def _jumps(source: Source, X_WF: Array, seed: int) -> Estimate:
    """Share of solutions that do not follow a small motion of their pose."""
    rng = np.random.default_rng([seed, len(X_WF)])
    along, about = rng.normal(size=(2, len(X_WF), 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    about /= np.linalg.norm(about, axis=1, keepdims=True)
    moved = X_WF.copy()
    moved[:, :3, 3] += MOVE * along
    moved[:, :3, :3] = se3.so3_exp(TURN * about) @ X_WF[:, :3, :3]
    solutions = [source(poses, seed) for poses in (X_WF, moved)]
    errors = [refine(poses, q, 0)[1:] for poses, q in zip((X_WF, moved), solutions, strict=True)]
    both = _reached(*errors[0]) & _reached(*errors[1])
    step = np.abs(solutions[1][both] - solutions[0][both]).max(axis=1)
    return proportion(int((step > JUMP).sum()), len(step))


def _diversity(source: Source, X_WF: Array, seed: int) -> tuple[Estimate, Estimate]:
    """Mean distance [rad] of two configurations of a pose, and number of branches among them."""
    q = source(np.repeat(X_WF, PER_POSE, axis=0), seed)
    _, position, angle = refine(np.repeat(X_WF, PER_POSE, axis=0), q, 0)
    reached = _reached(position, angle).reshape(-1, PER_POSE)
    distances, branches = [], []
    for configurations, valid in zip(q.reshape(-1, PER_POSE, IIWA_7.joints), reached, strict=True):
        some = configurations[valid]
        if len(some) < 2:
            continue
        pairs = np.linalg.norm(some[:, None] - some, axis=2)[np.triu_indices(len(some), 1)]
        distances.append(float(pairs.mean()))
        branches.append(float(len(np.unique(some[:, [1, 3, 5]] > 0.0, axis=0))))
    return mean(distances, lower=0.0), mean(branches, lower=0.0, upper=8.0)
