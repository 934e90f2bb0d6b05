"""Faults of ``evaluate faults``, with the expected reports."""

from __future__ import annotations

import dataclasses as dc
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from feasigrasp.models.faults.fault import (
    CommandNan,
    CommandWild,
    Fault,
    PerceptionLate,
    PoseFrozen,
    PoseJump,
    PoseLate,
    PoseNan,
    SolverFailure,
)
from feasigrasp.models.faults.images import (
    CameraBlack,
    CameraFrozen,
    CameraGone,
    CameraMirrored,
    MaskDilated,
    MaskEmpty,
    MaskEroded,
    MaskShifted,
    MaskWhole,
    OnePlane,
    Outliers,
)
from feasigrasp.models.faults.object import ObjectMoved, ObjectPace, ObjectPulled
from feasigrasp.models.objects.tracker_config import TrackerKind
from feasigrasp.scenario.schema import Scenario


@dataclass(frozen=True)
class StudiedFault:
    """A fault as it is tried.

    Attributes:
        what: What goes wrong.
        behaviour: What the cell does then.
        fault: The fault; its start is drawn. None if it is there all the time, by ``tracker``.
        named: Statuses and causes that are the right word about it, with the pose given.
        held: Whether the object is to be held in the end nevertheless.
        tracker: What is changed of the scenario's tracker.
    """

    what: str
    behaviour: str
    fault: Fault | None
    named: tuple[str, ...]
    held: bool = False
    tracker: Mapping[str, Any] = field(default_factory=dict)

    def words(self, scenario: Scenario) -> tuple[str, ...]:
        """Statuses and causes that are the right word about it in a scenario.

        Where the object is tracked by the camera, its pose is lost with its image.
        """
        quick = isinstance(self.fault, ObjectPace) and self.fault.factor > 1.0
        hidden = {*_UNOBSERVED} <= {*self.named} or isinstance(self.fault, ObjectMoved)
        camera = scenario.tracker.kind == TrackerKind.CAMERA
        return (*self.named, *LOST) if camera and (hidden or quick) else self.named

    @property
    def while_lifting(self) -> bool:
        """Whether it begins while the object is lifted, not on the way to it."""
        return isinstance(self.fault, ObjectPulled)

    def beginning_at(self, start: float) -> list[Fault]:
        """The scenario's faults."""
        return [] if self.fault is None else [dc.replace(self.fault, start=start)]


#: Statuses of a tracker that does not see the object.
LOST = ("pose_lost", "looking_for_object")
_UNOBSERVED = ("nothing_seen", "no_grasp", "views_dropped")
_CONTRADICTED = ("camera_contradicted", "pose_contradicted")
_DOUBTED = ("pose_jumped", "pose_contradicted", "pose_lost", "views_dropped")
_KEEP = "grasps of the earlier views stay good, since the pose is tracked; without any it waits"
_DROP = "views that contradict the others, or cannot be fitted, are dropped and counted"
_HOLD = "after `tracker.silence` the pose is held, grasps lapse, the arm brakes and waits"
_FOLLOW = "it follows, and grasps when the hand has caught up"

