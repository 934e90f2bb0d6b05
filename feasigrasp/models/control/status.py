"""Status of a run: the activity of the arm, or the reason for standing still."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from feasigrasp.models.arrays import Frozen
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.objects.tracking import Tracking
from feasigrasp.models.reach.reachability import Verdict

#: An object that has moved or turned this much in the hand since it was let go slips [m], [rad].
#: Source: guessed.
SLIPPED, TURNED = 0.006, np.deg2rad(8.0)
#: Where more than this share of the grasps is beyond the wrist's reach or hits the table, the place
#: of the object is the reason. In 8 runs without a fault that is so for 0.3 s at most, with an
#: object out of reach or in the table for all of the 5 s that were looked at. Source: guessed.
SHARED = 0.9


class StatusCode(StrEnum):
    """Status codes; the first that applies, in this order."""

    COMMAND_FAULTY = "command_faulty"
    SLIPPING = "slipping"
    CLOSING = "closing"
    LIFTING = "lifting"
    HOLDING = "holding"
    DONE = "done"
    TOUCHED = "touched"
    CAMERA_CONTRADICTED = "camera_contradicted"
    POSE_JUMPED = "pose_jumped"
    LOOKING_FOR_OBJECT = "looking_for_object"
    POSE_LOST = "pose_lost"
    POSE_CONTRADICTED = "pose_contradicted"
    PERCEPTION_LAPSED = "perception_lapsed"
    VIEWS_DROPPED = "views_dropped"
    NOTHING_SEEN = "nothing_seen"
    OUT_OF_REACH = "out_of_reach"
    BLOCKED_BY_TABLE = "blocked_by_table"
    NO_GRASP = "no_grasp"
    WAITING = "waiting"
    BRAKING_FOR_OBSTACLE = "braking_for_obstacle"
    FOLLOWING = "following"


@dataclass(frozen=True, eq=False)
class Status(Frozen):
    """A status and since when it has been so.

    Attributes:
        time: When it began [s].
        code: What is going on.
        detail: In words, with what is known of the reason.
    """

    time: float
    code: StatusCode
    detail: str = ""


@dataclass(frozen=True)
class Situation:
    """Quantities that determine the status.

    Attributes:
        phase: What the gripper is doing.
        tracking: How much the object's pose is worth.
        search_target: Whether the arm looks for the object.
        contradicted: Whether the camera contradicts that pose.
        camera_contradicted: Whether the images are not of the camera's pose.
        lapsed: Whether the process that perceives is gone.
        seen: Whether there is a field of the object.
        views_dropped: Why views of late could not be used, if any were dropped; else empty.
        grasps: Number of grasps on the observed surface.
        rejected: Why candidates are none, by reason.
        reachable: How many of them are in reach.
        verdicts: Why the others are not, by reason.
        command_faults: How many commands were faulty since the last status.
        touches: How often the arm was touched since then, before the fingers closed.
        speed: Largest joint speed [rad/s].
        left: Distance of the hand to the nearest grasp [m].
        unobserved: Distance of the arm to space that was never seen and may belong to obstacles
            [m].
        slipped: How far an object that was let go has moved in the hand since then [m].
        turned: How far it has turned there [rad].
        unmet: The condition for closing that a following hand does not meet, in words.
    """

    phase: Phase = Phase.APPROACH
    tracking: Tracking | None = None
    search_target: bool = False
    contradicted: bool = False
    camera_contradicted: bool = False
    lapsed: bool = False
    seen: bool = True
    views_dropped: str = ""
    grasps: int = 1
    rejected: Mapping[str, int] = field(default_factory=dict)
    reachable: int = 1
    verdicts: Mapping[str, int] = field(default_factory=dict)
    command_faults: int = 0
    touches: int = 0
    speed: float = 1.0
    left: float = 0.0
    unobserved: float = float("inf")
    slipped: float = 0.0
    turned: float = 0.0
    unmet: str = ""


#: Verdicts on grasps by which the object's place shows.
_PLACES = {Verdict.WRIST: StatusCode.OUT_OF_REACH, Verdict.TABLE: StatusCode.BLOCKED_BY_TABLE}
_PHASES = {
    Phase.CLOSE: StatusCode.CLOSING,
    Phase.LIFT: StatusCode.LIFTING,
    Phase.SHAKE: StatusCode.HOLDING,
    Phase.HOLD: StatusCode.HOLDING,
    Phase.DONE: StatusCode.DONE,
}


def judge(now: Situation) -> tuple[StatusCode, str]:
    """The code and the words for a situation."""
    if now.command_faults:
        return StatusCode.COMMAND_FAULTY, "the controller's command is not finite, or absurd"
    if now.slipped > SLIPPED or now.turned > TURNED:
        moved, turned = 1e3 * now.slipped, np.rad2deg(now.turned)
        return StatusCode.SLIPPING, f"moved {moved:.0f} mm and turned {turned:.0f} deg in the hand"
    if now.phase in _PHASES:
        return _PHASES[now.phase], ""
    if now.touches:
        return StatusCode.TOUCHED, "the arm has touched something on its way, and gives way"
    return _pose(now) or _grasps(now) or _way(now)


def _pose(now: Situation) -> tuple[StatusCode, str] | None:
    if now.camera_contradicted:
        cause = "frozen, mirrored, or its pose or the modeled cell is wrong"
        return StatusCode.CAMERA_CONTRADICTED, f"the camera looks through the cell: {cause}"
    if now.tracking is not None and now.tracking.jumping:
        return StatusCode.POSE_JUMPED, "measurements say that the object is somewhere else"
    if now.tracking is not None and now.search_target:
        return StatusCode.LOOKING_FOR_OBJECT, f"not seen for {now.tracking.age:.1f} s"
    if now.tracking is not None and now.tracking.lost:
        since = "ever" if now.tracking.age == float("inf") else f"for {now.tracking.age:.1f} s"
        return StatusCode.POSE_LOST, f"no measurement of the object's pose {since}"
    if now.contradicted:
        return StatusCode.POSE_CONTRADICTED, "the camera sees the object elsewhere than tracked"
    if now.lapsed:
        return StatusCode.PERCEPTION_LAPSED, "its process has ended, or hung; one starts anew"
    return None


def _grasps(now: Situation) -> tuple[StatusCode, str] | None:
    if not now.seen:
        if now.views_dropped:
            return StatusCode.VIEWS_DROPPED, now.views_dropped
        return StatusCode.NOTHING_SEEN, "no view of the object yet"
    if now.reachable == 0 and (place := _place(now.verdicts)):
        return place, _most(now.verdicts)
    if now.views_dropped and now.grasps == 0:
        return StatusCode.VIEWS_DROPPED, now.views_dropped
    if now.grasps == 0:
        return StatusCode.NO_GRASP, _most(now.rejected)
    if now.reachable == 0:
        return StatusCode.WAITING, _most(now.verdicts) or "grasps are blocked or too uncertain"
    return None


def _place(verdicts: Mapping[str, int]) -> StatusCode | None:
    """The code of the place of the object, if nearly all grasps are out of reach for it."""
    of_place = {reason: verdicts.get(str(reason), 0) for reason in _PLACES}
    if sum(of_place.values()) <= SHARED * sum(verdicts.values()):
        return None
    return _PLACES[max(of_place, key=lambda reason: of_place[reason])]


def _way(now: Situation) -> tuple[StatusCode, str]:
    # An arm whose joints are all slower stands still [rad/s].
    # A hand this far from every grasp has not arrived [m].
    if now.speed < 0.02 and now.left > 0.015:
        detail = f"the arm stands {100.0 * now.left:.0f} cm from the nearest grasp"
        # An arm this close to space that was never seen is held up by it [m].
        if now.unobserved < 0.04:
            detail += ", before space that the camera has not seen"
        return StatusCode.BRAKING_FOR_OBSTACLE, detail
    return StatusCode.FOLLOWING, now.unmet


def _most(reasons: Mapping[str, int]) -> str:
    """The most frequent reason."""
    most = max(reasons, key=lambda reason: reasons[reason], default="")
    return most if reasons.get(most) else ""
