"""What a run is judged by: samples of the quantities behind its metrics, and the true frame O."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3_kernels import inverse_kernel, so3_log_kernel
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import arm_condition_kernel, tool_pose
from feasigrasp.models.tracking.tracker import FieldTrack
from feasigrasp.systems.ports import declare_input, declare_output, optional, scalar, weakly

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
        X_WH = tool_pose(q, self._gripper.X_FG, self._arm)
        X_BH = inverse_kernel(X_WB) @ X_WH
        grasps, sampled = optional(self._grasps, context), optional(self._sampled, context)
        nearest = np.full(2, np.nan)
        if grasps is not None and len(grasps) > 0:
            errors = grasp_errors(grasps.X_OG, inverse_kernel(X_WO) @ X_WH)
            nearest = errors[np.argmin(errors[:, 0] + 0.1 * errors[:, 1])]
        counts = [np.nan if each is None else len(each) for each in (sampled, grasps)]
        view_age = context.get_time() - scalar(self._view_time, context, np.nan)
        return np.concatenate(
            [
                arm_condition_kernel(self._arm.chain, q, v),
                nearest,
                inverse_kernel(X_BH)[:3, 3],
                so3_log_kernel(np.ascontiguousarray(X_BH[:3, :3])),
                X_WB[:3, 3],
                so3_log_kernel(np.ascontiguousarray(X_WB[:3, :3])),
                self._phase.Eval(context),
                [*counts, view_age, np.linalg.norm(p_WO - X_WO[:3, 3])],
            ]
        )


class TrueFrame(LeafSystem):
    """Follows the object frame O of a tracker as if it were painted on the object.

    .. pydrake_system::

        name: TrueFrame
        input_ports: [object_pose, pose_at_view, tracked_pose, track]
        output_ports: [frame_pose]

    ``object_pose`` is the true pose X_WB of the object's own frame, ``pose_at_view`` the one at the
    exposure of the image that was tracked last, and ``tracked_pose`` X_WO of the frame that the
    tracker chose at the first view, NaN before. Where O is on the object, X_BO, is
    taken from both once, as soon as there is a tracked pose, and again if the tracker's ``track``
    (`FieldTrack`, optional) begins a new O; from then on ``frame_pose`` is X_WB X_BO, whatever the
    tracker says: by it is judged how well the hand follows grasps that are in O. Before it is X_WB.
    """

    def __init__(self, period: float) -> None:
        """Ground truth for evaluation; no evaluated system may read it.

        Args:
            period: Time between looks for the first tracked pose [s]; so long, at most, the object
                has moved since. Between two steps of the physics it does not move.
        """
        super().__init__()
        self._object_pose = declare_input(self, "object_pose", RigidTransform())
        self._at_view = declare_input(self, "pose_at_view", RigidTransform())
        self._tracked_pose = declare_input(self, "tracked_pose", RigidTransform())
        self._track = declare_input(self, "track", FieldTrack())
        # X_BO, and when O was begun [s]; discrete, since an abstract state invalidates all caches.
        self.DeclareDiscreteState(np.full(13, np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._align))
        declare_output(self, "frame_pose", self._calc, model=RigidTransform())

    def _align(self, context: Context, state) -> EventStatus:
        track = optional(self._track, context)
        begun_at = -np.inf if track is None else track.begun_at
        if context.get_discrete_state_vector().value()[12] == begun_at:
            return EventStatus.DidNothing()
        X_WO = self._tracked_pose.Eval(context).GetAsMatrix4()
        if not np.isfinite(X_WO).all():
            return EventStatus.DidNothing()
        X_BO = inverse_kernel(self._at_view.Eval(context).GetAsMatrix4()) @ X_WO
        state.get_mutable_vector().SetFromVector([*X_BO[:3].ravel(), begun_at])
        return EventStatus.Succeeded()

    def _calc(self, context: Context) -> RigidTransform:
        gauge = context.get_discrete_state_vector().value()[:12]
        X_WB = self._object_pose.Eval(context)
        if not np.isfinite(gauge).all():
            return X_WB
        X_BO = np.eye(4)
        X_BO[:3] = gauge.reshape(3, 4)
        return RigidTransform(X_WB.GetAsMatrix4() @ X_BO)