#: Every fault of the study, by name.
FAULTS: dict[str, StudiedFault] = {
    "camera_gone": StudiedFault(
        "no image any more: no depth in any pixel", _KEEP, CameraGone(), _UNOBSERVED
    ),
    "camera_black": StudiedFault(
        "every depth is zero: all points are in the camera", _DROP, CameraBlack(), _UNOBSERVED
    ),
    "camera_frozen": StudiedFault(
        "one image comes again and again", _DROP, CameraFrozen(), (*_UNOBSERVED, *_CONTRADICTED)
    ),
    "camera_mirrored": StudiedFault(
        "left is right in every image", _DROP, CameraMirrored(), (*_UNOBSERVED, *_CONTRADICTED)
    ),
    "one_plane": StudiedFault(
        "all points of the object lie on one plane",
        _DROP,
        OnePlane(),
        (*_UNOBSERVED, "pose_contradicted"),
    ),
    **{
        f"outliers_{percent}": StudiedFault(
            f"{percent} % of the pixels 5 cm off in depth",
            "they are removed before the fit, and counted",
            Outliers(share=percent / 100.0),
            _UNOBSERVED,
            held=percent == 5,
        )
        for percent in (1, 5, 20)
    },
    "mask_shifted": StudiedFault(
        "the mask lies 10 pixels beside the object",
        _DROP,
        MaskShifted(),
        (*_UNOBSERVED, "pose_contradicted"),
        held=True,
    ),
    "mask_eroded": StudiedFault(
        "the mask misses a rim of 10 pixels", _DROP, MaskEroded(), _UNOBSERVED, held=True
    ),
    "mask_dilated": StudiedFault(
        "the mask has a rim of 10 pixels too much",
        _DROP,
        MaskDilated(),
        (*_UNOBSERVED, "pose_contradicted"),
        held=True,
    ),
    "mask_whole": StudiedFault(
        "the whole image is taken for the object",
        _DROP,
        MaskWhole(),
        (*_UNOBSERVED, "pose_contradicted"),
    ),
    "mask_empty": StudiedFault("no pixel is taken for the object", _KEEP, MaskEmpty(), _UNOBSERVED),
    "pose_frozen": StudiedFault(
        "the measured pose stays the same, bit for bit",
        "it is accepted until a view contradicts it: then grasps lapse, the arm brakes and waits",
        PoseFrozen(),
        _DOUBTED,
    ),
    "pose_jump": StudiedFault(
        "the measured pose is 10 cm and 30 degrees off for 1 s",
        "it is gated at first; views that contradict it are dropped",
        PoseJump(duration=1.0),
        _DOUBTED,
    ),
    "pose_flipped": StudiedFault(
        "the measured pose is turned by 180 degrees for 1 s",
        "as a jump",
        PoseJump(duration=1.0, by=[0.0, 0.0, 0.0], turn_deg=180.0),
        _DOUBTED,
    ),
    "pose_nan_short": StudiedFault(
        "no pose for 0.5 s",
        "extrapolated until `tracker.silence`, then held; it goes on when poses are back",
        PoseNan(duration=0.5),
        ("pose_lost",),
        held=True,
    ),
    "pose_nan": StudiedFault("no pose any more", _HOLD, PoseNan(), ("pose_lost",)),
    "pose_late": StudiedFault(
        "poses 100 ms late with 5 mm and 3 degrees of noise, always, as modeled in the tracker",
        "the tracker predicts over the latency and smoothes as much as the noise asks for",
        None,
        _DOUBTED,
        held=True,
        tracker={"latency": 0.1, "position_noise": 0.005, "rotation_noise": math.radians(3.0)},
    ),
    "pose_late_untold": StudiedFault(
        "the same from an instant on, without the tracker's noise model",
        "measurements that contradict each other are gated",
        PoseLate(),
        _DOUBTED,
    ),
    "perception_late": StudiedFault(
        "views become grasps 1.5 s later than usual",
        "grasps are in the object's frame and stay good",
        PerceptionLate(),
        ("nothing_seen", "no_grasp"),
        held=True,
    ),
    "object_stops": StudiedFault(
        "the object stops", _FOLLOW, ObjectPace(factor=0.0), ("never_settled",)
    ),
    "object_reverses": StudiedFault(
        "the object goes back the way it came",
        _FOLLOW,
        ObjectPace(factor=-1.0),
        ("never_settled",),
    ),
    "object_fast": StudiedFault(
        "the object is five times as fast",
        _FOLLOW,
        ObjectPace(factor=5.0),
        ("never_settled", "missed"),
    ),
    "object_out_of_reach": StudiedFault(
        "the object leaves, 1.3 m from the base",
        "nothing is reachable: the arm waits",
        ObjectMoved(),
        ("out_of_reach",),
    ),
    "object_through_arm": StudiedFault(
        "the object is carried through the arm to its other side",
        "the arm keeps its limits; a tensed hand that carries the object gives way at 30 N",
        ObjectMoved(to=[-0.35, 0.0, 0.55]),
        ("no_grasp", "braking_for_obstacle", "pose_contradicted", "pushed_away"),
    ),
    "object_into_table": StudiedFault(
        "the object goes down into the table",
        "grasps that hit the table are not reachable; the arm stays above it",
        ObjectMoved(to=[0.5, 0.0, -0.05]),
        ("blocked_by_table", "no_grasp", "braking_for_obstacle"),
    ),
    "object_pulled": StudiedFault(
        "150 N pull the object out of the hand while it is lifted",
        "the run ends as not held",
        ObjectPulled(),
        ("dropped", "slipped"),
    ),
    "controller_nan": StudiedFault(
        "the controller commands NaN", "the drive brakes", CommandNan(), ("command_faulty",)
    ),
    "controller_wild": StudiedFault(
        "the controller commands 1e6 rad/s with random signs",
        "the drive brakes",
        CommandWild(),
        ("command_faulty",),
    ),
    "solver_failure": StudiedFault(
        "the solver of the safety QP gives up for 1 s",
        "the arm brakes within its limits, and goes on with the solver",
        SolverFailure(duration=1.0),
        ("command_faulty", "braking_for_obstacle"),
    ),
}
