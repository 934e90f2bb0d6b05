"""Stall detection and next-best-view selection for the wrist camera (Connolly 1985).

An object that turns shows all its sides by and by. One at rest does not: where nothing that was
found on the side that was seen can be reached, or come by, a hand that only waits waits for ever.
So it looks from another side. Of all directions it takes that from which it would see most of what
has not been seen yet, per second that it takes to get there.

It goes for grasps that are more likely than not, and sure to carry the object; the longer none of
these has been in reach, the less is asked of another one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.control.planning.search_pose import (
    SPEED_SHARE,
    configurations_at,
    direction,
    turned_views,
)
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import nearest_distance, sphere_points
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.non_maximum_suppression import filter_by_score
from feasigrasp.models.grasps.payload import filter_by_payload
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.shape.gpdf import Gpdf

#: Without any grasp in reach the hand waits so long before it looks elsewhere, and so long after
#: that before it looks from the next side [s]. Source: guessed.
WAITS, WAITS_AGAIN = 1.0, 0.4
#: It gets on if the way becomes so much shorter [m], or by this share of it. Source: guessed.
_PROGRESS, _PROGRESS_SHARE = 0.02, 0.3
#: What a turn of the hand counts as, beside its way [m/rad]. Source: guessed.
_LEVER = 0.1
#: Over this time without a good grasp it falls by e how good one has to be [s]. Chosen on seeds 4
#: and 5 of ReachCircular by camera: with 10 s hands waited where 2 s let them come near and see
#: more. Source: measured.
_RELAXES = 2.0
#: Grasps this near to one that was not come by [m], [rad] are given up with it, for so long [s].
#: Source: guessed.
_LIKE_IT, _FORGOTTEN = np.array([0.03, 0.5]), 15.0
#: A look takes no longer than this, and this long beside the way there [s]. Source: guessed.
_LONGEST, _DWELL = 5.0, 0.8
#: Directions that are considered, and the camera's distance from a small object there [m]. Source:
#: guessed.
_DIRECTIONS, _DISTANCE = 40, 0.36
#: A surface point farther than this from all that was seen is unseen [m]; it would be seen by a
#: camera that is no farther than this from the direction of its normal [cos]. Source: guessed.
_UNOBSERVED, _FACING = 0.012, 0.3
#: Directions this near to one that was looked from are no other side [cos]. Source: guessed.
_SAME_SIDE = 0.85
#: What a side is worth in which nothing is known to be unseen, as a share of the surface. Source:
#: guessed.
_CURIOSITY = 0.1


@dataclass(frozen=True, eq=False)
class Attempt(Frozen):
    """Progress of the hand towards its grasps, for stall detection.

    Attributes:
        left: Least way to a grasp until now [m]; infinite at first.
        since: When it was as little for the first time [s].
        none_since: Since when there is no grasp to go for [s]; NaN if there is one.
        time: When this was so [s].
        wanting: How long there has been none that is good, less how long there has [s].
        blocked: Whether it does not get on, and had better look elsewhere.
        given_up: Grasps that the hand did not come by, in O, shape (k, 4, 4) [m].
        given_up_at: When they were given up, shape (k,) [s].
        side: The direction in O from which the object is looked at now, shape (3,); None if the
            hand goes for a grasp.
        until: When that ends [s].
        sides: Directions from which it was looked at so, shape (m, 3).
    """

    left: float = np.inf
    since: float = np.nan
    none_since: float = np.nan
    time: float = np.nan
    wanting: float = 0.0
    blocked: bool = False
    given_up: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    given_up_at: Array = field(default_factory=lambda: np.zeros(0))
    side: Array | None = None
    until: float = -np.inf
    sides: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def least(self) -> float:
        """Least `GraspSet.payload_score`, and least share of even odds, of a usable grasp."""
        return float(np.exp(-self.wanting / _RELAXES))

    def usable(self, grasps: GraspSet) -> GraspSet:
        """The grasps that are not given up, and good enough."""
        grasps = _as_good(grasps, self.least)
        kept = self._left_of(grasps)
        return grasps if kept.all() else grasps.select(np.flatnonzero(kept))

    def _left_of(self, grasps: GraspSet) -> Mask:
        """Which of the grasps are not given up, shape (n,)."""
        kept = np.ones(len(grasps), dtype=bool)
        for X_OG in self.given_up:
            kept &= np.max(grasp_errors(grasps.X_OG, X_OG) / _LIKE_IT, axis=1) > 1.0
        return kept

    def interrupted(self, time: float) -> Attempt:
        """The attempt during a gap without data."""
        return Attempt(time=time, wanting=self.wanting)

    def _contented(self, time: float, grasps: GraspSet) -> Attempt:
        """The same at a time, content with less the longer no good grasp has been there.

        What it is content with comes back as slowly: grasps that are good by a hair would make the
        others come and go.
        """
        since = 0.0 if np.isnan(self.time) else time - self.time
        good = self._left_of(_as_good(grasps, 1.0)).any()
        wanting = max(0.0, self.wanting - since) if good else self.wanting + since
        return replace(self, time=time, wanting=wanting)

    def advanced(self, time: float, X_OH: Array, grasps: GraspSet, patience: float) -> Attempt:
        """The attempt at a time.

        Args:
            time: Now [s].
            X_OH: Pose of the hand in O, shape (4, 4) [m].
            grasps: Those that it is given.
            patience: Without progress for so long, the nearest grasp is given up [s].
        """
        lasting = time - self.given_up_at < _FORGOTTEN
        now = replace(self, given_up=self.given_up[lasting], given_up_at=self.given_up_at[lasting])
        now = now._contented(time, grasps)
        usable = now.usable(grasps)
        if now.side is not None:
            # What was out of reach may be in reach at present.
            over = time >= now.until or (now.left == np.inf and len(usable) > 0)
            if not over:
                return now
            return replace(now, side=None, left=np.inf, since=time, none_since=np.nan)
        if len(usable) == 0:
            none_since = time if np.isnan(now.none_since) else now.none_since
            patient = WAITS_AGAIN if none_since - now.until < WAITS else WAITS
            if time - none_since <= patient:
                return replace(now, none_since=none_since)
            return replace(now, left=np.inf, since=time, none_since=none_since, blocked=True)
        # Grasps that come and go do not make the hand get on.
        now = replace(now, none_since=np.nan)
        errors = grasp_errors(usable.X_OG, X_OH)
        ways = errors @ [1.0, _LEVER]
        progress = min(_PROGRESS, _PROGRESS_SHARE * now.left)
        if now.left == np.inf or ways.min() < now.left - progress:
            return replace(now, left=float(ways.min()), since=time)
        if time - now.since < patience:
            return now
        nearest = usable.X_OG[int(ways.argmin())]
        return replace(
            now,
            blocked=True,
            given_up=np.concatenate([now.given_up, nearest[None]]),
            given_up_at=np.append(now.given_up_at, time),
        )

    def looking(
        self, time: float, side: Array | None, travel: float, speed: float = 1.0
    ) -> Attempt:
        """The attempt while the arm moves to a viewpoint, ``travel`` seconds away at its limits.

        It takes so much longer at a ``speed`` of less than 1. Without a side the hand goes on as it
        is.
        """
        now = replace(self, blocked=False, since=time)
        if side is None:
            return replace(now, left=np.inf)
        until = time + min(travel / SPEED_SHARE + _DWELL, _LONGEST) / speed
        return replace(now, side=side, until=until, sides=np.vstack([self.sides, side]))


def _as_good(grasps: GraspSet, least: float) -> GraspSet:
    """The grasps that are so sure to carry, and score so large a share of even odds."""
    return filter_by_score(filter_by_payload(grasps, least), least)


def next_best_view(
    sides: Array, gpdf: Gpdf, X_WO: Array, q: Array, X_WC: Array, reachability: Reachability
) -> tuple[Array | None, float]:
    """Viewing direction in O of the most unobserved surface per second, and travel time [s].

    Args:
        sides: Directions in O from which it was looked at already, shape (m, 3).
        gpdf: The object's field, in O.
        X_WO: Pose of the object, shape (4, 4) [m].
        q: Joint positions [rad], shape (7,).
        X_WC: Pose of the camera, which is on the hand, z forward, shape (4, 4) [m].
        reachability: Test of configurations.

    Returns:
        Direction from the object's middle to the camera, shape (3,); None if there is none in
        reach; and the time at the joints' speed limits [s].
    """
    directions = sphere_points(_DIRECTIONS, 1.0)
    middle = gpdf.bounds.mean(axis=0)
    present = direction((se3.inverse(X_WO) @ X_WC[:, 3])[:3] - middle, directions[0])
    known = np.vstack([sides, present])
    others = directions[(directions @ known.T).max(axis=1) < _SAME_SIDE]
    if len(others) == 0:
        return None, np.inf
    views = _views_from(others, gpdf, X_WO, X_WC)
    times = configurations_at(views.reshape(-1, 4, 4), q, X_WC, reachability)[1]
    times = times.reshape(len(others), -1).min(axis=1)
    worth = (_unobserved_share(gpdf, others) + _CURIOSITY) / (times / SPEED_SHARE + _DWELL)
    best = int(np.argmax(worth))
    return (others[best], float(times[best])) if np.isfinite(times[best]) else (None, np.inf)


def view_configuration(
    side: Array, gpdf: Gpdf, X_WO: Array, q: Array, X_WC: Array, reachability: Reachability
) -> Array | None:
    """The configuration (7,) [rad] in which the camera sees the object from a side; None if none.

    Arguments as for `next_best_view`.
    """
    views = _views_from(side, gpdf, X_WO, X_WC)
    found, times = configurations_at(views, q, X_WC, reachability)
    best = int(np.argmin(times))
    return found[best] if np.isfinite(times[best]) else None


def _views_from(sides: Array, gpdf: Gpdf, X_WO: Array, X_WC: Array) -> Array:
    """Poses (..., m, 4, 4) of the camera that looks at the object's middle from sides (..., 3)."""
    half = 0.5 * float(np.linalg.norm(gpdf.bounds[1] - gpdf.bounds[0]))
    away = sides @ X_WO[:3, :3].T
    middle = X_WO[:3, :3] @ gpdf.bounds.mean(axis=0) + X_WO[:3, 3]
    return turned_views(middle + (_DISTANCE + 0.5 * half) * away, -away, X_WC)


def _unobserved_share(gpdf: Gpdf, directions: Array) -> Array:
    """Which share of the surface is unseen and would be seen from each direction, shape (n,)."""
    surface = gpdf.completion
    if len(surface) == 0:
        return np.zeros(len(directions))
    unobserved = nearest_distance(surface.points, gpdf.points) > _UNOBSERVED
    facing = surface.normals @ directions.T > _FACING
    return np.asarray((unobserved[:, None] & facing).mean(axis=0))
