"""State machine of the gripper: close, release from the carrier, lift, shake, hold."""

from functools import partial

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.planning.search_pose import SEARCH_AFTER, SearchTarget
from feasigrasp.models.control.planning.stall import Attempt
from feasigrasp.models.control.status import StatusCode
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import (
    CommittedMotion,
    GraspSequenceConfig,
    GraspState,
    Phase,
)
from feasigrasp.models.objects.prediction import Motion, future_poses
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.quantities import Positive
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import tool_pose
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.point_cloud_to_gpdf import Perceived
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    declare_pose_and_velocity,
    optional,
    scalar,
)


class GripperSequencer(LeafSystem):
    """Decides when to close, and what the arm follows from then on.

    .. pydrake_system::

        name: GripperSequencer
        input_ports: [position, grasps, object_pose, object_velocity, object_motion, gripper_state,
          gpdf, tracking, perceived, lapsed, arrival]
        output_ports: [grasps, gpdf, object_pose, object_velocity, object_motion, gripper_position,
          object_hold, phase, search_target]

    It stands between the reachability filter and a controller, and passes grasps, object pose and
    twist through while the hand approaches, and the object's field, a `Gpdf` or None, if it is
    connected. While the object is lost (``tracking``, a `Tracking`), a view contradicts its pose
    (``perceived``, a `Perceived`), or perception's process is gone (``lapsed``, V1, not 0), grasps
    lapse: none is passed on, and a controller brakes and waits; ``rejected`` of the empty set has
    the `StatusCode`. Neither are pose and twist (NaN), unless it is a view that contradicts them:
    then the hand that waits had better keep off where the object may be. Nor are the fingers closed
    on a pose that is merely extrapolated. These ports are optional. ``search_target`` is a
    `SearchTarget` while an object that is to be approached has been out of sight for a moment, its
    tracker says where it is expected, and the arm can look there; else None.

    ``arrival`` is a `GraspSet` as well: a controller that finds grasps of its own on the way gives
    them here, and they are passed on with the others.

    A hand that does not get on gives the nearest grasp up for a while.

    Once the hand has been at a grasp for a moment, only that grasp is passed on, with the pose
    predicted then (by ``object_motion``, a `MotionEstimate` or None, else by the twist), and the
    fingers close; from then on there is no field, since the object is there to be touched. After it
    is let go, pose and twist are those of a lift and of shaking. ``object_motion`` is the tracked
    one while the hand approaches, and then what is known of all that is to come.

    ``gripper_position`` is the commanded distance between the pads [m], ``gripper_state`` the
    measured one and its rate, ``object_hold`` 1 until the object is let go, ``phase`` a `Phase`.
    The state advances every ``period`` seconds, the rate at which grasps arrive.
    """

    #: Commanded distance between closed pads; negative, so that they squeeze whatever is between.
    CLOSED = -0.05

    @checked(GraspError)
    def __init__(
        self,
        config: GraspSequenceConfig,
        gripper: Gripper,
        *,
        period: Positive = ReachabilityConfig.period,
        looks: bool = False,
        gives_up: bool = False,
        arm: Arm = IIWA_7,
    ) -> None:
        """A sequencer that advances every ``period`` [s] as ``config`` says.

        It ``looks`` for objects that are out of sight with a camera on the arm. If it ``gives_up``,
        grasps that the hand comes no nearer to are left out, and low-scoring ones while there are
        others.
        """
        super().__init__()
        self._looks, self._gives_up, self._config = looks, gives_up and config.close, config
        self._gripper, self._arm = gripper, arm
        self._position = self.DeclareVectorInputPort("position", arm.joints)
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._velocity = declare_input(self, "object_velocity", SpatialVelocity.Zero())
        self._motion = declare_input(self, "object_motion", kind=Motion | None)
        self._gripper_state = self.DeclareVectorInputPort("gripper_state", 2)
        self._gpdf = declare_input(self, "gpdf", kind=Gpdf | None)
        self._tracking = declare_input(self, "tracking", kind=Tracking | None)
        self._perceived = declare_input(self, "perceived", kind=Perceived | None)
        self._lapsed = self.DeclareVectorInputPort("lapsed", 1)
        self._arrival = declare_input(self, "arrival", GraspSet.empty())
        self._state = PeriodicState(self, GraspState(), period, self._advance)
        self._attempt = PeriodicState(self, Attempt(), period, self._get_on)

        state, time = self._state, self.time_ticket()
        doubts = {self._tracking, self._perceived, self._lapsed}
        offered = {self._attempt, self._grasps, self._arrival}
        self._usable = declare_cache(self, "usable grasps", self._calc_usable, offered)
        declare_output(self, "grasps", self._calc_grasps, {state, self._usable, *doubts})
        declare_output(self, "gpdf", self._calc_gpdf, {state, self._gpdf})
        target = {state, time, self._pose, self._velocity, *doubts}
        declare_pose_and_velocity(self, self._target, target)
        declare_output(self, "object_motion", self._calc_motion, {state, time, self._motion})
        declare_output(self, "gripper_position", self._calc_gripper, {state, time}, size=1)
        declare_output(self, "object_hold", lambda of: not self.state(of).released, {state}, size=1)
        declare_output(self, "phase", lambda context: self.state(context).phase, {state}, size=1)
        searched = {state, self._tracking}
        declare_output(self, "search_target", self._calc_search_target, searched)

    @checked(GraspError)
    def state(self, context: Context) -> GraspState:
        """State of the sequence."""
        return self._state.Eval(context)

    def _doubt(self, context: Context) -> StatusCode | None:
        """Why what is known of the object is not to be relied on; None if it is."""
        tracking: Tracking | None = optional(self._tracking, context)
        if tracking is not None and tracking.lost:
            return StatusCode.POSE_LOST
        perceived: Perceived | None = optional(self._perceived, context)
        if perceived is not None and perceived.contradicted:
            return StatusCode.POSE_CONTRADICTED
        if scalar(self._lapsed, context, 0.0):
            return StatusCode.PERCEPTION_LAPSED
        return None

    def _coasting(self, context: Context) -> bool:
        """Whether the pose is extrapolated at best."""
        tracking: Tracking | None = optional(self._tracking, context)
        return tracking is not None and tracking.state is not TrackingState.TRACKING

    def _advance(self, context: Context) -> GraspState:
        state = self.state(context)
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        V_WO = self._velocity.Eval(context).get_coeffs()
        motion = optional(self._motion, context)
        if state.phase == Phase.APPROACH and (self._doubt(context) or self._coasting(context)):
            X_WO = np.full((4, 4), np.nan)  # nothing to close the fingers on
        return state.advanced(
            context.get_time(),
            tool_pose(self._position.Eval(context), self._gripper.X_FG, self._arm),
            X_WO,
            V_WO,
            self._usable.Eval(context),
            self._gripper_state.Eval(context),
            self._config,
            None if motion is None else partial(future_poses, motion, X_WO, V_WO),
        )

    def _get_on(self, context: Context) -> Attempt:
        now, X_WO = context.get_time(), self._pose.Eval(context).GetAsMatrix4()
        attempt: Attempt = self._attempt.Eval(context)
        doubted = self._doubt(context) is not None or self._coasting(context)
        if not self._gives_up:
            return attempt
        if self._calc_gpdf(context) is None:  # what comes next may have another frame O
            return Attempt(time=now, relaxation=attempt.relaxation)
        if doubted or not np.isfinite(X_WO).all():
            return attempt.interrupted(now)
        q = self._position.Eval(context)
        X_OH = inverse_kernel(X_WO) @ tool_pose(q, self._gripper.X_FG, self._arm)
        return attempt.advanced(now, X_OH, self._offered(context), self._config.patience)

    def _target(self, context: Context) -> tuple[Array, Array]:
        state = self.state(context)
        if state.grasp is None and self._doubt(context) not in (None, StatusCode.POSE_CONTRADICTED):
            return np.full((4, 4), np.nan), np.full(6, np.nan)
        return state.target(
            context.get_time(),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._config,
        )

    def _calc_grasps(self, context: Context) -> GraspSet:
        committed = self.state(context).grasp
        if committed is not None:
            return committed
        doubt = self._doubt(context)
        return GraspSet.empty({doubt: 1}) if doubt else self._usable.Eval(context)

    def _offered(self, context: Context) -> GraspSet:
        """The grasps of perception, and those that a controller has found."""
        grasps: GraspSet = self._grasps.Eval(context)
        own: GraspSet | None = optional(self._arrival, context)
        return grasps.joined(own) if own is not None and len(own) else grasps

    def _calc_usable(self, context: Context) -> GraspSet:
        """The grasps that the hand may go for."""
        grasps = self._offered(context)
        return self._attempt.Eval(context).usable(grasps) if self._gives_up else grasps

    def _calc_gpdf(self, context: Context) -> Gpdf | None:
        committed = self.state(context).grasp is not None
        return None if committed else optional(self._gpdf, context)

    def _calc_motion(self, context: Context) -> Motion | None:
        state = self.state(context)
        if state.grasp is not None:
            return CommittedMotion(state, context.get_time(), self._config)
        return optional(self._motion, context)

    def _calc_search_target(self, context: Context) -> SearchTarget | None:
        approaching = self.state(context).phase == Phase.APPROACH
        tracking: Tracking | None = optional(self._tracking, context)
        if not (self._looks and approaching) or tracking is None:
            return None
        if tracking.expected is None or tracking.age < SEARCH_AFTER:
            return None
        return SearchTarget(tracking.expected, tracking.age)

    def _calc_gripper(self, context: Context) -> float:
        state, opening = self.state(context), self._gripper.max_opening
        if state.phase == Phase.CLOSE and np.isnan(state.pressing_since):
            travelled = self._config.closing_speed * (context.get_time() - state.since)
            opening = max(self.CLOSED, opening - travelled)
        elif state.phase >= Phase.CLOSE:
            opening = self.CLOSED
        return opening
