"""Geometry of a parallel gripper; grippers by name or file.

A hand is six lengths and two boxes; the sampler, the filter and the network's view of the room for
a hand take them from there, so nothing is trained anew for another one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.choices import nearest
from feasigrasp.models.quantities import NotNegative


@dataclass(frozen=True, eq=False)
class ParallelGripper(Frozen):
    """A two-finger parallel gripper, described in its grasp frame G.

    The defaults stand in for the SAKE EZGripper of the paper: the range in which its pads stay
    parallel, and its reach of 0.18 m from the flange to the pad centre.

    Attributes:
        max_opening: Distance between the pads when fully open [m].
        finger_thickness: Size of a finger along x (closing direction) [m].
        finger_width: Size of a finger along y [m].
        tip: z of the finger tips, in front of the pad centre [m].
        heel: z of the finger's inner end, behind the pad centre, negative [m].
        palm_size: Palm box along x, y, z [m]; its front face lies at ``heel``.
        tool_offset: Distance from the flange to the pad centre along the flange's z-axis [m].
        camera_box: Box in G that encloses the tilted wrist camera (size along x, y, z) [m].
        camera_center: Its centre in G [m]: beside the palm, far enough out that the palm's edge
            does not hide the pad centre from the camera.
        camera_tilt: Angle by which the camera's optical axis leans from the approach direction
            towards the tool axis, which it crosses in front of the finger tips [rad].
        grip_force: With which either pad presses when the hand is closed on something [N]. A pad is
            as wide as the finger and reaches from ``-tip`` to ``tip``.
    """

    max_opening: float = 0.085
    finger_thickness: float = 0.015
    finger_width: float = 0.030
    tip: float = 0.025
    heel: float = -0.050
    palm_size: tuple[float, float, float] = (0.082, 0.079, 0.065)
    tool_offset: float = 0.18
    camera_box: tuple[float, float, float] = (0.090, 0.031, 0.031)
    camera_center: tuple[float, float, float] = (0.0, 0.085, -0.105)
    camera_tilt: float = np.deg2rad(15.0)
    grip_force: float = 40.0
    X_FG: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Checks the sizes and derives the pose of the grasp frame in the flange frame."""
        check_fields(self, GraspError)
        self._check()
        X_FG = np.eye(4)
        X_FG[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # closing direction x_G along y_F
        X_FG[2, 3] = self.tool_offset
        self._freeze(X_FG=X_FG)

    def _check(self) -> None:
        lengths = {
            "max_opening": (self.max_opening,),
            "finger_thickness": (self.finger_thickness,),
            "finger_width": (self.finger_width,),
            "tip": (self.tip,),
            "palm_size": self.palm_size,
            "camera_box": self.camera_box,
            "tool_offset": (self.tool_offset,),
        }
        for name, values in lengths.items():
            size = 3 if name in ("palm_size", "camera_box") else 1
            if len(values) != size or not all(np.isfinite(v) and 0 < v < 1 for v in values):
                raise GraspError(
                    f"ParallelGripper.{name} = {getattr(self, name)}: give "
                    f"{'three lengths' if size == 3 else 'a length'} between 0 and 1 m (metres?)"
                )
        if not (np.isfinite(self.grip_force) and self.grip_force > 0.0):
            raise GraspError(
                f"ParallelGripper.grip_force = {self.grip_force}: give a positive number in N"
            )
        if not -1 < self.heel < 0:
            raise GraspError(
                f"ParallelGripper.heel = {self.heel}: it lies behind the pad centre; give a "
                "negative z in metres"
            )
        if len(self.camera_center) != 3 or not (np.abs(self.camera_center) < 1.0).all():
            raise GraspError(
                f"ParallelGripper.camera_center = {self.camera_center}: give x, y, z in metres, "
                "each within 1 m of the pad centre"
            )
        if not abs(self.camera_tilt) < np.pi / 2:
            raise GraspError(
                f"ParallelGripper.camera_tilt = {self.camera_tilt}: give an angle in radians, "
                "below a quarter of a turn"
            )
        if self.tool_offset < self.palm_size[2] - self.heel - 1e-9:
            raise GraspError(
                f"ParallelGripper: the palm ends {self.palm_size[2] - self.heel:.3f} m behind the "
                f"pad centre, the flange is only tool_offset = {self.tool_offset} m behind it"
            )

    @checked(GraspError)
    def surface_points(self, opening: float) -> Array:
        """Points on the hand's outside, for collision checks against a distance field.

        Tips, outer faces and edges of both fingers, front and back of the palm, and the wrist
        camera; not the inner faces of the pads, which are meant to touch. At most 2 cm apart on
        the fingers and the front of the palm, so that little slips through between them.

        Args:
            opening: Distance between the pads [m], from 0 to ``max_opening``.

        Returns:
            Shape (k, 3), in the grasp frame G [m].

        Raises:
            GraspError: If the hand cannot open that far.
        """
        if not 0.0 <= opening <= self.max_opening + 1e-9:
            raise GraspError(
                f"opening = {opening} m is outside 0 ... max_opening = {self.max_opening} m"
            )
        side = self.finger_width / 2
        near = opening / 2 + 0.2 * self.finger_thickness  # just off the pad's inner face
        far = opening / 2 + self.finger_thickness
        along = np.linspace(self.tip, self.heel, 6)[:-1]
        fingers = [
            _grid([-near, near], [-side, 0.0, side], along),
            _grid([-far, far], [-side, side], along),
        ]
        px, py, pz = (size / 2 for size in self.palm_size)
        front = _grid(np.linspace(-px, px, 5), np.linspace(-py, py, 5), [self.heel])
        back = _grid([-px, px], [-py, py], [self.heel - 2 * pz])
        cx, cy, cz = (size / 2 for size in self.camera_box)
        camera = _grid([-cx, 0.0, cx], [-cy, cy], [cz]) + np.array(self.camera_center)
        return np.concatenate([*fingers, front, camera, back])

    @checked(GraspError)
    def skin_points(self, opening: NotNegative) -> Array:
        """Points all over fingers, palm and camera, pads included: what must not hit anything.

        No more than 1 cm apart on the fingers, and 1.5 cm on the rest.

        Args:
            opening: Distance between the pads [m].

        Returns:
            Shape (k, 3), in the grasp frame G [m].
        """
        finger = np.array([self.finger_thickness, self.finger_width, self.tip - self.heel])
        out, middle = (opening + self.finger_thickness) / 2, (self.tip + self.heel) / 2
        palm = np.array(self.palm_size)
        return np.concatenate(
            [
                _box_skin([-out, 0.0, middle], finger, 0.01),
                _box_skin([out, 0.0, middle], finger, 0.01),
                _box_skin([0.0, 0.0, self.heel - palm[2] / 2], palm, 0.015),
                _box_skin(self.camera_center, np.array(self.camera_box), 0.015),
            ]
        )


def _box_skin(center: ArrayLike, size: Array, spacing: float) -> Array:
    """Points on the surface of a box, at most ``spacing`` apart, shape (k, 3)."""
    counts = np.ceil(size / spacing - 1e-9).astype(int) + 1
    x, y, z = (np.linspace(-half, half, n) for half, n in zip(size / 2, counts, strict=True))
    points = _grid(x, y, z)
    return points[np.isclose(np.abs(points), size / 2).any(axis=1)] + np.asarray(center)


def _grid(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)


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
GRIPPERS = {PACKAGED: ParallelGripper(), "WSG_50": WSG_50}
_KEYS = [field.name for field in fields(ParallelGripper) if field.init]


def load_gripper(name: str) -> ParallelGripper:
    """A gripper by its name, or from a YAML file with attributes of `ParallelGripper`.

    Attributes that the file does not have are those of the packaged hand.

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
    content = _content(name)
    try:
        return ParallelGripper(**content)
    except (TypeError, ValueError) as error:
        raise GraspError(f"{name}: {error}") from error


def _content(name: str) -> dict[str, Any]:
    """What a file says, lists as tuples of numbers."""
    try:
        given = yaml.safe_load(Path(name).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise GraspError(f"{name} is no YAML file: {str(error).splitlines()[0]}") from error
    if not isinstance(given, dict):
        raise GraspError(f"{name} has no keys; it may have {', '.join(_KEYS)}")
    for key, value in given.items():
        if key not in _KEYS:
            raise GraspError(
                f"{name} has {key}; it may have {', '.join(_KEYS)}{nearest(key, _KEYS)}"
            )
        several = isinstance(getattr(GRIPPERS[PACKAGED], key), tuple)
        try:
            given[key] = tuple(map(float, value)) if several else float(value)
        except (TypeError, ValueError) as error:
            what = "three numbers" if several else "a number"
            raise GraspError(f"{name}: {key} is {value!r}; give {what}, in SI units") from error
    return given
