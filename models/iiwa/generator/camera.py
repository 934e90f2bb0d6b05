"""The URDF of the wrist camera, and where it sits on the flange."""

from xml.etree import ElementTree as ET

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.gripper import ParallelGripper
from generator import xml

#: Width, height and depth of an Intel RealSense D435, along the camera's X, Y and Z [m].
CAMERA_SIZE = np.array([0.090, 0.025, 0.025])
CAMERA_MASS = 0.072
# The depth origin lies 4.2 mm behind the front glass (D435 data sheet, figure 4-4). It is put into
# the middle of the width, so that the optical axis crosses the axis of the hand.
OPTICAL_DEPTH = 0.0042
FRICTION = 0.5


def camera_pose(gripper: ParallelGripper) -> Array:
    """Pose X_FC of ``camera_body`` in the flange frame.

    X_C = -x_G, Y_C = -y_G and Z_C = z_G, turned about X_C so that Z_C leans to the tool axis.
    """
    c, s = np.cos(gripper.camera_tilt), np.sin(gripper.camera_tilt)
    X_GC = np.eye(4)
    X_GC[:3, :3] = np.array([[-1, 0, 0], [0, -c, -s], [0, -s, c]])
    X_GC[:3, 3] = gripper.camera_center
    return gripper.X_FG @ X_GC


def camera_urdf() -> str:
    """Text of d435.urdf: ``camera_body`` at the box's centre, ``camera_optical`` behind the glass.

    Both frames have X to the right of the image, Y down and Z forward.
    """
    robot = ET.Element("robot", name="d435")
    body = ET.SubElement(robot, "link", name="camera_body")
    xml.inertial(body, CAMERA_MASS, (0, 0, 0), xml.box_inertia(CAMERA_MASS, CAMERA_SIZE))
    xml.visual_mesh(body, "camera")
    collision = xml.shape(body, "collision", xml.box(CAMERA_SIZE), name="case")
    xml.proximity(collision, friction=FRICTION)
    depth = CAMERA_SIZE[2] / 2 - OPTICAL_DEPTH
    xml.frame(robot, "camera_optical", "camera_body", (0.0, 0.0, depth))
    return xml.document(robot)
