"""Bodies of a scenario beside object and robot: obstacles, carrier and distractor."""

import dataclasses as dc

from feasigrasp.models.choices import PLACE, TURN, key, word
from feasigrasp.models.objects.distractor_bodies import CarrierKind
from feasigrasp.models.objects.spring_drive import SPRINGS, CarrierHold, Compliance, Release


@dc.dataclass
class CarrierConfig:
    """Carrier of the object. It releases after the fingers have closed, and withdraws.

    The cameras see it; nothing touches it.

    Attributes:
        stiffness: How firmly it holds the object: as a relaxed hand (300 N/m, 3 Nm/rad), a tensed
            one (1000 N/m, 10 Nm/rad), or a robot's flange (10 kN/m, 100 Nm/rad).
        release: When it lets go after the fingers have squeezed: ``late``, by ``release_delay``;
            ``load``, once it bears less than half of the weight.
        release_delay: Reaction time of a ``late`` release [s].
        kind: ``none``; ``hand``, fingers that hold the object from the side turned away from the
            arm, and a forearm behind them; ``belt``, a level plate under it.
        hue: Hue of it, as of a glove, by which ``segmentation: depth`` separates it from the object
            [deg]: 0 is red, 120 green, 240 blue. Without it color separates nothing, and the
            simulated carrier has the color of skin.
    """

    stiffness: str = word(Compliance.STIFF, Compliance)
    release: str = word(Release.LATE, Release)
    release_delay: float = key(0.3, 0.0, 10.0, "s")
    kind: str = word(CarrierKind.NONE, CarrierKind)
    hue: float | None = key(None, 0.0, 360.0, "deg")

    @property
    def hold(self) -> CarrierHold:
        """How it holds the object, and lets it go."""
        spring = SPRINGS[Compliance(self.stiffness)]
        return CarrierHold(spring, Release(self.release), self.release_delay)


@dc.dataclass
class DistractorConfig:
    """Another object in the air, which is not to be grasped.

    The cameras see it; nothing touches it.

    Attributes:
        model: Name of a built-in object, or a path to a mesh; there is none if it is empty.
        offset: Where it is, along the axes of the world [m]: from the object if it moves, else from
            the middle of the object's path.
        moving: Whether it moves with the object.
    """

    model: str = ""
    offset: list[float] = key([0.0, 0.15, 0.0], -2.0, 2.0, "m")
    moving: bool = False


@dc.dataclass
class BoxConfig:
    """A box that does not move.

    Attributes:
        size: Its edges along its own x, y, z [m].
        position: Its middle, in the frame of the arm's base [m].
        rpy_deg: Roll, pitch and yaw about the axes of the base [deg].
    """

    size: list[float] = key([0.1, 0.1, 0.1], 0.001, 10.0, "m")
    position: list[float] = key([0.0, 0.0, 0.0], *PLACE)
    rpy_deg: list[float] = key([0.0, 0.0, 0.0], *TURN)


@dc.dataclass
class MeshConfig:
    """A mesh that does not move; it collides as the convex hull of each of its connected parts.

    Attributes:
        file: The mesh (obj, ply, stl, off, glb); a path starts at the scenario's file.
        scale: Factor from the mesh's unit to metres.
        position: Origin of its frame, in the frame of the arm's base [m].
        rpy_deg: Roll, pitch and yaw about the axes of the base [deg].
    """

    file: str = ""
    scale: float = key(1.0, 1e-06, 1000000.0)
    position: list[float] = key([0.0, 0.0, 0.0], *PLACE)
    rpy_deg: list[float] = key([0.0, 0.0, 0.0], *TURN)


@dc.dataclass
class CellConfig:
    """The table and the obstacles of the cell; in ``safe`` mode the arm keeps clear of them.

    Attributes:
        table_height: Height of the table top in the frame of the arm's base [m]. A model ``table``
            that the directives weld to the world stands there.
        table_clearance: Distance that arm and hand keep from the table [m]; grasps are chosen with
            1 cm more.
        boxes: Boxes by name.
        meshes: Meshes by name.
        unmodeled: Models of the directives that the controller is not given, to test perception.
    """

    table_height: float = key(0.0, -1.0, 0.1, "m")
    table_clearance: float = key(0.01, 0.0, 0.2, "m")
    boxes: dict[str, BoxConfig] = dc.field(default_factory=dict)
    meshes: dict[str, MeshConfig] = dc.field(default_factory=dict)
    unmodeled: list[str] = dc.field(default_factory=list)
