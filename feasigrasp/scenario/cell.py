"""Static bodies of the robot cell: the section ``cell`` of a scenario."""

import dataclasses as dc

from feasigrasp.models.choices import PLACE, TURN, key


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
    """

    table_height: float = key(0.0, -1.0, 0.1, "m")
    table_clearance: float = key(0.01, 0.0, 0.2, "m")
    boxes: dict[str, BoxConfig] = dc.field(default_factory=dict)
    meshes: dict[str, MeshConfig] = dc.field(default_factory=dict)
