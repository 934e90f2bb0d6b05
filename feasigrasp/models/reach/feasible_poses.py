"""Feasibility of grasps that others have sampled, by the filters of the pipeline."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.grasps.filter import above_table
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.hand_clearance import MARGIN, THIN_WALL, hand_freedom
from feasigrasp.models.grasps.suction import seal_state
from feasigrasp.models.quantities import POSES, ArrayOf, NotNegative
from feasigrasp.models.reach.feasible_grasps import reasons
from feasigrasp.models.reach.interception import InterceptionOptions, Situation, find_interceptions
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict
from feasigrasp.models.robot.suction_cup import SuctionCup
from feasigrasp.models.shape.gpdf import Gpdf


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
        if gpdf.table is not None:
            plane = gpdf.table * [1.0, 1.0, 1.0, -1.0]
            left = drop(above_table(poses[left], plane, hand), Rejection.HITS_TABLE)
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
