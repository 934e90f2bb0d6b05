"""The look of the gripper and of the wrist camera, as coloured meshes."""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.hand_model import camera_pose
from generator.camera import CAMERA_SIZE
from generator.housings import DARK, GREY, ORANGE, SILVER, Parts
from generator.palette import Material
from generator.solids import bevelled_box, cylinder, join, lathe, rounded_box, surface, union

GLASS = Material((0.02, 0.02, 0.03), 0.0, 0.1)
RUBBER = Material((0.005, 0.005, 0.006), 0.0, 0.9)
LENS = Material((0.12, 0.13, 0.2), 0.0, 0.1)


def gripper_parts(gripper: ParallelGripper) -> Parts:
    """Mount, palm, finger guide and camera bracket, in the flange frame."""
    palm_x, palm_y, palm_z = gripper.palm_size
    front = gripper.tool_offset + gripper.heel
    back = front - palm_z
    palm = bevelled_box((0, 0, front - palm_z / 2), (palm_y, palm_x, palm_z), 0.008)
    reach = gripper.max_opening + 2 * gripper.finger_thickness
    guide_size = (gripper.finger_width + 0.006, reach + 0.006, 0.014)
    guide = bevelled_box((0, 0, front - 0.0068), guide_size, 0.002)
    adapter = [(0.0, 0.0), (0.0335, 0.0), (0.0335, 0.011), (0.0325, 0.012), (0.0, 0.012)]
    column = [(0.026, 0.012), (0.026, back + 0.01)]
    ring = [(0.026, back - 0.014), (0.0285, back - 0.014), (0.0285, back - 0.007)]
    ring += [(0.026, back - 0.007)]
    # A plate from the column to the camera's back, and a post that meets the tilted back.
    X_FC = camera_pose(gripper)
    camera_back = X_FC[:3, 3] - X_FC[:3, 2] * CAMERA_SIZE[2] / 2
    length = -camera_back[0] - 0.012
    center = np.array([-0.020 - length / 2, 0.0, back - 0.018])
    plate = rounded_box(center, (length, 0.036, 0.006), 0.002)
    post = cylinder(camera_back - 0.013 * X_FC[:3, 2], camera_back + 0.001 * X_FC[:3, 2], 0.010)
    low = (center[0] - length / 2 - 0.012, -0.025, center[2] - 0.008)
    bracket = surface(union(plate, post, 0.004), low, (-0.01, 0.025, back + 0.006), 0.004)
    return [
        (DARK, palm),
        (GREY, join([guide, lathe(column, "z"), bracket])),
        (SILVER, lathe(adapter, "z")),
        (ORANGE, lathe(ring, "z")),
    ]


def finger_parts(gripper: ParallelGripper, sign: float, pad_size: Array) -> Parts:
    """A finger and its pad, in the finger's frame."""
    pad = pad_size[0]
    thickness = gripper.finger_thickness - pad
    length = gripper.tip - gripper.heel
    center = np.array([sign * (pad + thickness / 2), 0.0, gripper.tip - length / 2])
    size = np.array([thickness, gripper.finger_width - 0.002, length])
    bone = bevelled_box(center, size, 0.002)
    stripe_center = center + (sign * thickness / 2, 0.0, 0.004)
    stripe = bevelled_box(stripe_center, (0.0012, 0.010, 0.030), 0.0004)
    pad_box = bevelled_box((sign * pad / 2, 0.0, 0.0), pad_size, 0.0005)
    return [(SILVER, bone), (ORANGE, stripe), (RUBBER, pad_box)]


def camera_parts() -> Parts:
    """Case, front glass and the four windows of a D435, in the camera_body frame."""
    width, height, depth = CAMERA_SIZE
    case = bevelled_box((0, 0, -0.0005), CAMERA_SIZE - (0, 0, 0.001), 0.006)
    face = depth / 2
    glass = bevelled_box((0, 0, face - 0.003), (width - 0.014, height - 0.010, 0.005), 0.001)
    # Colour camera, left imager, projector, right imager.
    windows = [(-0.0325, 0.0040), (-0.0175, 0.0045), (0.0100, 0.0030), (0.0325, 0.0045)]
    profiles = [([(r, -0.002), (r, 0.0), (0.0, 0.0)], x) for x, r in windows]
    lenses = [lathe(p, "z", (x, 0.0, face), sides=20) for p, x in profiles]
    return [(SILVER, case), (GLASS, glass), (LENS, join(lenses))]
