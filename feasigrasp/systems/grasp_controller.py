"""Base system of grasp controllers: ports, rates, state, safety filter; and its inputs."""

from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, DependencyTicket, InputPort, LeafSystem

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.planning.clearance_schedule import obstacle_surface
from feasigrasp.models.control.planning.in_view import velocity_in_view
from feasigrasp.models.control.planning.search_pose import (
    SearchTarget,
    search_configuration,
    search_velocity,
)
from feasigrasp.models.control.planning.static_grid import nearest_of
from feasigrasp.models.control.planning.touch import yielding_velocity
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import MovingObject, ObstacleGrid
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.objects.pose_filter import empty_state
from feasigrasp.models.objects.prediction import Motion, MotionEstimate
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.quantities import JACOBIAN, JOINT_RATES, TWIST, NotNegative, Positive
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import pose_and_jacobian, tool_pose, tool_pose_and_jacobian
from feasigrasp.models.shape.gpdf import Gpdf, fit_gpdf
from feasigrasp.models.shape.grids import object_grid, obstacle_grid
from feasigrasp.models.shape.scene_field import SceneField, fit_scene
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.ports import (
    Cached,
    ObjectState,
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    evaluate,
    optional,
    weakly,
)


class ControllerInputs:
    """The inputs of a `GraspController` at one instant: what `update` and `velocity` are given.

    Every property reads its port when it is asked for: at control rate a port without use
    costs as much as the law itself.
    """

    __slots__ = ("_context", "_controller")

    def __init__(self, controller: Any, context: Context) -> None:
        self._controller, self._context = controller, context

    @property
    def time(self) -> float:
        """Now [s]."""
        return float(self._context.get_time())

    @property
    def q(self) -> Array:
        """Joint positions [rad], shape (7,)."""
        return self._controller._position.Eval(self._context)

    @property
    def grasps(self) -> GraspSet:
        """Reachable grasps in the object frame."""
        return self._controller._grasps.Eval(self._context)

    @property
    def X_WO(self) -> Array:
        """Object pose, shape (4, 4) [m]; not finite while it is unknown."""
        return self._controller._pose.Eval(self._context).GetAsMatrix4()

    @property
    def V_WO(self) -> Array:
        """Object twist [angular; linear], shape (6,)."""
        return self._controller._twist.Eval(self._context).get_coeffs()

    @property
    def motion(self) -> Motion | None:
        """Predicts the object's poses; without it they follow its twist."""
        return optional(self._controller._motion, self._context)

    @property
    def committed(self) -> bool:
        """Whether the hand is closing, or has closed, on the one grasp there is."""
        phase: Array | None = optional(self._controller._phase, self._context)
        return phase is not None and phase[0] > Phase.APPROACH

    @property
    def gpdf(self) -> Gpdf | None:
        """The object's distance field, in its frame; None while there is none."""
        return optional(self._controller._gpdf, self._context)

    @property
    def qd_last(self) -> Array | None:
        """The last command as the drive carried it out [rad/s], shape (7,)."""
        return optional(self._controller._last, self._context)

    @property
    def touch(self) -> Array:
        """Torques of a contact that the arm gives way to [Nm], shape (7,); zero without one."""
        touch: Array | None = optional(self._controller._touch, self._context)
        return np.zeros(self._controller.reachability.arm.joints) if touch is None else touch

    @property
    def X_WC(self) -> Array | None:
        """Pose of the camera on the hand, shape (4, 4) [m]; None without one."""
        X_WC: RigidTransform | None = optional(self._controller._camera_pose, self._context)
        return None if X_WC is None else X_WC.GetAsMatrix4()

    @property
    def search_target(self) -> SearchTarget | None:
        """The search target; None while the object is in sight."""
        return optional(self._controller._search_target, self._context)

    @property
    def seen_by_arm(self) -> bool:
        """Whether the object is tracked with the camera on the hand."""
        tracking: Tracking | None = optional(self._controller._tracking, self._context)
        return self.X_WC is not None and tracking is not None and tracking.expected is not None

    @property
    def obstacles(self) -> ObstacleGrid | None:
        """Distances to scene and static obstacles, which the arm keeps clear of.

        None where there are none.
        """
        return evaluate(self._controller._obstacles, self._context)

    @property
    def surface(self) -> ObstacleGrid | None:
        """Distances to the object's surface, in its frame; None while there is no field.

        Without unobserved surface, if the grasp that the hand is nearly at is in there.
        """
        return evaluate(self._controller._surface, self._context)


