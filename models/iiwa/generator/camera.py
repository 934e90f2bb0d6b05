"""The URDF of the wrist camera."""

from xml.etree import ElementTree as ET

import numpy as np

from generator import urdf as xml

#: Width, height and depth of an Intel RealSense D435, along the camera's X, Y and Z [m].
CAMERA_SIZE = np.array([0.090, 0.025, 0.025])
CAMERA_MASS = 0.072
# The depth origin lies 4.2 mm behind the front glass (D435 data sheet, figure 4-4). It is put into
# the middle of the width, so that the optical axis crosses the axis of the hand.
OPTICAL_DEPTH = 0.0042
FRICTION = 0.5


def camera_urdf() -> str:
    """Text of d435.urdf: ``camera_body`` at the box's centre, ``camera_optical`` behind the glass.

    Both frames have X to the right of the image, Y down and Z forward.
    """
    robot = ET.Element("robot", name="d435")
    body = ET.SubElement(robot, "link", name="camera_body")
    xml.inertial(body, CAMERA_MASS, (0, 0, 0), xml.box_inertia(CAMERA_MASS, CAMERA_SIZE))
    xml.visual_mesh(body, xml.packaged_mesh("camera.gltf"))
    collision = xml.shape(body, "collision", xml.box(CAMERA_SIZE), name="case")
    xml.proximity(collision, friction=FRICTION)
    depth = CAMERA_SIZE[2] / 2 - OPTICAL_DEPTH
    xml.frame(robot, "camera_optical", "camera_body", (0.0, 0.0, depth))
    return xml.document(robot)
