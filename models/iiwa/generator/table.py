"""The URDF of the table."""

from xml.etree import ElementTree as ET

import numpy as np

from generator import xml

SIZE = np.array([1.6, 1.6, 0.04])
LEG = np.array([0.06, 0.06, 0.70])
MASS = 40.0
FRICTION = 0.8
MODULUS = 1e7
DISSIPATION = 20.0


def table_urdf() -> str:
    """Text of table.urdf: a square top whose surface is z = 0 of ``table_top``."""
    robot = ET.Element("robot", name="table")
    top = ET.SubElement(robot, "link", name="table_top")
    center = np.array([0.0, 0.0, -SIZE[2] / 2])
    xml.inertial(top, MASS, center, xml.box_inertia(MASS, SIZE))
    xml.shape(top, "visual", xml.box(SIZE), name="top", xyz=center, color="0.80 0.72 0.60 1")
    for k, (x, y) in enumerate([(1, 1), (1, -1), (-1, -1), (-1, 1)]):
        at = np.array([x, y, -1]) * (SIZE + (0, 0, LEG[2] + SIZE[2])) / 2 - (x * 0.08, y * 0.08, 0)
        xml.shape(top, "visual", xml.box(LEG), name=f"leg_{k}", xyz=at, color="0.35 0.36 0.38 1")
    collision = xml.shape(top, "collision", xml.box(SIZE), name="top", xyz=center)
    xml.proximity(collision, friction=FRICTION, dissipation=DISSIPATION, modulus=MODULUS)
    return xml.document(robot)
