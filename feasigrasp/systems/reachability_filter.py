"""Filters of grasps by payload, scene and reachability."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import checked
from feasigrasp.models.choices import parse_word
from feasigrasp.models.grasps.grasp_set import FLIP, GraspSet, Rejection
from feasigrasp.models.grasps.hand_clearance import scene_clear, unobserved_clear
from feasigrasp.models.grasps.payload import rated_by_payload
from feasigrasp.models.objects.prediction import Motion, PredictionModel
from feasigrasp.models.quantities import NotNegative, Positive
from feasigrasp.models.reach.feasible_grasps import (
    Feasibility,
    JudgedGrasps,
    feasible_grasps,
    feasible_poses,
)
from feasigrasp.models.reach.interception import InterceptionOptions, Situation
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.shape.scene_field import SceneField
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    evaluate,
    optional,
)


class PayloadFilter(LeafSystem):
    """Payload filter of grasps at the object's present orientation.

    .. pydrake_system::

        name: PayloadFilter
        input_ports: [grasps, object_pose]
        output_ports: [grasps]

    ``grasps`` are in the object frame O, before and after; ``object_pose`` X_WO is a
    ``RigidTransform``; while it is not finite, the worst direction of gravity counts, and nothing
    is dropped. Scores are multiplied by the probability that a grasp carries (`rated_by_payload`);
    how sure is enough depends on what is in reach (`GripperSequencer`). What hardly
    carries is dropped and counted as "too heavy there". Grasps without
    `GraspSet.load` pass as they are.
    """

    def __init__(self) -> None:
        super().__init__()
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        declare_output(self, "grasps", self._calc, {self._grasps, self._pose})

    def _calc(self, context: Context) -> GraspSet:
        R_WO = self._pose.Eval(context).rotation().matrix()
        # Direction of gravity in W.
        down = np.array([0.0, 0.0, -1.0]) @ R_WO if np.isfinite(R_WO).all() else None
        return rated_by_payload(self._grasps.Eval(context), down)


class SceneFilter(LeafSystem):
    """Drops the grasps at which the open hand would be in the scene.

    .. pydrake_system::

        name: SceneFilter
        input_ports: [grasps, object_pose, scene]
        output_ports: [grasps]

    ``grasps`` are in the object frame O, before and after; ``object_pose`` X_WO is a
    ``RigidTransform``; ``scene`` a `SceneField` in W, or None, which drops nothing. What is dropped
    is counted as "hits the scene", as "in space that was never seen" where the hand would stand in
    what may belong to the scene, or as "the object's pose is unknown" while that is not finite.
    """

    def __init__(
        self, gripper: Gripper, *, margin: float = 0.005, either_way_round: bool = False
    ) -> None:
        """A filter for one hand, which keeps ``margin`` [m] from every surface.

        A grasp stays ``either_way_round`` if the hand is clear after half a turn about the approach
        direction; for sets whose grasps have not been turned yet.
        """
        super().__init__()
        self._gripper, self._margin, self._either = gripper, margin, either_way_round
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._scene = declare_input(self, "scene", kind=SceneField | None)
        declare_output(self, "grasps", self._calc, {self._grasps, self._pose, self._scene})

    def _calc(self, context: Context) -> GraspSet:
        grasps: GraspSet = self._grasps.Eval(context)
        scene: SceneField | None = evaluate(self._scene, context)
        if scene is None or len(grasps) == 0:
            return grasps
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        if not np.isfinite(X_WO).all():
            return grasps.select(np.zeros(len(grasps), dtype=bool), Rejection.UNKNOWN_POSE)
        tests = (scene_clear, Rejection.HITS_SCENE), (unobserved_clear, Rejection.UNOBSERVED)
        for judge, reason in tests:
            X_WG = X_WO @ grasps.X_OG
            clear = judge(scene, X_WG, self._gripper, self._margin)
            if self._either:
                other = np.flatnonzero(~clear)
                clear[other] = judge(scene, X_WG[other] @ FLIP, self._gripper, self._margin)
            grasps = grasps.select(clear, reason)
        return grasps


class ReachabilityFilter(LeafSystem):
    """The grasps of a set that the arm can intercept and follow, turned by 180 degrees included.

    .. pydrake_system::

        name: ReachabilityFilter
        input_ports: [grasps, object_pose, object_velocity, object_motion, position,
          desired_velocity]
        output_ports: [grasps, verdicts]

    Grasps are in the object frame, before and after. A grasp and its flip about the approach
    direction are one grasp but two hand poses: both are tried by default, and both may
    remain. A pose is in reach if closed-form inverse kinematics finds a configuration inside the
    joint limits, free of self-collision and clear of the table.

    The joints, at V7 ``position`` [rad] with V7 ``desired_velocity`` [rad/s], must be able to meet
    a grasp on the object's predicted path; which grasps are kept follows from when that is and from
    how long they can be followed (`feasigrasp.models.reach.interception`). Without
    ``desired_velocity`` they are taken to be at rest; without ``object_motion`` the object is
    extrapolated with its velocity. Of more than can be planned for, those are kept that
    cost least; which they are changes only for clearly better ones, since whoever follows a grasp
    has to find it again. What is dropped is counted by reason in ``rejected``; ``verdicts`` is a
    tuple of strings, see `JudgedGrasps`: what became of every grasp that came in, then of every
    flip.
    """

    @checked(ReachabilityError)
    def __init__(
        self,
        reachability: Reachability,
        *,
        options: InterceptionOptions | None = None,
        prediction: str = PredictionModel.PREDICTED,
        symmetric_grasps: bool = True,
        period: Positive = ReachabilityConfig.period,
    ) -> None:
        """A filter of `feasible_grasps`.

        Without ``symmetric_grasps`` grasps are judged as they are, not their flips. Which grasps
        were kept is remembered every ``period`` seconds.
        """
        super().__init__()
        self._reachability, self._options = reachability, options or InterceptionOptions()
        self._symmetric_grasps = symmetric_grasps
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._now = _SituationInputs(self, reachability, prediction)
        none = np.zeros(0, dtype=np.int64)
        kept = PeriodicState(self, none, period, lambda context: judged.Eval(context).grasps.id)
        self._kept_before = kept
        inputs = {self._grasps, kept, *self._now.sources}
        judged = declare_cache(self, "judged", self._calc_judged, inputs)
        declare_output(self, "grasps", lambda context: judged.Eval(context).grasps, {judged})
        declare_output(self, "verdicts", lambda context: judged.Eval(context).verdicts, {judged})

    def _calc_judged(self, context: Context) -> JudgedGrasps:
        now = self._now.situation(context)
        return feasible_grasps(
            *(self._grasps.Eval(context), now, self._reachability, self._options),
            symmetric_grasps=self._symmetric_grasps,
            kept_before=self._kept_before.Eval(context),
        )


class _SituationInputs:
    """The input ports that say where arm and object are, and what they do."""

    def __init__(self, system: LeafSystem, reachability: Reachability, prediction: str) -> None:
        parse_word(PredictionModel, prediction, "prediction", ReachabilityError)
        self._prediction = prediction
        self._pose = declare_input(system, "object_pose", RigidTransform())
        self._twist = declare_input(system, "object_velocity", SpatialVelocity.Zero())
        self._motion = declare_input(system, "object_motion", kind=Motion | None)
        n = reachability.arm.joints
        self._position = system.DeclareVectorInputPort("position", n)
        self._velocity = system.DeclareVectorInputPort("desired_velocity", n)
        ports = self._pose, self._twist, self._motion, self._position, self._velocity
        self.sources = {system.time_ticket(), *ports}

    def situation(self, context: Context) -> Situation:
        """What they hold."""
        q, v = self._position.Eval(context), optional(self._velocity, context)
        v = np.zeros_like(q) if v is None else v
        X_WO, V_WO = self._pose.Eval(context).GetAsMatrix4(), self._twist.Eval(context).get_coeffs()
        motion = optional(self._motion, context)
        return Situation(context.get_time(), q, v, X_WO, V_WO, motion, self._prediction)


class FeasiblePoses(LeafSystem):
    """Verdicts on the grasps of any sampler, by `feasible_poses`.

    .. pydrake_system::

        name: FeasiblePoses
        input_ports: [grasps, gpdf, object_pose, object_velocity, object_motion, position,
          desired_velocity]
        output_ports: [feasibility]

    Ports are those of `ReachabilityFilter`, and ``gpdf``, the object's `Gpdf`, or None, without
    which only the arm counts (optional). ``feasibility`` is a `Feasibility`, grasp by grasp as they
    came in; None while the object's pose is unknown.
    """

    @checked(ReachabilityError)
    def __init__(
        self,
        reachability: Reachability,
        *,
        options: InterceptionOptions | None = None,
        prediction: str = PredictionModel.PREDICTED,
        ahead: NotNegative = 0.5,
    ) -> None:
        """A system for one arm and hand; ``ahead`` as of `feasible_poses` [s]."""
        super().__init__()
        self._reachability, self._options, self._ahead = reachability, options, ahead
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._gpdf = declare_input(self, "gpdf", kind=Gpdf | None)
        self._now = _SituationInputs(self, reachability, prediction)
        inputs = {self._grasps, self._gpdf, *self._now.sources}
        declare_output(self, "feasibility", self._calc, inputs)

    def _calc(self, context: Context) -> Feasibility | None:
        grasps, now = self._grasps.Eval(context), self._now.situation(context)
        if not now.known:
            return None
        return feasible_poses(
            *(grasps.X_OG, now, self._reachability),
            gpdf=optional(self._gpdf, context),
            width=grasps.width,
            options=self._options,
            ahead=self._ahead,
        )
