"""Grasps at which the camera on the hand would not see the object are rated lower."""

from __future__ import annotations

from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.control.planning.grasp_view import rated_by_view
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.systems.ports import declare_input, declare_output, evaluate


class ViewFilter(LeafSystem):
    """Rates grasps by how much of the object the camera on the hand sees there.

    .. pydrake_system::

        name: ViewFilter
        input_ports:
        - grasps
        - gpdf
        - position
        - camera_pose
        output_ports:
        - grasps

    ``grasps`` are in the object frame O, before and after, the hand turned as it will be; ``gpdf``
    is the object's `Gpdf`, or None, without which nothing is rated; ``position`` V7 [rad] and
    ``camera_pose`` X_WC tell where on the hand the camera is. None is dropped.
    """

    def __init__(self, gripper: ParallelGripper, camera: Camera, standoff: float = 0.0) -> None:
        """A filter for a hand with ``camera`` on it that waits ``standoff`` behind grasps [m]."""
        super().__init__()
        self._gripper, self._camera, self._standoff = gripper, camera, standoff
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._gpdf = declare_input(self, "gpdf", kind=Gpdf | None)
        self._position = self.DeclareVectorInputPort("position", IIWA_7.joints)
        self._pose = declare_input(self, "camera_pose", RigidTransform())
        declare_output(self, "grasps", self._calc)

    def _calc(self, context: Context) -> GraspSet:
        grasps, gpdf = self._grasps.Eval(context), evaluate(self._gpdf, context)
        if gpdf is None:
            return grasps
        X_WH = forward_kinematics(self._position.Eval(context), self._gripper.X_FG)
        X_HC = se3.inverse(X_WH) @ self._pose.Eval(context).GetAsMatrix4()
        X_HC[2, 3] -= self._standoff
        return rated_by_view(grasps, gpdf.points, X_HC, self._camera)
