"""Forces on a free body: of a carrier that moves it until it lets go, and of a suction cup."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.faults.object import ObjectPulled
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.payload import needed_vacuum
from feasigrasp.models.grasps.suction import mesh_heights, seals
from feasigrasp.models.objects.motion import HarmonicMotion, ObjectMotion
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.objects.spring_drive import (
    CarrierHold,
    Release,
    Spring,
    body_pose_kernel,
    carried_body,
    motion_wrench_kernel,
    spring_wrench_kernel,
)
from feasigrasp.models.robot.gripper import SuctionCup
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output, weakly


class ObjectServo(LeafSystem):
    """A damped spatial spring between a free body and its reference motion, and its release.

    .. pydrake_system::

        name: ObjectServo
        input_ports: [state, hold]
        output_ports: [spatial_force, let_go]

    ``state`` is the body's V13 state in the plant (quaternion wxyz, position, angular velocity,
    velocity); ``hold`` is 1 until the command to let go, and 0 from then on. ``let_go`` is V1, the
    time at which the carrier did so [s], infinite before: then no force acts any more but that of a
    fault. The body yields to contact as a mass on a spring would: force and torque are those of the
    carrier's spring, no larger than it can, plus the weight and the reference acceleration.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        body_index: BodyIndex,
        motion: ObjectMotion,
        carrier: CarrierHold,
        *,
        pulls: Sequence[ObjectPulled] = (),
    ) -> None:
        """Carries a body of the finalized plant, with its mass and inertia there, along a motion.

        The body's origin is its centre of mass. The ``pulls`` pull at it once it is let go.
        """
        super().__init__()
        body = plant.get_body(body_index)
        inertia = body.default_spatial_inertia()
        if np.linalg.norm(inertia.get_com()) > 1e-9:
            raise ValueError(f"the origin of body {body.name()} must be its centre of mass")
        self._body_index = body_index
        self._motion, self._pulls, self._carrier = motion, pulls, carrier
        I_BBcm = inertia.CalcRotationalInertia().CopyToFullMatrix3()
        gravity, step = plant.gravity_field().gravity_vector(), plant.time_step()
        self._load = carried_body(inertia.get_mass(), I_BBcm, gravity, carrier.spring, step)
        self._state = self.DeclareVectorInputPort("state", 13)
        self._hold = self.DeclareVectorInputPort("hold", 1)
        release = self.DeclareDiscreteState([np.inf, np.inf])  # when it lets go; light since
        self.DeclareInitializationDiscreteUpdateEvent(weakly(self._release))
        self.DeclarePeriodicDiscreteUpdateEvent(step, 0.0, weakly(self._release))
        declare_output(self, "spatial_force", self._calc, model=[ExternallyAppliedSpatialForce()])
        declare_output(self, "let_go", _let_go, {self.discrete_state_ticket(release)}, size=1)

    def _release(self, context: Context, discrete) -> EventStatus:
        # A carrier that feels the load lets go once it has borne less than this share of the weight
        # for this time [s]: half of it says that the other one bears more, and bumps are shorter.
        # Source: guessed.
        load_share, load_time = 0.5, 0.1
        let_go, light_since = context.get_discrete_state_vector().value()
        if np.isfinite(let_go) or self._hold.Eval(context)[0] > 0.5:
            return EventStatus.DidNothing()
        time = context.get_time()
        if self._carrier.release is Release.LATE:
            let_go = time + self._carrier.delay
        else:
            weight = self._load.mass * self._load.gravity
            borne = -float(self._wrench(context)[3:] @ weight) / max(float(weight @ weight), 1e-12)
            light_since = min(light_since, time) if borne < load_share else np.inf
            let_go = time if time - light_since >= load_time else np.inf
        discrete.set_value([let_go, light_since])
        return EventStatus.Succeeded()

    def _calc(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        time = context.get_time()
        if time < _let_go(context):
            return force_on(self._body_index, self._wrench(context))
        speed = float(np.linalg.norm(self._state.Eval(context)[-3:]))
        pulling = [pull.force for pull in self._pulls if pull.pulls(time, speed)]
        wrenches = [np.concatenate([np.zeros(3), force]) for force in pulling]
        return [force for each in wrenches for force in force_on(self._body_index, each)]

    def _wrench(self, context: Context) -> Array:
        # State and reference of the same instant: one a step later would make the body lead.
        state, time, wrench = self._state.Eval(context), context.get_time(), np.empty(6)
        if isinstance(self._motion, HarmonicMotion):
            motion_wrench_kernel(state, self._motion.parameters, time, self._load, wrench)
        else:
            spring_wrench_kernel(state, *self._motion.state(time), self._load, wrench)
        return wrench


def _let_go(context: Context) -> float:
    return float(context.get_discrete_state_vector().value()[0])


def force_on(body_index: BodyIndex, wrench: Array) -> list[ExternallyAppliedSpatialForce]:
    """External force input of a plant for a wrench [torque; force] (6,) on one body, in W."""
    applied = ExternallyAppliedSpatialForce()
    applied.body_index = body_index
    applied.F_Bq_W = SpatialForce(F=wrench)
    return [applied]


@dataclass(frozen=True, eq=False)
class _Seal(Frozen):
    """Pose of the object in the cup since the lip closed, or that it has opened again."""

    X_GO: Array | None = None
    broken: bool = False


class SuctionSeal(LeafSystem):
    """Vacuum of a cup, and the wrench by which it holds the object.

    .. pydrake_system::

        name: SuctionSeal
        input_ports: [opening, object_state, body_poses, body_velocities, carried]
        output_ports: [state, spatial_force]

    ``opening`` V1 is negative while the vacuum is on [m]. Then the lip closes if it lies on the
    object's true surface as `seals` demands, and from there a damped spatial spring, as stiff as
    the time step allows, holds the object where it is in the cup. Its wrench on the object acts on
    the hand as well. A wrench that needs more vacuum than the cup has (`needed_vacuum`) opens the
    lip, for as long as the vacuum stays on. ``state`` V2 is the share of the vacuum, 1 or 0, and
    its rate, 0. ``carried`` and ``spatial_force`` are lists of external forces on the plant, the
    latter with those of the seal; ``object_state`` is V13, and bodies are as the plant has them.
    """

    def __init__(self, plant: MultibodyPlant, cup: SuctionCup, obj: RigidObject) -> None:
        super().__init__()
        instances = (plant.GetModelInstanceByName(name) for name in ("gripper", "object"))
        self._cup, self._object = cup, obj
        self._hand, self._body = (plant.GetBodyIndices(each)[0] for each in instances)
        step, inertia = plant.time_step(), plant.get_body(self._body).default_spatial_inertia()
        I_BBcm = inertia.CalcRotationalInertia().CopyToFullMatrix3()
        rigid = Spring(10_000.0, 100.0, np.inf, np.inf)
        gravity = plant.gravity_field().gravity_vector()
        # As stiff as explicit steps allow beside a carrier whose spring is as stiff as they do.
        self._load = carried_body(inertia.get_mass(), I_BBcm, gravity, rigid, 4.5 * step)
        self._opening = self.DeclareVectorInputPort("opening", 1)
        self._state = self.DeclareVectorInputPort("object_state", 13)
        self._poses = declare_input(self, "body_poses", [RigidTransform()])
        self._twists = declare_input(self, "body_velocities", [SpatialVelocity.Zero()])
        self._carried = declare_input(self, "carried", [ExternallyAppliedSpatialForce()])
        self._seal = PeriodicState(self, _Seal(), step, self._advance)
        declare_output(self, "state", self._calc_state, {self._seal}, size=2)
        model = [ExternallyAppliedSpatialForce()]
        declare_output(self, "spatial_force", self._calc, model=model)

    def _cup_pose(self, context: Context) -> Array:
        X_WF: Array = self._poses.Eval(context)[self._hand].GetAsMatrix4()
        return X_WF @ self._cup.X_FG

    def _advance(self, context: Context) -> _Seal:
        seal: _Seal = self._seal.Eval(context)
        if self._opening.Eval(context)[0] >= 0.0:
            return seal if seal.X_GO is None and not seal.broken else _Seal()
        if seal.broken:
            return seal
        X_WG, X_WO = self._cup_pose(context), body_pose_kernel(self._state.Eval(context))
        if seal.X_GO is None:
            X_OG, obj = se3.inverse(X_WO) @ X_WG, self._object
            heights = mesh_heights(obj.vertices, obj.faces, X_OG, self._cup)
            return _Seal(se3.inverse(X_OG)) if seals(heights[None], self._cup)[0] else seal
        wrench, R_GW = self._wrench(context, seal.X_GO), X_WG[:3, :3].T
        arm = X_WO[:3, 3] - X_WG[:3, 3]
        moment = wrench[:3] + np.cross(arm, wrench[3:])
        need = needed_vacuum(-R_GW @ wrench[3:], -R_GW @ moment, self._cup)
        return _Seal(broken=True) if need > self._cup.vacuum_force else seal

    def _wrench(self, context: Context, X_GO: Array) -> Array:
        """Torque and force of the cup on the object, at its center of mass in W, shape (6,)."""
        X_WR = self._cup_pose(context) @ X_GO
        twist = self._twists.Eval(context)[self._hand]
        arm = X_WR[:3, 3] - self._poses.Eval(context)[self._hand].translation()
        V_WR, wrench = twist.Shift(arm).get_coeffs(), np.empty(6)
        state = self._state.Eval(context)
        spring_wrench_kernel(state, X_WR, V_WR, np.zeros(3), self._load, wrench)
        return wrench

    def _calc_state(self, context: Context) -> list[float]:
        return [float(self._seal.Eval(context).X_GO is not None), 0.0]

    def _calc(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        forces, X_GO = list(self._carried.Eval(context)), self._seal.Eval(context).X_GO
        if X_GO is None:
            return forces
        wrench = self._wrench(context, X_GO)
        X_FW = self._poses.Eval(context)[self._hand].inverse()
        (on_hand,) = force_on(self._hand, -wrench)
        on_hand.p_BoBq_B = X_FW @ self._state.Eval(context)[4:7]
        return [*forces, *force_on(self._body, wrench), on_hand]
