"""Samples the quantities behind the metrics of a run."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3_kernels import inverse_kernel, so3_log_kernel
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import arm_condition_kernel, forward_kinematics
from feasigrasp.systems.ports import declare_input, declare_output, optional, scalar

#: Time between samples [s]. Source: definition.
SAMPLE_PERIOD = 0.02

#: The entries of one sample, in order; lengths in metres, angles in radians.
SAMPLE_NAMES = (
    "limit_margin",
    "velocity_ratio",
    "manipulability",
    "grasp_position_error",
    "grasp_angle_error",
    *(f"{name}_{axis}" for name in ("p_HO", "r_OH", "p_WO", "r_WO") for axis in "xyz"),
    "phase",
    "sampled_grasps",
    "reachable_grasps",
    "view_age",
    "tracked_position_error",
)


class Metrics(LeafSystem):
    """Samples what the figures of a run are made of.

    .. pydrake_system::

        name: Metrics
        input_ports: [state, object_pose, frame_pose, tracked_pose, grasps, phase, sampled_grasps,
          view_time]
        output_ports: [sample]

    ``state`` is the arm's V14 state, ``object_pose`` the true one, X_WB, ``frame_pose`` the true
    pose X_WO of the object frame in which the grasps are, where that is not the object's own (see
    `TrueFrame`; the port may stay unconnected), ``tracked_pose``, optional, what is measured of
    that one, ``grasps`` what the controller is given, in O,
    ``sampled_grasps`` what reachability was judged of, ``view_time`` the time of the last view
    behind ``grasps`` (NaN without one). These three may stay unconnected, where no system has
    them. ``sample`` holds `SAMPLE_NAMES`: smallest distance to a joint limit (negative beyond it);
    largest joint speed over its limit; manipulability at the flange; error to the nearest grasp
    (NaN without grasps); the object's position in the hand, the hand's orientation on the object as
    a rotation vector, the object's position and orientation in the world likewise; the `Phase`; how
    many grasps were sampled, and how many of them the controller is given (NaN if unconnected);
    time since the last view; distance of the tracked position from the true one (NaN likewise).
    """

    @checked()
    def __init__(self, gripper: Gripper, arm: Arm = IIWA_7) -> None:
        """Metrics for an arm that carries ``gripper``."""
        super().__init__()
        self._gripper, self._arm = gripper, arm
        self._state = self.DeclareVectorInputPort("state", 2 * arm.joints)
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._frame_pose = declare_input(self, "frame_pose", RigidTransform())
        self._tracked = declare_input(self, "tracked_pose", RigidTransform())
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self._sampled = declare_input(self, "sampled_grasps", GraspSet.empty())
        self._view_time = self.DeclareVectorInputPort("view_time", 1)
        declare_output(self, "sample", self._calc, size=len(SAMPLE_NAMES))

    def _calc(self, context: Context) -> Array:
        q, v = np.split(self._state.Eval(context), 2)
        X_WB = self._pose.Eval(context).GetAsMatrix4()
        frame_pose: RigidTransform | None = optional(self._frame_pose, context)
        X_WO = X_WB if frame_pose is None else frame_pose.GetAsMatrix4()
        tracked: RigidTransform | None = optional(self._tracked, context)
        p_WO = np.full(3, np.nan) if tracked is None else tracked.translation()
        X_WH = forward_kinematics(q, self._gripper.X_FG, self._arm)
        X_BH = inverse_kernel(X_WB) @ X_WH
        grasps: GraspSet | None = optional(self._grasps, context)
        sampled: GraspSet | None = optional(self._sampled, context)
        nearest = np.full(2, np.nan)
        if grasps is not None and len(grasps) > 0:
            errors = grasp_errors(grasps.X_OG, inverse_kernel(X_WO) @ X_WH)
            nearest = errors[np.argmin(errors[:, 0] + 0.1 * errors[:, 1])]
        p_HB = inverse_kernel(X_BH)[:3, 3]
        view_time = scalar(self._view_time, context, np.nan)
        return np.concatenate(
            [
                arm_condition_kernel(self._arm.chain, q, v),
                nearest,
                p_HB,
                so3_log_kernel(np.ascontiguousarray(X_BH[:3, :3])),
                X_WB[:3, 3],
                so3_log_kernel(np.ascontiguousarray(X_WB[:3, :3])),
                self._phase.Eval(context),
                [_count(sampled), _count(grasps), context.get_time() - view_time],
                [np.linalg.norm(p_WO - X_WO[:3, 3])],
            ]
        )


def _count(grasps: GraspSet | None) -> float:
    """Number of grasps; NaN if unconnected."""
    return np.nan if grasps is None else float(len(grasps))
