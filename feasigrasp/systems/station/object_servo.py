"""Moves a free body along a motion by a spatial force, until its release."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.faults.object import ObjectPulled
from feasigrasp.models.objects.motion import HarmonicMotion, ObjectMotion
from feasigrasp.models.objects.spring_drive import (
    DrivenBody,
    motion_wrench_kernel,
    spring_wrench_kernel,
)
from feasigrasp.systems.ports import declare_output


class ObjectServo(LeafSystem):
    """A critically damped spatial spring between a free body and its reference motion.

    .. pydrake_system::

        name: ObjectServo
        input_ports:
        - state
        - hold
        output_ports:
        - spatial_force

    ``state`` is the body's V13 state in the plant (quaternion wxyz, position, angular velocity,
    velocity); ``hold`` is 1 while the body is carried and 0 once it is let go, when no force acts
    any more but that of a fault. The body yields to contact as a mass on a spring would: force and
    torque are those of a harmonic oscillator of ``frequency`` [rad/s], no larger than a hand would
    push, plus the weight and the reference acceleration.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        body_index: BodyIndex,
        motion: ObjectMotion,
        *,
        pulls: Sequence[ObjectPulled] = (),
        frequency: float = 60.0,
        max_force: float = 30.0,
        max_torque: float = 3.0,
    ) -> None:
        """Reads the body's mass and inertia from the finalized plant.

        Args:
            plant: The finalized plant.
            body_index: The body to carry; its origin is its centre of mass.
            motion: Where it should be.
            pulls: What pulls at it once it is let go.
            frequency: Stiffness of the spring [rad/s].
            max_force: What carries the body gives way beyond this force [N].
            max_torque: The same for the torque [Nm].
        """
        super().__init__()
        body = plant.get_body(body_index)
        inertia = body.default_spatial_inertia()
        if np.linalg.norm(inertia.get_com()) > 1e-9:
            raise ValueError(f"the origin of body {body.name()} must be its centre of mass")
        self._body_index = body_index
        self._motion, self._pulls = motion, pulls
        self._load = DrivenBody(
            inertia.get_mass(),
            inertia.CalcRotationalInertia().CopyToFullMatrix3(),
            plant.gravity_field().gravity_vector(),
            frequency,
            max_force,
            max_torque,
        )
        self._state = self.DeclareVectorInputPort("state", 13)
        self._hold = self.DeclareVectorInputPort("hold", 1)
        declare_output(self, "spatial_force", self._calc, model=[ExternallyAppliedSpatialForce()])

    def _calc(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        time = context.get_time()
        if self._hold.Eval(context)[0] < 0.5:
            speed = float(np.linalg.norm(self._state.Eval(context)[-3:]))
            pulling = [pull.force for pull in self._pulls if pull.pulls(time, speed)]
            wrenches = [np.concatenate([np.zeros(3), force]) for force in pulling]
            return [
                applied for wrench in wrenches for applied in force_on(self._body_index, wrench)
            ]
        # State and reference of the same instant: one a step later would make the body lead.
        state, wrench = self._state.Eval(context), np.empty(6)
        if isinstance(self._motion, HarmonicMotion):
            motion_wrench_kernel(state, self._motion.parameters, time, self._load, wrench)
        else:
            spring_wrench_kernel(state, *self._motion.state(time), self._load, wrench)
        return force_on(self._body_index, wrench)


def force_on(body_index: BodyIndex, wrench: Array) -> list[ExternallyAppliedSpatialForce]:
    """External force input of a plant for a wrench [torque; force] (6,) on one body, in W."""
    applied = ExternallyAppliedSpatialForce()
    applied.body_index = body_index
    applied.F_Bq_W = SpatialForce(F=wrench)
    return [applied]
