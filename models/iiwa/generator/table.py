"""The URDF of the table, and its look."""

from xml.etree import ElementTree as ET

import numpy as np

from generator import urdf as xml
from generator.housings import Parts
from generator.palette import Material
from generator.solids import bevelled_box, join

SIZE = np.array([1.6, 1.6, 0.04])
LEG = np.array([0.06, 0.06, 0.70])
MASS = 40.0
FRICTION = 0.8
# Dark, for the bright lights of a replay.
WOOD = Material((0.26, 0.18, 0.10), 0.0, 0.9)
STEEL = Material((0.012, 0.013, 0.015), 0.0, 0.9)


def table_parts() -> Parts:
    """Top and legs, in the frame of ``table_top``."""
    inset = 0.08
    spread = SIZE / 2 - (inset, inset, 0.0)
    legs = [
        bevelled_box((x * spread[0], y * spread[1], -SIZE[2] - LEG[2] / 2), LEG, 0.001)
        for x in (1, -1)
        for y in (1, -1)
    ]
    top = bevelled_box((0.0, 0.0, -SIZE[2] / 2), SIZE, 0.001)
    return [(WOOD, top), (STEEL, join(legs))]


def table_urdf() -> str:
    """Text of table.urdf: a square top whose surface is z = 0 of ``table_top``."""
    robot = ET.Element("robot", name="table")
    top = ET.SubElement(robot, "link", name="table_top")
    center = np.array([0.0, 0.0, -SIZE[2] / 2])
    xml.inertial(top, MASS, center, xml.box_inertia(MASS, SIZE))
    xml.visual_mesh(top, xml.packaged_mesh("table.gltf"))
    collision = xml.shape(top, "collision", xml.box(SIZE), name="top", xyz=center)
    xml.proximity(collision, friction=FRICTION)
    return xml.document(robot)
