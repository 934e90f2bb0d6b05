"""What the pipeline asks of a hand, and parallel grippers; hands by name or file.

A hand is a few lengths and two boxes; sampler, filter, capsules, simulated model and the network's
view of the room for a hand take them from there, so nothing is trained anew for another one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import yaml
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.choices import nearest
from feasigrasp.models.quantities import NotNegative


@dataclass(frozen=True, eq=False)
class Gripper(Frozen, ABC):
    """A hand with a palm and a wrist camera, described in its grasp frame G.

    Contact model and payload of each kind are in `feasigrasp.models.grasps`: of fingers in `filter`
    and `payload`, of a cup in `suction` and `seal`. Whatever its kind, the command of a hand is an
    opening [m], ``max_opening`` to let go and a negative one to grip with all its force, and its
    answer is 0 where it holds nothing: the distance between its pads [m], or the share of its
    vacuum.

    Attributes:
        heel: z of the front face of the palm, behind the origin of G, negative [m].
        palm_size: Palm box along x, y, z [m]; its front face lies at ``heel``.
        tool_offset: Distance from the flange to the origin of G along the flange's z-axis [m].
        camera_box: Box in G that encloses the tilted wrist camera (size along x, y, z) [m].
        camera_center: Its centre in G [m]: beside the palm, far enough out that the palm's edge
            does not hide the origin from the camera.
        camera_tilt: Angle by which the camera's optical axis leans from the approach direction
            towards the tool axis, which it crosses in front of the hand [rad].
    """

    heel: float = -0.050
    palm_size: tuple[float, float, float] = (0.082, 0.079, 0.065)
    tool_offset: float = 0.18
    camera_box: tuple[float, float, float] = (0.090, 0.031, 0.031)
    camera_center: tuple[float, float, float] = (0.0, 0.085, -0.105)
    camera_tilt: float = np.deg2rad(15.0)
    X_FG: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Checks the sizes and derives the pose of the grasp frame in the flange frame."""
        check_fields(self, GraspError)
        self._check()
        X_FG = np.eye(4)
        X_FG[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # closing direction x_G along y_F
        X_FG[2, 3] = self.tool_offset
        self._freeze(X_FG=X_FG)

    @property
    @abstractmethod
    def max_opening(self) -> float:
        """The opening that lets go [m]."""

    @property
    @abstractmethod
    def tip(self) -> float:
        """Where the hand ends in front, its z in G [m]."""

    @property
    @abstractmethod
    def reach(self) -> tuple[float, float, float]:
        """Largest x and y of what is in front of the open hand's palm, and its z [m]."""

    @abstractmethod
    def fingers(self, opening: float) -> list[list[list[float]]]:
        """Lower and upper corners in G of the boxes in front of the palm [m]."""

    @abstractmethod
    def capsules(self) -> list[tuple[list[float], list[float], float]]:
        """Ends in G and radius of a capsule around each finger of the open hand [m]."""

    @abstractmethod
    def surface_points(self, opening: NotNegative) -> Array:
        """Points on the hand's outside that have to keep off the object, shape (k, 3) in G [m]."""

    @abstractmethod
    def skin_points(self, opening: NotNegative) -> Array:
        """Points all over the hand: what must not hit anything, shape (k, 3) in G [m]."""

    def _camera_points(self) -> Array:
        """Points on the front of the wrist camera."""
        cx, cy, cz = (size / 2 for size in self.camera_box)
        return _grid([-cx, 0.0, cx], [-cy, cy], [cz]) + np.array(self.camera_center)

    def _check(self) -> None:
        name = type(self).__name__
        for key in sorted(self._LENGTHS):
            value = getattr(self, key)
            size = 3 if key in ("palm_size", "camera_box") else 1
            values = value if size == 3 else (value,)
            if len(values) != size or not all(np.isfinite(v) and 0 < v < 1 for v in values):
                raise GraspError(
                    f"{name}.{key} = {value}: give "
                    f"{'three lengths' if size == 3 else 'a length'} between 0 and 1 m (metres?)"
                )
        for key, unit in self._POSITIVE.items():
            if not (np.isfinite(getattr(self, key)) and getattr(self, key) > 0.0):
                raise GraspError(
                    f"{name}.{key} = {getattr(self, key)}: give a positive number{unit}"
                )
        if not -1 < self.heel < 0:
            raise GraspError(
                f"{name}.heel = {self.heel}: it lies behind the pad centre; give a "
                "negative z in metres"
            )
        if len(self.camera_center) != 3 or not (np.abs(self.camera_center) < 1.0).all():
            raise GraspError(
                f"{name}.camera_center = {self.camera_center}: give x, y, z in metres, "
                "each within 1 m of the pad centre"
            )
        if not abs(self.camera_tilt) < np.pi / 2:
            raise GraspError(
                f"{name}.camera_tilt = {self.camera_tilt}: give an angle in radians, "
                "below a quarter of a turn"
            )
        if self.tool_offset < self.palm_size[2] - self.heel - 1e-9:
            raise GraspError(
                f"{name}: the palm ends {self.palm_size[2] - self.heel:.3f} m behind the "
                f"pad centre, the flange is only tool_offset = {self.tool_offset} m behind it"
            )

    _LENGTHS: ClassVar[frozenset[str]] = frozenset({"palm_size", "camera_box", "tool_offset"})
    _POSITIVE: ClassVar[dict[str, str]] = {}


@dataclass(frozen=True, eq=False)
class ParallelGripper(Gripper):
    """A two-finger parallel gripper, described in its grasp frame G.

    The defaults stand in for the SAKE EZGripper of the paper: the range in which its pads stay
    parallel, and its reach of 0.18 m from the flange to the pad centre.

    Attributes:
        max_opening: Distance between the pads when fully open [m].
        finger_thickness: Size of a finger along x (closing direction) [m].
        finger_width: Size of a finger along y [m].
        tip: z of the finger tips, in front of the pad centre [m].
        grip_force: With which either pad presses when the hand is closed on something [N]. A pad is
            as wide as the finger and reaches from ``-tip`` to ``tip``.
    """

    max_opening: float = 0.085
    finger_thickness: float = 0.015
    finger_width: float = 0.030
    tip: float = 0.025
    grip_force: float = 40.0
    _LENGTHS = Gripper._LENGTHS | {"max_opening", "finger_thickness", "finger_width", "tip"}
    _POSITIVE = {"grip_force": " in N"}

    @property
    def reach(self) -> tuple[float, float, float]:
        """Largest x and y of the fingers of the open hand, and their tip's z [m]."""
        return self.max_opening / 2 + self.finger_thickness, self.finger_width / 2, self.tip

    @checked(GraspError)
    def fingers(self, opening: float) -> list[list[list[float]]]:
        """Lower and upper corners in G of both fingers [m]."""
        thick, wide = self.finger_thickness, self.finger_width
        x = max(opening, 0.0) / 2 + thick / 2
        tip, heel = self.tip, self.heel
        return [
            [[x - thick / 2, -wide / 2, heel], [x + thick / 2, wide / 2, tip]],
            [[-x - thick / 2, -wide / 2, heel], [-x + thick / 2, wide / 2, tip]],
        ]

    def capsules(self) -> list[tuple[list[float], list[float], float]]:
        """Ends in G and radius of a capsule around each finger of the open hand [m]."""
        thick, wide = self.finger_thickness / 2 + 0.0006, self.finger_width / 2
        # Fatter than it must be to be shorter: it ends less far in front of the finger's tip.
        finger = float(1.3 * np.hypot(thick, wide))
        top = float(self.tip - np.sqrt(finger**2 - thick**2 - wide**2))
        x = self.max_opening / 2 + self.finger_thickness / 2
        return [([each, 0.0, self.heel], [each, 0.0, top], finger) for each in (x, -x)]

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
        return np.concatenate([*fingers, front, self._camera_points(), back])

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


@dataclass(frozen=True, eq=False)
class SuctionCup(Gripper):
    """A round suction cup on a stem, described in its grasp frame G.

    The origin of G is the middle of the unloaded lip, z points out of the cup. Any turn about z is
    the same grasp. The defaults are a soft cup of 30 mm, with the reach and camera of the packaged
    hand.

    Attributes:
        radius: Of the lip [m].
        height: Of the cup, from its lip to its apex on the stem [m].
        stem_radius: Of the stem between palm and cup [m].
        press: How far the lip is pressed in where the hand is at a grasp [m].
        max_strain: Share by which the springs of the cup change their lengths at most before the
            lip opens (see `feasigrasp.models.grasps.seal`).
        vacuum: Pressure below that of the air in a sealed cup [Pa].
        friction: Coulomb friction of the lip.
    """

    radius: float = 0.015
    height: float = 0.012
    stem_radius: float = 0.010
    press: float = 0.002
    max_strain: float = 0.05
    vacuum: float = 60e3
    friction: float = 0.5
    _LENGTHS = Gripper._LENGTHS | {"radius", "height", "stem_radius", "press"}
    _POSITIVE = {"max_strain": "", "vacuum": " in Pa", "friction": ""}

    @property
    def max_opening(self) -> float:
        """A cup does not open; below zero its vacuum is on [m]."""
        return 0.0

    @property
    def tip(self) -> float:
        """Its lip is in the origin [m]."""
        return 0.0

    @property
    def vacuum_force(self) -> float:
        """Force of the vacuum on what closes the lip, ``p pi r^2`` [N]."""
        return float(self.vacuum * np.pi * self.radius**2)

    @property
    def reach(self) -> tuple[float, float, float]:
        """Largest x and y of the cup, and its lip's z [m]."""
        return self.radius, self.radius, self.tip

    @checked(GraspError)
    def fingers(self, opening: float) -> list[list[list[float]]]:
        """Lower and upper corners in G of boxes around stem and cup [m]."""
        r, s, back = self.radius, self.stem_radius, -self.height
        return [[[-s, -s, self.heel], [s, s, back]], [[-r, -r, back], [r, r, 0.0]]]

    def capsules(self) -> list[tuple[list[float], list[float], float]]:
        """Ends in G and radius of a capsule around stem and cup [m]."""
        radius = 1.3 * max(self.radius, self.stem_radius)
        top = -float(np.sqrt(radius**2 - self.radius**2))
        return [([0.0, 0.0, self.heel], [0.0, 0.0, top], radius)]

    @checked(GraspError)
    def surface_points(self, opening: NotNegative = 0.0) -> Array:
        """Points on stem, back of the cup, palm and camera; not on the lip, which is to touch.

        Returns:
            Shape (k, 3), in the grasp frame G [m].
        """
        back = -self.height
        stem = np.linspace(back, self.heel, 4)[:-1]
        around = [_rings([self.radius], [back, 0.7 * back]), _rings([self.stem_radius], stem)]
        px, py, pz = (size / 2 for size in self.palm_size)
        front = _grid(np.linspace(-px, px, 5), np.linspace(-py, py, 5), [self.heel])
        behind = _grid([-px, px], [-py, py], [self.heel - 2 * pz])
        return np.concatenate([*around, front, self._camera_points(), behind])

    @checked(GraspError)
    def skin_points(self, opening: NotNegative = 0.0) -> Array:
        """Points all over cup, stem, palm and camera, the lip included.

        Returns:
            Shape (k, 3), in the grasp frame G [m].
        """
        palm, depth = np.array(self.palm_size), np.linspace(0.0, -self.height, 3)
        rings = _rings([0.0, 0.5 * self.radius, self.radius], depth)
        stem = _rings([self.stem_radius], np.linspace(-self.height, self.heel, 5))
        box = _box_skin([0.0, 0.0, self.heel - palm[2] / 2], palm, 0.015)
        camera = _box_skin(self.camera_center, np.array(self.camera_box), 0.015)
        return np.concatenate([rings, stem, box, camera])


def _rings(radii: ArrayLike, z: ArrayLike) -> Array:
    """Eight points on each circle about z, shape (k, 3)."""
    angle = np.arange(8) * np.pi / 4
    r, a, z = np.meshgrid(radii, angle, z, indexing="ij")
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1).reshape(-1, 3)


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
    kind, content = _content(name)
    try:
        return kind(**content)
    except (TypeError, ValueError) as error:
        raise GraspError(f"{name}: {error}") from error


def _content(name: str) -> tuple[type[Gripper], dict[str, Any]]:
    """The kind of hand in a file, and what the file says of it, lists as tuples of numbers."""
    try:
        given = yaml.safe_load(Path(name).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise GraspError(f"{name} is no YAML file: {str(error).splitlines()[0]}") from error
    suction = isinstance(given, dict) and given.pop("kind", "parallel")
    kind = SuctionCup if suction == "suction" else ParallelGripper
    keys = {each.name: each.default for each in fields(kind) if each.init}
    if not isinstance(given, dict):
        raise GraspError(f"{name} has no keys; it may have {', '.join(keys)}")
    if suction not in ("parallel", "suction"):
        raise GraspError(f"{name}: kind is {suction!r}; give parallel or suction")
    for key, value in given.items():
        if key not in keys:
            raise GraspError(f"{name} has {key}; it may have {', '.join(keys)}{nearest(key, keys)}")
        several = isinstance(keys[key], tuple)
        try:
            given[key] = tuple(map(float, value)) if several else float(value)
        except (TypeError, ValueError) as error:
            what = "three numbers" if several else "a number"
            raise GraspError(f"{name}: {key} is {value!r}; give {what}, in SI units") from error
    return kind, given
