"""Moves a free body along a motion by a spatial force, until its carrier lets it go."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.faults.object import ObjectPulled
from feasigrasp.models.objects.motion import HarmonicMotion, ObjectMotion
from feasigrasp.models.objects.spring_drive import (
    CarrierHold,
    Release,
    carried_body,
    motion_wrench_kernel,
    spring_wrench_kernel,
)
from feasigrasp.systems.ports import declare_output, weakly


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
