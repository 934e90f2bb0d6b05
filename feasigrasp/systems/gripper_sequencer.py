"""Closes the gripper on the object, lets the object go, lifts and shakes it."""

from __future__ import annotations

from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import GraspSequenceConfig, GraspState, Phase
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output


class GripperSequencer(LeafSystem):
    """Decides when to close, and what the arm follows from then on.

    .. pydrake_system::

        name: GripperSequencer
        input_ports:
        - position
        - grasps
        - object_pose
        - object_velocity
        - gripper_state
        - gpdf
        output_ports:
        - grasps
        - gpdf
        - object_pose
        - object_velocity
        - gripper_position
        - object_hold
        - phase

    It stands between the reachability filter and a controller, and passes grasps, object pose and
    twist through while the hand approaches, and the object's field, a `Gpdf` or None, if it is
    connected. Once the hand has been at a grasp for a moment, only that grasp is passed on, with
    the pose extrapolated from then, and the fingers close; from then on there is no field, since
    the object is there to be touched. After it is let go, pose and twist are those of a lift and of
    shaking.

    ``gripper_position`` is the commanded distance between the pads [m], ``gripper_state`` the
    measured one and its rate, ``object_hold`` 1 until the object is let go, ``phase`` a `Phase`.
    The state advances every ``period`` seconds, the rate at which grasps arrive.
    """

    #: Commanded distance between closed pads; negative, so that they squeeze whatever is between.
    CLOSED = -0.05

    def __init__(
        self,
        config: GraspSequenceConfig,
        gripper: ParallelGripper,
        *,
        period: float = ReachabilityConfig.period,
    ) -> None:
        """A sequencer for one gripper."""
        super().__init__()
        self._config = config
        self._gripper = gripper
        self._position = self.DeclareVectorInputPort("position", IIWA_7.joints)
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._velocity = declare_input(self, "object_velocity", SpatialVelocity.Zero())
        self._gripper_state = self.DeclareVectorInputPort("gripper_state", 2)
        self._gpdf = declare_input(self, "gpdf")
        self._state = PeriodicState(self, GraspState(), period, self._advance)

        state, time = self._state.ticket(), self.time_ticket()
        target = {state, time, self._pose.ticket(), self._velocity.ticket()}
        declare_output(self, "grasps", self._calc_grasps, {state, self._grasps.ticket()})
        declare_output(self, "gpdf", self._calc_gpdf, {state, self._gpdf.ticket()})
        declare_output(self, "object_pose", self._calc_pose, target, model=RigidTransform())
        declare_output(
            self, "object_velocity", self._calc_velocity, target, model=SpatialVelocity.Zero()
        )
        self.DeclareVectorOutputPort("gripper_position", 1, self._calc_gripper, {state, time})
        self.DeclareVectorOutputPort("object_hold", 1, self._calc_hold, {state})
        self.DeclareVectorOutputPort("phase", 1, self._calc_phase, {state})

    def state(self, context: Context) -> GraspState:
        """Where the sequence is."""
        state: GraspState = self._state.Eval(context)
        return state

    def _advance(self, context: Context) -> GraspState:
        return self.state(context).advanced(
            context.get_time(),
            forward_kinematics(self._position.Eval(context), self._gripper.X_FG),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._grasps.Eval(context),
            self._gripper_state.Eval(context)[0],
            self._config,
        )

    def _target(self, context: Context) -> tuple[Array, Array]:
        return self.state(context).target(
            context.get_time(),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._config,
        )

    def _calc_grasps(self, context: Context) -> GraspSet:
        committed = self.state(context).grasp
        return self._grasps.Eval(context) if committed is None else committed

    def _calc_gpdf(self, context: Context) -> Gpdf | None:
        passed = self.state(context).grasp is None and self._gpdf.HasValue(context)
        return self._gpdf.Eval(context) if passed else None

    def _calc_pose(self, context: Context) -> RigidTransform:
        return RigidTransform(self._target(context)[0])

    def _calc_velocity(self, context: Context) -> SpatialVelocity:
        return SpatialVelocity(self._target(context)[1])

    def _calc_gripper(self, context: Context, output) -> None:
        state = self.state(context)
        opening = self._gripper.max_opening
        if state.phase == Phase.CLOSE:
            travelled = self._config.closing_speed * (context.get_time() - state.since)
            opening = max(self.CLOSED, opening - travelled)
        elif state.phase > Phase.CLOSE:
            opening = self.CLOSED
        output.SetAtIndex(0, opening)

    def _calc_hold(self, context: Context, output) -> None:
        output.SetAtIndex(0, float(not self.state(context).released))

    def _calc_phase(self, context: Context, output) -> None:
        output.SetAtIndex(0, float(self.state(context).phase))
