"""Faults of ``evaluate faults``, and the words about each; docs/safety.md has the reactions."""

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
from feasigrasp.models.objects.tracking import TrackerKind
from feasigrasp.scenario.schema import Scenario


@dataclass(frozen=True)
class StudiedFault:
    """A fault as it is tried.

    Attributes:
        what: What goes wrong.
        fault: The fault; its start is drawn. None if it is there all the time, by ``tracker``.
        named: Statuses and causes that are the right word about it, with the pose given.
        held: Whether the object is to be held in the end nevertheless.
        tracker: What is changed of the scenario's tracker.
    """

    what: str
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

#: Every fault of the study, by name.
FAULTS: dict[str, StudiedFault] = {
    "camera_gone": StudiedFault(
        "no image any more: no depth in any pixel", CameraGone(), _UNOBSERVED
    ),
    "camera_black": StudiedFault(
        "every depth is zero: all points are in the camera", CameraBlack(), _UNOBSERVED
    ),
    "camera_frozen": StudiedFault(
        "one image comes again and again", CameraFrozen(), (*_UNOBSERVED, *_CONTRADICTED)
    ),
    "camera_mirrored": StudiedFault(
        "left is right in every image", CameraMirrored(), (*_UNOBSERVED, *_CONTRADICTED)
    ),
    "one_plane": StudiedFault(
        "all points of the object lie on one plane", OnePlane(), (*_UNOBSERVED, "pose_contradicted")
    ),
    **{
        f"outliers_{percent}": StudiedFault(
            f"{percent} % of the pixels 5 cm off in depth",
            Outliers(share=percent / 100.0),
            _UNOBSERVED,
            held=percent == 5,
        )
        for percent in (1, 5, 20)
    },
    "mask_shifted": StudiedFault(
        "the mask lies 10 pixels beside the object",
        MaskShifted(),
        (*_UNOBSERVED, "pose_contradicted"),
        held=True,
    ),
    "mask_eroded": StudiedFault(
        "the mask misses a rim of 10 pixels", MaskEroded(), _UNOBSERVED, held=True
    ),
    "mask_dilated": StudiedFault(
        "the mask has a rim of 10 pixels too much",
        MaskDilated(),
        (*_UNOBSERVED, "pose_contradicted"),
        held=True,
    ),
    "mask_whole": StudiedFault(
        "the whole image is taken for the object", MaskWhole(), (*_UNOBSERVED, "pose_contradicted")
    ),
    "mask_empty": StudiedFault("no pixel is taken for the object", MaskEmpty(), _UNOBSERVED),
    "pose_frozen": StudiedFault(
        "the measured pose stays the same, bit for bit", PoseFrozen(), _DOUBTED
    ),
    "pose_jump": StudiedFault(
        "the measured pose is 10 cm and 30 degrees off for 1 s", PoseJump(duration=1.0), _DOUBTED
    ),
    "pose_flipped": StudiedFault(
        "the measured pose is turned by 180 degrees for 1 s",
        PoseJump(duration=1.0, by=[0.0, 0.0, 0.0], turn_deg=180.0),
        _DOUBTED,
    ),
    "pose_nan_short": StudiedFault(
        "no pose for 0.5 s", PoseNan(duration=0.5), ("pose_lost",), held=True
    ),
    "pose_nan": StudiedFault("no pose any more", PoseNan(), ("pose_lost",)),
    "pose_late": StudiedFault(
        "poses 100 ms late with 5 mm and 3 degrees of noise, always, as modeled in the tracker",
        None,
        _DOUBTED,
        held=True,
        tracker={"latency": 0.1, "position_noise": 0.005, "rotation_noise": math.radians(3.0)},
    ),
    "pose_late_untold": StudiedFault(
        "the same from an instant on, without the tracker's noise model", PoseLate(), _DOUBTED
    ),
    "perception_late": StudiedFault(
        "views become grasps 1.5 s later than usual",
        PerceptionLate(),
        ("nothing_seen", "no_grasp"),
        held=True,
    ),
    "object_stops": StudiedFault("the object stops", ObjectPace(factor=0.0), ("never_settled",)),
    "object_reverses": StudiedFault(
        "the object goes back the way it came", ObjectPace(factor=-1.0), ("never_settled",)
    ),
    "object_fast": StudiedFault(
        "the object is five times as fast", ObjectPace(factor=5.0), ("never_settled", "missed")
    ),
    "object_out_of_reach": StudiedFault(
        "the object leaves, 1.3 m from the base", ObjectMoved(), ("out_of_reach",)
    ),
    "object_through_arm": StudiedFault(
        "the object is carried through the arm to its other side",
        ObjectMoved(to=[-0.35, 0.0, 0.55]),
        ("no_grasp", "braking_for_obstacle", "pose_contradicted", "pushed_away"),
    ),
    "object_into_table": StudiedFault(
        "the object goes down into the table",
        ObjectMoved(to=[0.5, 0.0, -0.05]),
        ("blocked_by_table", "no_grasp", "braking_for_obstacle"),
    ),
    "object_pulled": StudiedFault(
        "150 N pull the object out of the hand while it is lifted",
        ObjectPulled(),
        ("dropped", "slipped"),
    ),
    "controller_nan": StudiedFault(
        "the controller commands NaN", CommandNan(), ("command_faulty",)
    ),
    "controller_wild": StudiedFault(
        "the controller commands 1e6 rad/s with random signs", CommandWild(), ("command_faulty",)
    ),
    "solver_failure": StudiedFault(
        "the solver of the safety QP gives up for 1 s",
        SolverFailure(duration=1.0),
        ("command_faulty", "braking_for_obstacle"),
    ),
}