class GraspController(LeafSystem):
    """Joint velocities that bring the hand to a grasp of a moving object; derive from it.

    .. pydrake_system::

        name: GraspController
        input_ports: [position, grasps, object_pose, object_velocity, desired_velocity, scene,
          static_obstacles, object_motion, phase, gpdf, touch, camera_pose, search_target, tracking,
          plan]
        output_ports: [commanded_velocity, chosen_grasp]

    ``position`` and ``commanded_velocity`` are V7 [rad], [rad/s]; ``grasps`` is a `GraspSet` in the
    object frame, reachable ones. Optional are ``desired_velocity``, the last command as the drive
    carried it out, without which accelerations are not limited; ``scene``, a `SceneField` or None,
    which the arm keeps clear of; ``static_obstacles``, an `ObstacleGrid` of what is there from the
    start, likewise; ``object_motion``, a `Motion` that predicts, without which the object's twist
    is taken for constant; ``phase``, a `Phase` of `GripperSequencer`, by which a hand that has
    committed to its grasp keeps to it; ``gpdf``, the object's `Gpdf` or None, whose surface the
    open hand keeps off; and ``touch``, V7 torques of a contact [Nm], zero without one, to which the
    arm gives way, whatever `velocity` says. With ``camera_pose``, X_WC of a camera on the hand,
    which the object is tracked with (``tracking``, a `Tracking`), the arm keeps the object in its
    image, as long as there is a ``gpdf``; while there is a ``search_target``, a `SearchTarget` or
    None, it looks for that instead.

    ``chosen_grasp`` is V16, the grasp that the hand goes for as a matrix X_OG, row by row, and NaN
    where it goes for no one grasp; see `chosen`.

    Where ``plan`` is connected, it is the memory, and `update` is left to its source, such as
    a controller of the same kind in another process.

    A controller of your own is two functions: `update`, called every ``period`` seconds, returns
    what to remember of the grasps, and `velocity` the command, at whatever rate it is asked for.
    Both are given what the ports hold; neither may keep anything in ``self``, since what is to
    last is the memory. For example, towards the first grasp by resolved rates::

        class FirstGrasp(GraspController):
            def update(self, memory, inputs):
                return inputs.grasps.X_OG[:1]

            def velocity(self, memory, inputs):
                if memory is None or len(memory) == 0:
                    return self.enforced(np.zeros(7), inputs)
                X_WH, J = pose_and_jacobian(inputs.q, self.reachability.gripper.X_FG)
                X_WT = inputs.X_WO @ memory[0]
                turn = se3.so3_log(X_WT[:3, :3] @ X_WH[:3, :3].T)
                V = 2.0 * np.concatenate([turn, X_WT[:3, 3] - X_WH[:3, 3]])
                return self.enforced(np.linalg.pinv(J, rcond=0.02) @ V, inputs)

        make_dynamic_grasp(scenario, controller=FirstGrasp(Reachability()))

    One that finds grasps of its own on the way has an output port ``arrival`` for them, a
    `GraspSet`: fingers close at these as well.

    Attributes:
        reachability: What the arm can reach, and its gripper.
        period: Time between updates [s].
    """

    @checked(ControlError)
    def __init__(
        self,
        reachability: Reachability,
        memory: Any = None,
        *,
        safety: SafetyOptions | None = None,
        period: Positive = ReachabilityConfig.period,
    ) -> None:
        """A controller that has not seen any grasps.

        Args:
            reachability: What the arm can reach, and its gripper.
            memory: What is remembered before the first update; best a `Frozen` value, since others
                are copied with every context.
            safety: Margins of the QP.
            period: Time between updates [s]; that of the grasps.

        Raises:
            ControlError: The period is not positive.
        """
        super().__init__()
        self.reachability = reachability
        self.period = period
        self._safety_options = safety or SafetyOptions.of(reachability.arm)
        n = reachability.arm.joints
        self._position = self.DeclareVectorInputPort("position", n)
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._twist = declare_input(self, "object_velocity", SpatialVelocity())
        self._last = self.DeclareVectorInputPort("desired_velocity", n)
        scene = declare_input(self, "scene", kind=SceneField | None)
        static = declare_input(self, "static_obstacles", kind=ObstacleGrid)
        self._motion = declare_input(self, "object_motion", kind=Motion | None)
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self._gpdf = declare_input(self, "gpdf", kind=Gpdf | None)
        self._touch = self.DeclareVectorInputPort("touch", n)
        self._camera_pose = declare_input(self, "camera_pose", RigidTransform())
        self._search_target = declare_input(self, "search_target", kind=SearchTarget | None)
        self._tracking = declare_input(self, "tracking", kind=Tracking | None)
        self._plan = declare_input(self, "plan")
        seen = self._declare_grid("scene", scene, obstacle_grid)

        def obstacles(context: Context) -> ObstacleGrid | None:
            return nearest_of(optional(static, context), evaluate(seen, context))

        self._obstacles = declare_cache(self, "obstacles", obstacles, {static, seen})
        self._whole = self._declare_grid("surface of the object", self._gpdf, object_grid)
        self._open_hand = reachability.gripper.surface_points(reachability.gripper.max_opening)
        name, of = "surface that the hand keeps off", (self._position, self._grasps, self._pose)
        self._surface = declare_cache(self, name, self._calc_surface, {self._whole, *of})
        self._memory = PeriodicState(self, memory, period, self._updated)
        self._in_effect = ObjectState(self, memory)
        self._acting: ObjectState = self._memory
        self._search_pose = PeriodicState(self, None, ReachabilityConfig.period, self._search)
        self.DeclareVectorOutputPort("commanded_velocity", n, weakly(self._calc))
        declare_output(self, "chosen_grasp", self._calc_chosen, self.memory_tickets, size=16)

    @cached_property
    def safety(self) -> SafetyFilter:
        """The QP that keeps limits and clearances."""
        return SafetyFilter(self._safety_options, self.reachability.gripper)

    def update(self, memory: Any, inputs: ControllerInputs) -> Any:
        """The next memory.

        Args:
            memory: What was remembered until now; at first what the constructor was given.
            inputs: What is known now.
        """
        raise NotImplementedError

    def velocity(self, memory: Any, inputs: ControllerInputs) -> Array:
        """The commanded joint velocity [rad/s], shape (7,).

        Args:
            memory: What the last `update` returned.
            inputs: What is known now.
        """
        raise NotImplementedError

    def chosen(self, memory: Any) -> Array | None:
        """The grasp X_OG (4, 4) [m] that the hand goes for, for logs; None for no one grasp.

        Args:
            memory: What the last `update` returned.
        """
        return None

    @checked(ControlError)
    def take_time(self, planning_time: NotNegative) -> None:
        """Lets what `update` returns take effect so much later [s]; the safety filter never waits.

        To be called once, before the controller is part of a diagram.

        Raises:
            ControlError: It is not less than the time between updates.
        """
        if not planning_time < self.period:
            raise ControlError(
                f"control.planning_time is {planning_time:g} s; give less than {self.period:g} s, "
                "the time between its updates"
            )
        if planning_time > 0.0:
            self._acting = self._in_effect
            self._acting.every(self, self.period, planning_time, self._memory.Eval)

    @checked(ControlError)
    def memory(self, context: Context) -> Any:
        """The result of the last `update` in effect, here or at the source of ``plan``."""
        planned = optional(self._plan, context)
        return self._acting.Eval(context) if planned is None else planned

    @property
    def memory_tickets(self) -> set[DependencyTicket]:
        """Dependency tickets of outputs that depend on the memory."""
        return {self._memory.ticket(), self._in_effect.ticket(), self._plan.ticket()}

    @checked(ControlError)
    def enforced(
        self,
        qd: Annotated[Array, JOINT_RATES],
        inputs: ControllerInputs,
        J: Annotated[Array, JACOBIAN] | None = None,
        V: Annotated[Array, TWIST] | None = None,
    ) -> Array:
        """The velocity nearest to ``qd`` (7,) that keeps limits and clearances.

        With a Jacobian J (6, 7) and a twist V (6,) of the hand, that is the one nearest to V, and
        ``qd`` only fills the redundant directions. An object that is looked for is kept off where
        it is expected.
        """
        return self.safety.velocity(
            inputs.q,
            qd,
            J,
            V,
            qd_last=inputs.qd_last,
            obstacles=inputs.obstacles,
            moving=self._kept_off(inputs),
        )

    @checked(ControlError)
    def in_view(self, qd: Annotated[Array, JOINT_RATES], inputs: ControllerInputs) -> Array:
        """The velocity nearest to ``qd`` (7,) that also keeps the object in the camera's image.

        It is ``qd`` itself unless the object is tracked with a camera on the hand, and while it is
        not known where the object is.
        """
        if len(qd) != self.reachability.arm.joints:
            raise ControlError(f"in_view: qd has {len(qd)} entries, not one per joint of the arm")
        X_WC = inputs.X_WC if inputs.seen_by_arm else None
        gpdf = None if X_WC is None else inputs.gpdf
        if X_WC is None or gpdf is None:
            return qd
        X_WO, V_WO = inputs.X_WO, inputs.V_WO
        if not np.isfinite(X_WO.sum() + V_WO.sum()):
            return qd
        lever = X_WO[:3, :3] @ gpdf.bounds.mean(axis=0)
        v_W = V_WO[3:] + np.cross(V_WO[:3], lever)
        radius = 0.5 * float(np.linalg.norm(gpdf.bounds[1] - gpdf.bounds[0]))
        X_FG, p_W = self.reachability.gripper.X_FG, X_WO[:3, 3] + lever
        kept = velocity_in_view(qd, inputs.q, X_FG, X_WC, p_W, v_W, radius, self.reachability.arm)
        return qd if np.array_equal(kept, qd) else self.enforced(kept, inputs)

    def warm_up(self) -> None:
        """Follows a made-up grasp for a while, so that no kernel is compiled inside a control tick.

        For the end of a constructor; nothing is remembered.
        """
        # Time between the commands of the warm-up: long, to be there soon [s]. Source: guessed.
        warm_up_step = 0.04
        context = self.CreateDefaultContext()
        arm = self.reachability.arm
        q = np.array(arm.home)
        X_WO = RigidTransform([0.5, 0.0, 0.5])
        # As a retreat asks for them.
        X_WH, _ = pose_and_jacobian(q, self.reachability.gripper.X_FG, arm)
        X_OG = X_WO.inverse().GetAsMatrix4() @ X_WH
        grasps = GraspSet(X_OG[None], np.zeros(1), np.ones(1))
        ball = sphere_points(64, 0.03)
        bowl = ball[ball[:, 2] < 0.005]  # with surface that was not seen
        tracking = Tracking(TrackingState.TRACKING, 0.0, expected=X_WO.GetAsMatrix4())
        for name, value in {
            "object_pose": X_WO,
            "object_velocity": SpatialVelocity.Zero(),
            "object_motion": Value[object](MotionEstimate(empty_state(), 0.0)),
            "scene": Value[object](fit_scene(ball + [0.5, 0.3, 0.3], [0.0, 0.0, 1.0])),
            "gpdf": Value[object](fit_gpdf(bowl)),
            "camera_pose": RigidTransform([0.3, 0.0, 0.5]),
            "search_target": Value[object](SearchTarget(X_WO.GetAsMatrix4(), 0.0)),
            "tracking": Value[object](tracking),
        }.items():
            self.GetInputPort(name).FixValue(context, value)
        memory, some = self.memory(context), grasps
        for tick in range(12):
            context.SetTime(warm_up_step * tick)
            self.GetInputPort("position").FixValue(context, q)
            self.GetInputPort("grasps").FixValue(context, AbstractValue.Make(some))
            if tick % 4 == 0:
                memory = self.update(memory, ControllerInputs(self, context))
                some = grasps.with_symmetric()
                self._search(context)
            qd = self.velocity(memory, ControllerInputs(self, context))
            q = q + warm_up_step * self.in_view(qd, ControllerInputs(self, context))

    def _declare_grid(
        self, name: str, port: InputPort, make_grid: Callable[[Any], ObstacleGrid]
    ) -> Cached:
        """A grid of the field at an optional port, made anew when that changes; None if None."""

        def calc(context: Context) -> ObstacleGrid | None:
            field = optional(port, context)
            return None if field is None else make_grid(field)

        return declare_cache(self, name, calc, {port})

    def _calc_surface(self, context: Context) -> ObstacleGrid | None:
        """The object's surface with clearance, see `obstacle_surface`."""
        grid: ObstacleGrid | None = evaluate(self._whole, context)
        if grid is None or grid.seen is None:
            return grid
        inputs, reach = ControllerInputs(self, context), self.reachability
        X_OH = se3.inverse(inputs.X_WO) @ tool_pose(inputs.q, reach.gripper.X_FG, reach.arm)
        return obstacle_surface(grid, X_OH, inputs.grasps.X_OG, self._open_hand)

    def _kept_off(self, inputs: ControllerInputs) -> MovingObject | None:
        """The object that the hand keeps off, where it is expected if it is looked for."""
        if inputs.surface is None:
            return None
        if inputs.search_target is not None:  # taken to be at rest
            return MovingObject(inputs.surface, inputs.search_target.X_WO, np.zeros(6))
        return MovingObject(inputs.surface, inputs.X_WO, inputs.V_WO)

    def _updated(self, context: Context) -> Any:
        if self._plan.HasValue(context):
            return self.memory(context)
        return self.update(self._memory.Eval(context), ControllerInputs(self, context))

    def _search(self, context: Context) -> Array | None:
        """The configuration from which the arm looks for the object; None if it does not."""
        inputs = ControllerInputs(self, context)
        search_target, X_WC = inputs.search_target, inputs.X_WC
        if search_target is None or X_WC is None:
            return None
        return search_configuration(search_target, inputs.q, X_WC, self.reachability)

    def _calc(self, context: Context, output) -> None:
        inputs, arm = ControllerInputs(self, context), self.reachability.arm
        q_search = self._search_pose.Eval(context) if inputs.search_target else None
        if q_search is not None:
            qd = search_velocity(inputs.q, q_search, self._safety_options.speed, arm)
            qd = self.enforced(qd, inputs)
        else:
            qd = self.in_view(self.velocity(self.memory(context), inputs), inputs)
        if inputs.touch.any():
            J_WH = tool_pose_and_jacobian(inputs.q, self.reachability.gripper.X_FG, arm)[1]
            qd = self.enforced(yielding_velocity(qd, inputs.touch, J_WH), inputs)
        output.SetFromVector(qd)

    def _calc_chosen(self, context: Context) -> Array:
        X_OG = self.chosen(self.memory(context))
        return np.full(16, np.nan) if X_OG is None else X_OG
