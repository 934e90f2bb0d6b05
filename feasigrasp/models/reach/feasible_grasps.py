"""Grasps of a moving object that the arm can intercept and follow, and verdicts on the others."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.grasps.filter import above_table
from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet, Rejection
from feasigrasp.models.grasps.hand_clearance import MARGIN, THIN_WALL, hand_freedom
from feasigrasp.models.grasps.suction import seal_state
from feasigrasp.models.quantities import POSES, ArrayOf, NotNegative
from feasigrasp.models.reach.interception import InterceptionOptions, Situation, find_interceptions
from feasigrasp.models.reach.kernels import REACHABLE
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict
from feasigrasp.models.robot.gripper import SuctionCup
from feasigrasp.models.shape.gpdf import Gpdf

#: Most grasps that are kept: what a controller ranks anew in 4 ms. Source: guessed.
MOST = 32
#: A grasp takes the place of one that was kept if it saves this [s]: more than a controller asks
#: for (`HorizonOptions.switch`), so that no grasp leaves the set before the controller leaves it.
#: Source: guessed.
_KEPT = 0.5


@dataclass(frozen=True, eq=False)
class JudgedGrasps(Frozen):
    """The grasps in reach, and what became of every one.

    Attributes:
        grasps: Those that are kept, in the object frame, the best first; their ``on_object`` has
            the ids of all that were given.
        verdicts: A `Verdict` on every grasp given, then on the 180-degree flip of every grasp, if
            those count.
    """

    grasps: GraspSet
    verdicts: tuple[str, ...] = ()


def judged(grasps: GraspSet, both: GraspSet, kept: Indices, verdicts: Array) -> JudgedGrasps:
    """Of grasps and their flips, ``both``, those kept, in order, with verdicts on the others."""
    verdicts[kept] = Verdict.KEPT
    counts = Counter(reason for reason in verdicts if reason != Verdict.KEPT)
    chosen = both.select(kept).counted(counts)
    return JudgedGrasps(replace(chosen, on_object=grasps.id), tuple(verdicts.tolist()))


@checked(ReachabilityError)
def feasible_grasps(
    grasps: GraspSet,
    now: Situation,
    reachability: Reachability,
    options: InterceptionOptions,
    *,
    symmetric_grasps: bool = True,
    kept_before: Annotated[ArrayLike, ArrayOf(("k",), dtype=np.int64)] = (),
) -> JudgedGrasps:
    """The grasps, flips included, that cost least to intercept and follow.

    One that is never intercepted has the verdict of its present pose; where that is in reach, "no
    way in" if the pose behind it is not, else "out of reach soon". One that costs too much has
    "better grasps in reach".

    Grasps are in the object frame. The flip of a ``symmetric_grasps`` counts as another, and
    ``kept_before`` (k,) are ids of those that were kept last. Raises ReachabilityError for an
    argument of another type or shape.
    """
    both = grasps.with_symmetric() if symmetric_grasps else grasps
    if len(both) == 0 or not now.known:
        verdicts = np.full(len(both), Verdict.WRIST, dtype=object)
        return judged(grasps, both, np.zeros(0, dtype=int), verdicts)
    cost = find_interceptions(both.X_OG, both.score, now, reachability, options).cost
    cost = cost - _KEPT * (np.isin(both.id, kept_before) & (both.id != UNKNOWN))
    order = np.argsort(cost, kind="stable")
    verdicts = np.full(len(both), Verdict.BETTER, dtype=object)
    lost = np.flatnonzero(~np.isfinite(cost))
    verdicts[lost] = reasons(now.X_WO @ both.X_OG[lost], reachability, options.way_in)
    return judged(grasps, both, order[: min(MOST, len(both) - len(lost))], verdicts)


def reasons(X_WG: Array, reachability: Reachability, way_in: float) -> list[Verdict]:
    """Verdicts on grasps at present poses (n, 4, 4) that are never intercepted."""
    behind = X_WG.copy()
    behind[:, :3, 3] -= way_in * behind[:, :3, 2]
    codes, comes = reachability.verdicts(X_WG), reachability.reachable(behind)
    in_reach = [Verdict.SOON if each else Verdict.NO_WAY_IN for each in comes]
    return [VERDICTS[c] if c != REACHABLE else v for c, v in zip(codes, in_reach, strict=True)]


@dataclass(frozen=True, eq=False)
class Feasibility(Frozen):
    """What becomes of n grasps.

    Attributes:
        verdicts: `Verdict.REACHABLE`, or why not: a `Rejection` or another `Verdict`.
        later: A `Verdict` on the pose of each a while later, of the arm alone.
        arrival: When the hand can be there, and follow, from now on, shape (n,) [s]; infinite where
            it cannot.
        q: Configurations then, shape (n, 7) [rad]; NaN likewise.
    """

    verdicts: tuple[str, ...]
    later: tuple[str, ...]
    arrival: Array
    q: Array


@checked(ReachabilityError)
def feasible_poses(
    X_OG: Annotated[ArrayLike, POSES],
    now: Situation,
    reachability: Reachability,
    *,
    gpdf: Gpdf | None = None,
    width: Annotated[ArrayLike, ArrayOf(("n",), "m")] | None = None,
    options: InterceptionOptions | None = None,
    ahead: NotNegative = 0.5,
) -> Feasibility:
    """Judges grasps by the filters of the pipeline, in their order; flips are not tried.

    Args:
        X_OG: Poses of the grasp frame in the object's, shape (n, 4, 4) [m].
        now: Arm and object.
        reachability: Hand, limits and clearances.
        gpdf: The object's field, and the table that it stands on (`Gpdf.table`); without one only
            the arm counts.
        width: Distances between the contacts, if they are known, shape (n,) [m]; of no matter to a
            suction cup, which has to seal on the field instead.
        options: Of the search for interceptions.
        ahead: When ``later`` is, from now on [s].

    Raises:
        ReachabilityError: An argument of another type or shape, or an unknown pose of the object.
    """
    if not now.known:
        raise ReachabilityError("feasible_poses: pose and twist of the object have to be finite")
    poses, options, hand = np.asarray(X_OG), options or InterceptionOptions(), reachability.gripper
    cup = hand if isinstance(hand, SuctionCup) else None
    widths = np.full(len(poses), THIN_WALL) if width is None or cup else np.asarray(width)
    verdicts = np.full(len(poses), Verdict.REACHABLE, dtype=object)
    left = np.arange(len(poses))

    def drop(kept: Mask, reason: str) -> Indices:
        verdicts[left[~kept]] = reason
        return left[kept]

    if width is not None and cup is None:
        left = drop(widths <= hand.max_opening - 2 * MARGIN, Rejection.TOO_WIDE)
    if gpdf is not None:
        left = drop(above_table(gpdf, poses[left], hand), Rejection.HITS_TABLE)
        if cup is not None:
            there, sealed, _ = seal_state(gpdf, poses[left], cup)
            left, sealed = drop(there, Rejection.OFF_SURFACE), sealed[there]
            left = drop(sealed, Rejection.NOT_FLAT)
        grasps = GraspSet(poses[left], widths[left], np.ones(len(left)))
        free, _ = hand_freedom(gpdf, grasps, np.full(len(left), np.nan), hand, 0)
        left = drop(free, Rejection.COLLIDES)
    found = find_interceptions(poses[left], np.ones(len(left)), now, reachability, options)
    met = np.isfinite(found.cost)
    lost = left[~met]
    verdicts[lost] = reasons(now.X_WO @ poses[lost], reachability, options.way_in)
    arrival, q = np.full(len(poses), np.inf), np.full((len(poses), found.q.shape[1]), np.nan)
    arrival[left[met]], q[left[met]] = found.arrival[met], found.q[met]
    X_WO = now.future(np.array([ahead]))[0]
    codes = reachability.verdicts(X_WO @ poses)
    later = tuple(str(VERDICTS[code]) for code in codes)
    return Feasibility(tuple(str(each) for each in verdicts), later, arrival, q)
