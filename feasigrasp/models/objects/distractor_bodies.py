"""Visible bodies without contact: the carrier of the object, and a distractor."""

from collections.abc import Callable
from colorsys import hsv_to_rgb
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import trimesh

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.motion import ObjectMotion
from feasigrasp.models.objects.rigid_object import RigidObject

# Meshes of carriers: a hand that holds the object from behind, a belt below it.
#
# The frame C of a carrier has its origin in that of the object, O, and at the start the axes of the
# world W: x leads away from the arm, z up.


class CarrierKind(StrEnum):
    """Kinds of carriers."""

    NONE = "none"
    HAND = "hand"
    BELT = "belt"


#: Least and greatest x, y and z [m].
_Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


def carrier_mesh(kind: CarrierKind, surface_C: trimesh.Trimesh) -> trimesh.Trimesh:
    """The surface of a carrier, which is not ``none``, in C; from that of the object in C."""
    # Points that stand for a surface.
    amid, _ = trimesh.sample.sample_surface(surface_C, 6000, seed=0)
    points = np.concatenate([surface_C.vertices, amid])  # vertices are its ends
    boxes = _hand(points) if kind is CarrierKind.HAND else _belt(points)
    mesh = trimesh.Trimesh()
    for sides in boxes:
        mesh += trimesh.creation.box(bounds=np.array(sides).T)
    return mesh


def _hand(points: Array) -> list[_Box]:
    """Thumb, two fingers, palm and forearm."""
    # Palm: thickness, least width, height. Forearm: length, width and height [m].
    palm, (length, across) = (0.03, 0.08, 0.09), (0.30, 0.06)
    # The distance between the middles of two fingers side by side [m].
    beside = 0.022
    # A finger: thickness across the object, width, and how far the palm is behind the object [m].
    thick, wide, clear = 0.014, 0.016, 0.02
    # How far fingers reach over an object at most [m], and over which share of its depth.
    reach, share = 0.03, 0.35
    back = points[:, 0].max()
    tips = back - min(reach, share * np.ptp(points[:, 0]))
    held = points[points[:, 0] >= tips]
    height = float(np.median(held[:, 2]))
    level = held[np.abs(held[:, 2] - height) <= beside]
    low, high = level[:, 1].min(), level[:, 1].max()
    middle, width = (low + high) / 2, max(high - low + 2 * thick, palm[1])
    palm_at, wrist = back + clear, back + clear + palm[0]
    finger, below = (tips, palm_at), (low - thick, low)
    return [
        (finger, (high, high + thick), _about(height, wide)),
        (finger, below, _about(height - beside / 2, wide)),
        (finger, below, _about(height + beside / 2, wide)),
        ((palm_at, wrist), _about(middle, width), _about(height, palm[2])),
        ((wrist, wrist + length), _about(middle, across), _about(height, across)),
    ]


def _belt(points: Array) -> list[_Box]:
    # A belt: its length and width, and how thick it is; it starts a little below the object [m].
    belt, top = (0.20, 0.26, 0.01), points[:, 2].min() - 0.001
    return [(_about(0.0, belt[0]), _about(0.0, belt[1]), (top - belt[2], top))]


def _about(middle: float, size: float) -> tuple[float, float]:
    return middle - size / 2, middle + size / 2


#: How fast a carrier draws back when it has let go [m/s], and how far [m]. Source: guessed.
WITHDRAWAL_SPEED, WITHDRAWAL = 0.3, 0.5


@dataclass(frozen=True, eq=False)
class DistractorBody:
    """A visible body without contact.

    Attributes:
        name: What it is called.
        mesh: Its surface in its own frame C [m].
        color: Red, green, blue, alpha in [0, 1].
        pose: ``X_WC`` (4, 4) at a time [s], and so long after the object was let go [s], 0 while it
            is carried.
    """

    name: str
    mesh: trimesh.Trimesh
    color: tuple[float, float, float, float]
    pose: Callable[[float, float], Array]


def make_carrier(
    kind: CarrierKind, obj: RigidObject, motion: ObjectMotion, hue: float | None
) -> DistractorBody:
    """The carrier, which is not ``none``, of an object along its path; withdraws after the release.

    ``hue`` is that of its color [deg]; None for that of skin.
    """
    # Colour of a carrier without a hue of its own, and saturation and value of one with it.
    skin, vivid = (0.80, 0.58, 0.45), (0.9, 0.85)
    color = skin if hue is None else hsv_to_rgb(hue / 360.0, *vivid)
    R_OC = motion.pose(0.0)[:3, :3].T
    surface_C = trimesh.Trimesh(obj.vertices @ R_OC, obj.faces, process=False)
    X_OC = se3.make_pose(R_OC, np.zeros(3))
    away = np.array([1.0, 0.0, 0.0] if kind is CarrierKind.HAND else [0.0, 0.0, -1.0])

    def pose(t: float, since: float) -> Array:
        back = min(WITHDRAWAL_SPEED * since, WITHDRAWAL) * away
        return np.asarray(motion.pose(t) @ X_OC @ se3.make_pose(np.eye(3), back))

    return DistractorBody("carrier", carrier_mesh(kind, surface_C), (*color, 1.0), pose)


def make_distractor(
    other: RigidObject, motion: ObjectMotion, offset: Array, moving: bool
) -> DistractorBody:
    """Another object, upright, at an offset (3,) [m] from the object, or at rest in the world.

    One that is ``moving`` goes along with the motion of the object; it does not turn.
    """

    def pose(t: float, since: float) -> Array:
        beside = motion.pose(t)[:3, 3] if moving else np.zeros(3)
        return np.asarray(se3.make_pose(np.eye(3), beside + offset))

    return DistractorBody("distractor", other.mesh, other.color, pose)
