"""Comparison of IK solution sources: closed form, damped least squares, flow.

All sources get the same random reachable poses: those of configurations that are uniform inside the
limits and free of self-collision. A solution *reaches* its pose below 1 mm and 1 degree.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import pdist
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.closed_form import inside_limits_kernel
from feasigrasp.models.ik.self_motion import closed_form_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.runs.results.rows import Row
from feasigrasp.runs.results.statistics import Estimate, mean
from feasigrasp_lab.arm.least_squares import refine
from feasigrasp_lab.arm.self_collision import in_collision
from feasigrasp_lab.paper.ik_flow import IkFlow
from feasigrasp_lab.results.markdown import markdown_table

#: Draws one configuration (n, 7) of each pose (n, 4, 4); NaN where it finds none.
Source = Callable[[Array, int], Array]

#: A solution reaches its pose below these errors.
POSITION_TOLERANCE, ANGLE_TOLERANCE = 1e-3, np.deg2rad(1.0)
#: Arm angles that the closed form tries for a pose before it gives up.
LARGEST_TRIES, _TRIES_AT_ONCE = 1000, 16
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


class Sizes(NamedTuple):
    """How many poses errors are taken from, diversity is taken from, and are timed at once."""

    errors: int
    diversity: int
    timed: int


FULL, QUICK = Sizes(20_000, 1000, 1000), Sizes(2000, 200, 1000)


@compiled
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
    for _ in range(0, LARGEST_TRIES, _TRIES_AT_ONCE):
        psi = rng.uniform(-np.pi, np.pi, (len(missing), _TRIES_AT_ONCE))
        found = q[missing]
        _closed_form_kernel(X_WF[missing], psi, rng.random(psi.shape), found)
        q[missing] = found
        missing = missing[np.isnan(found[:, 0])]
    return q


def from_random_seeds(X_WF: Array, seed: int) -> Array:
    """Damped least squares from uniform configurations, within the limits, until it is there."""
    q = IIWA_7.random_positions(np.random.default_rng(seed), len(X_WF))
    active = np.arange(len(X_WF))
    for _ in range(LARGEST_STEPS // _STEPS_AT_ONCE):
        q[active], position, angle = refine(
            X_WF[active], q[active], _STEPS_AT_ONCE, DAMPING, limit_margin=0.0
        )
        active = active[~_close(position, angle)]
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
        diversity: dict[str, float] = {}
        for name, source in tqdm(SOURCES.items(), desc="sources", leave=False):
            rows += _error_rows(name, source(poses, seed), poses)
            if name == "flow_unrefined":
                continue
            speed = _solutions_per_second(source, poses[: sizes.timed], seed)
            distance, branches = _diversity(source, poses[: sizes.diversity], seed)
            diversity[name] = distance.value
            ratio = distance.value / diversity["closed_form"]
            rows += [
                Row.plain("kinematics.solutions_per_s", name, speed, "1/s", _REPEATS),
                Row.of("kinematics.diversity_rad", name, distance, "rad"),
                Row.plain("kinematics.diversity_ratio", name, ratio, "1", sizes.diversity),
                Row.of("kinematics.branches", name, branches, "1"),
                Row.percent("kinematics.jump_percent", name, _jumps(source, poses, seed)),
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
        line = [source]
        for _, name, form in columns:
            value = values.get((f"kinematics.{name}", source))
            line.append("-" if value is None else format(value, form))
        lines.append(line)
    return markdown_table(["source", *(head for head, _, _ in columns)], lines)


def _close(position: Array, angle: Array) -> Mask:
    return (position < POSITION_TOLERANCE) & (angle < ANGLE_TOLERANCE)


def _reached(X_WF: Array, q: Array) -> Mask:
    """Which configurations (n, 7) reach their poses (n, 4, 4)."""
    return _close(*refine(X_WF, q, 0)[1:])


def _error_rows(name: str, q: Array, X_WF: Array) -> list[Row]:
    _, position, angle = refine(X_WF, q, 0)
    found, reached = np.isfinite(position), _close(position, angle)
    mm, deg = 1e3 * position[found], np.rad2deg(angle[found])
    rows = []
    for figure, errors, unit in (("position", mm, "mm"), ("angle", deg, "deg")):
        row, average = f"kinematics.{figure}_error_{unit}", mean(errors, lower=0.0)
        rows.append(Row.plain(f"{row}_median", name, np.median(errors), unit, len(errors)))
        rows.append(Row.of(f"{row}_mean", name, average, unit))
    rows.append(Row.percent("kinematics.reached_percent", name, reached))
    if reached.any():
        inside = (np.abs(q[reached]) <= IIWA_7.position_limits).all(axis=1)
        free = ~in_collision(q[reached])
        rows.append(Row.percent("kinematics.inside_limits_percent", name, inside))
        rows.append(Row.percent("kinematics.collision_free_percent", name, free))
    if name == "flow":
        below = position < POSITION_TOLERANCE
        rows.append(Row.percent("kinematics.flow_refined_percent", "default", below))
    return rows


def _solutions_per_second(source: Source, X_WF: Array, seed: int) -> float:
    source(X_WF[:10], seed)  # compiles
    speeds = []
    for repeat in range(_REPEATS):
        started = time.process_time()
        q = source(X_WF, seed + repeat)
        spent = time.process_time() - started
        speeds.append(float(_reached(X_WF, q).sum()) / spent)
    return float(np.median(speeds))


def _jumps(source: Source, X_WF: Array, seed: int) -> Mask:
    """Which of the solutions that reach their poses do not follow a small motion of them."""
    rng = np.random.default_rng([seed, len(X_WF)])
    along, about = rng.normal(size=(2, len(X_WF), 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    about /= np.linalg.norm(about, axis=1, keepdims=True)
    moved = X_WF.copy()
    moved[:, :3, 3] += MOVE * along
    moved[:, :3, :3] = se3.so3_exp(TURN * about) @ X_WF[:, :3, :3]
    before, after = source(X_WF, seed), source(moved, seed)
    both = _reached(X_WF, before) & _reached(moved, after)
    return np.asarray(np.abs(after[both] - before[both]).max(axis=1) > JUMP)


def _diversity(source: Source, X_WF: Array, seed: int) -> tuple[Estimate, Estimate]:
    """Mean distance [rad] of two configurations of a pose, and number of branches among them."""
    X_WF = np.repeat(X_WF, PER_POSE, axis=0)
    q = source(X_WF, seed)
    reached = _reached(X_WF, q).reshape(-1, PER_POSE)
    distances, branches = [], []
    for configurations, valid in zip(q.reshape(-1, PER_POSE, IIWA_7.joints), reached, strict=True):
        some = configurations[valid]
        if len(some) >= 2:
            distances.append(pdist(some).mean())
            branches.append(len(np.unique(some[:, [1, 3, 5]] > 0.0, axis=0)))
    return mean(distances, lower=0.0), mean(branches, lower=0.0, upper=8.0)
