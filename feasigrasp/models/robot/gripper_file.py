"""Hands by name or file."""

from dataclasses import fields
from pathlib import Path
from typing import Any

from feasigrasp.errors import GraspError
from feasigrasp.inputs import read_yaml
from feasigrasp.models.choices import nearest
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper, SuctionCup

#: An example of how to describe a hand of one's own: one like the Schunk WSG 50 with 110 mm stroke.
#: Lengths as in Drake's description of it, made after the maker's drawing: body 146 x 72.5 x 50 mm,
#: fingers 12 x 82 x 20 mm that start at its front face, pads on the last 20 mm of each. The flange
#: is the back of the body. The camera sits beside the body as far out as on the default hand.
#: Source: data sheet: Schunk WSG 50.
WSG_50 = ParallelGripper(
    max_opening=0.110,
    finger_thickness=0.012,
    finger_width=0.020,
    tip=0.010,
    heel=-0.072,
    palm_size=(0.146, 0.050, 0.0725),
    tool_offset=0.1445,
    camera_center=(0.0, 0.0705, -0.127),
)


#: The hand of the packaged cell.
PACKAGED = "EZGripper"
#: All that have a name.
GRIPPERS: dict[str, Gripper] = {
    PACKAGED: ParallelGripper(),
    "WSG_50": WSG_50,
    "suction": SuctionCup(),
}


def load_gripper(name: str) -> Gripper:
    """A hand by its name, or from a YAML file with attributes of `ParallelGripper`.

    With ``kind: suction`` they are those of a `SuctionCup`. Attributes that the file does not have
    are those of the packaged hand of that kind.

    Raises:
        GraspError: There is no such gripper or file, or it describes none.
    """
    if name in GRIPPERS:
        return GRIPPERS[name]
    if not Path(name).is_file():
        raise GraspError(
            f"gripper is {name!r}, which is no file; give one, or one of {', '.join(GRIPPERS)}"
            f"{nearest(name, GRIPPERS)}"
        )
    try:
        return _described(read_yaml(Path(name).read_text(), GraspError))
    except (OSError, ValueError) as error:
        raise GraspError(f"{name}: {error}") from error


def _described(given: dict[str, Any]) -> Gripper:
    """The hand that the content of a file describes."""
    suction = given.pop("kind", "parallel")
    kind = SuctionCup if suction == "suction" else ParallelGripper
    keys = [each.name for each in fields(kind) if each.init]
    if suction not in ("parallel", "suction"):
        raise GraspError(f"kind is {suction!r}; give parallel or suction")
    for key, value in given.items():
        if key not in keys:
            raise GraspError(f"has {key}; it may have {', '.join(keys)}{nearest(key, keys)}")
        if isinstance(value, list):
            given[key] = tuple(value)
    return kind(**given)
