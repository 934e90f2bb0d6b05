"""The directives that assemble arm, gripper, camera and table."""

import numpy as np

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.hand_model import camera_pose
from feasigrasp.models.robot.iiwa import IIWA_7
from generator.urdf import number

_HEADER = "# Written by models/iiwa/make_models.py.\n"

_OWN_ARM = """directives:
- add_model:
    name: iiwa
    file: package://feasigrasp/iiwa/iiwa7.urdf
- add_weld:
    parent: world
    child: iiwa::iiwa_link_0
"""

_DRAKE_ARM = """directives:
- add_model:
    name: iiwa
    file: package://drake_models/iiwa_description/sdf/iiwa7_with_box_collision.sdf
- add_weld:
    parent: world
    child: iiwa::iiwa_link_0
- add_frame:
    name: iiwa::iiwa_flange
    X_PF:
      base_frame: iiwa::iiwa_link_7
      translation: [0, 0, {flange}]
"""

_REST = """- add_model:
    name: gripper
    file: package://feasigrasp/iiwa/gripper.urdf
- add_weld:
    parent: iiwa::iiwa_flange
    child: gripper::gripper_body
- add_model:
    name: camera
    file: package://feasigrasp/iiwa/d435.urdf
- add_weld:
    parent: iiwa::iiwa_flange
    child: camera::camera_body
    X_PC:
      translation: [{x}, {y}, {z}]
      rotation: !Rpy {{ deg: [{roll}, 0, -90] }}
- add_model:
    name: table
    file: package://feasigrasp/iiwa/table.urdf
- add_weld:
    parent: world
    child: table::table_top
"""


def cell_directives(gripper: ParallelGripper, *, drake_arm: bool = False) -> str:
    """Text of cell.dmd.yaml, or of the variant with the arm of the drake_models package."""
    x, y, z = map(number, camera_pose(gripper)[:3, 3])
    # The rotation of camera_pose as roll and yaw.
    rest = _REST.format(x=x, y=y, z=z, roll=number(-np.rad2deg(gripper.camera_tilt)))
    if not drake_arm:
        return _HEADER + _OWN_ARM + rest
    return _HEADER + _DRAKE_ARM.format(flange=number(IIWA_7.link_steps[-1])) + rest
