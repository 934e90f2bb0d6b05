"""Models of arm and hand: data, kinematics, collisions."""

from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.gripper import ParallelGripper, SuctionCup
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability, pose_and_jacobian

__all__ = [
    "IIWA_7",
    "WSG_50",
    "Arm",
    "ParallelGripper",
    "SuctionCup",
    "forward_kinematics",
    "manipulability",
    "pose_and_jacobian",
]
