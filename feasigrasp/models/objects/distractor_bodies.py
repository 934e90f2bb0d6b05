"""Visible bodies without contact: the carrier of the object, and a distractor."""

from __future__ import annotations

from colorsys import hsv_to_rgb
from dataclasses import dataclass

import numpy as np
import trimesh

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.carriers import WITHDRAWS, CarrierKind, carrier_mesh
from feasigrasp.models.objects.motion import ObjectMotion
from feasigrasp.models.objects.rigid_object import RigidObject

#: How fast a carrier draws back when it has let go [m/s], and how far [m].
WITHDRAWAL_SPEED, WITHDRAWAL = 0.3, 0.5
#: Colour of a carrier without a hue of its own, and saturation and value of one with it.
_SKIN, _VIVID = (0.80, 0.58, 0.45), (0.9, 0.85)


@dataclass(frozen=True, eq=False)
class DistractorBody:
    """Base class of visible bodies without contact.

    Attributes:
        name: What it is called.
        mesh: Its surface in its own frame C [m].
        color: Red, green, blue, alpha in [0, 1].
        motion: That of the object.
    """

    name: str
    mesh: trimesh.Trimesh
    color: tuple[float, float, float, float]
    motion: ObjectMotion

    def pose(self, t: float, since: float) -> Array:
        """``X_WC`` at time t [s], shape (4, 4).

        Args:
            t: Time [s].
            since: How long the object has been let go [s], 0 while it is carried.
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Carrier(DistractorBody):
    """Carrier of the object along its path; withdraws after the release.

    Attributes:
        X_OC: Its pose in the object's frame while it carries it, shape (4, 4).
        withdraws: Along which direction of C it draws back, shape (3,).
    """

    X_OC: Array
    withdraws: Array

    @classmethod
    def of(
        cls, kind: CarrierKind, obj: RigidObject, motion: ObjectMotion, hue: float | None
    ) -> Carrier:
        """The carrier of an object that starts where its motion does.

        Args:
            kind: Which one; not ``none``.
            obj: What it carries.
            motion: Where it carries it.
            hue: Of its colour [deg]; None for that of skin.
        """
        color = _SKIN if hue is None else hsv_to_rgb(hue / 360.0, *_VIVID)
        R_OC = motion.pose(0.0)[:3, :3].T
        surface_C = trimesh.Trimesh(obj.vertices @ R_OC, obj.faces, process=False)
        X_OC = se3.make_pose(R_OC, np.zeros(3))
        mesh = carrier_mesh(kind, surface_C)
        return cls("carrier", mesh, (*color, 1.0), motion, X_OC, WITHDRAWS[kind])

    def pose(self, t: float, since: float) -> Array:
        """``X_WC`` at time t [s], shape (4, 4); see `DistractorBody`."""
        back = min(WITHDRAWAL_SPEED * since, WITHDRAWAL) * self.withdraws
        return np.asarray(self.motion.pose(t) @ self.X_OC @ se3.make_pose(np.eye(3), back))


@dataclass(frozen=True, eq=False)
class Distractor(DistractorBody):
    """Another object, upright, which moves beside the object or rests.

    Attributes:
        offset: Where it is from the object [m], or if it rests in the world, shape (3,).
        moving: Whether it moves with the object; it does not turn.
    """

    offset: Array
    moving: bool

    def pose(self, t: float, since: float) -> Array:
        """``X_WC`` at time t [s], shape (4, 4); see `DistractorBody`."""
        beside = self.motion.pose(t)[:3, 3] if self.moving else np.zeros(3)
        return np.asarray(se3.make_pose(np.eye(3), beside + self.offset))
