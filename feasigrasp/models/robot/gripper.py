"""Hands: their common description, parallel grippers and suction cups.

A hand is a few lengths and two boxes; sampler, filter, capsules, simulated model and the network's
view of the room for a hand take them from there, so nothing is trained anew for another one.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.quantities import NotNegative, Number, Positive

#: What a hand may have in metres.
Length = Annotated[float, Number(above=0.0, most=1.0, unit="m")]


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
    palm_size: tuple[Length, Length, Length] = (0.082, 0.079, 0.065)
    tool_offset: Length = 0.18
    camera_box: tuple[Length, Length, Length] = (0.090, 0.031, 0.031)
    camera_center: tuple[float, float, float] = (0.0, 0.085, -0.105)
    camera_tilt: float = np.deg2rad(15.0)
    X_FG: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Checks the sizes and derives the pose of the grasp frame in the flange frame."""
        check_fields(self, GraspError)
        name = type(self).__name__
        if not -1 < self.heel < 0:
            raise GraspError(
                f"{name}.heel = {self.heel}: it lies behind the pad centre; give a "
                "negative z in metres"
            )
        if not (np.abs(self.camera_center) < 1.0).all():
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
    def skin_points(self) -> Array:
        """Points all over the open hand: what must not hit anything, shape (k, 3) in G [m]."""

    def _body_points(self) -> Array:
        """Points on front and back of the palm, and on the front of the wrist camera."""
        px, py, pz = (size / 2 for size in self.palm_size)
        cx, cy, cz = (size / 2 for size in self.camera_box)
        front = grid_points(np.linspace(-px, px, 5), np.linspace(-py, py, 5), [self.heel])
        camera = grid_points([-cx, 0.0, cx], [-cy, cy], [cz]) + np.array(self.camera_center)
        back = grid_points([-px, px], [-py, py], [self.heel - 2 * pz])
        return np.concatenate([front, camera, back])

    def _body_skin(self) -> Array:
        """Points all over palm and camera, no more than 1.5 cm apart."""
        palm = np.array(self.palm_size)
        box = box_skin([0.0, 0.0, self.heel - palm[2] / 2], palm, 0.015)
        return np.concatenate([box, box_skin(self.camera_center, np.array(self.camera_box), 0.015)])


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

    max_opening: Length = 0.085
    finger_thickness: Length = 0.015
    finger_width: Length = 0.030
    tip: Length = 0.025
    grip_force: Annotated[float, Number(above=0.0, unit="N")] = 40.0

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
        """Points on the hand's outside, for collision checks against a distance field, (k, 3) [m].

        Tips, outer faces and edges of both fingers, front and back of the palm, and the wrist
        camera; not the inner faces of the pads, which are meant to touch. At most 2 cm apart on
        the fingers and the front of the palm, so that little slips through between them.

        Raises:
            GraspError: The opening is not from 0 to ``max_opening``.
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
            grid_points([-near, near], [-side, 0.0, side], along),
            grid_points([-far, far], [-side, side], along),
        ]
        return np.concatenate([*fingers, self._body_points()])

    def skin_points(self) -> Array:
        """Points all over the open hand, pads included: what must not hit anything, (k, 3) [m].

        No more than 1 cm apart on the fingers, and 1.5 cm on the rest.
        """
        finger = np.array([self.finger_thickness, self.finger_width, self.tip - self.heel])
        out, middle = (self.max_opening + self.finger_thickness) / 2, (self.tip + self.heel) / 2
        fingers = [box_skin([x, 0.0, middle], finger, 0.01) for x in (-out, out)]
        return np.concatenate([*fingers, self._body_skin()])


def box_skin(center: ArrayLike, size: Array, spacing: float) -> Array:
    """Points on the surface of a box, at most ``spacing`` apart, shape (k, 3)."""
    counts = np.ceil(size / spacing - 1e-9).astype(int) + 1
    x, y, z = (np.linspace(-half, half, n) for half, n in zip(size / 2, counts, strict=True))
    points = grid_points(x, y, z)
    return points[np.isclose(np.abs(points), size / 2).any(axis=1)] + np.asarray(center)


def grid_points(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
    """All points with coordinates of three lists, shape (k, 3)."""
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)


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
            lip opens (see `feasigrasp.models.grasps.suction`).
        vacuum: Pressure below that of the air in a sealed cup [Pa].
        friction: Coulomb friction of the lip.
    """

    radius: Length = 0.015
    height: Length = 0.012
    stem_radius: Length = 0.010
    press: Length = 0.002
    max_strain: Positive = 0.05
    vacuum: Annotated[float, Number(above=0.0, unit="Pa")] = 60e3
    friction: Positive = 0.5

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
    def surface_points(self, opening: NotNegative) -> Array:
        """Points on stem, back of the cup, palm and camera, (k, 3) [m]; the lip is to touch."""
        back = -self.height
        stem = np.linspace(back, self.heel, 4)[:-1]
        around = [_rings([self.radius], [back, 0.7 * back]), _rings([self.stem_radius], stem)]
        return np.concatenate([*around, self._body_points()])

    def skin_points(self) -> Array:
        """Points all over cup, stem, palm and camera, the lip included, shape (k, 3) [m]."""
        depth = np.linspace(0.0, -self.height, 3)
        rings = _rings([0.0, 0.5 * self.radius, self.radius], depth)
        stem = _rings([self.stem_radius], np.linspace(-self.height, self.heel, 5))
        return np.concatenate([rings, stem, self._body_skin()])


def _rings(radii: ArrayLike, z: ArrayLike) -> Array:
    """Eight points on each circle about z, shape (k, 3)."""
    angle = np.arange(8) * np.pi / 4
    r, a, z = np.meshgrid(radii, angle, z, indexing="ij")
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1).reshape(-1, 3)
