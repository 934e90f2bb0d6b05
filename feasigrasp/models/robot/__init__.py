"""What arm and hand are: facts, kinematics, collisions."""

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.grippers import WSG_50
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability, pose_and_jacobian

__all__ = ["ParallelGripper", "WSG_50", "forward_kinematics", "manipulability", "pose_and_jacobian"]
