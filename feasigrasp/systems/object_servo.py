"""Carries a free body along a motion by a spatial force, until it is let go."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.object_motion import HarmonicMotion
from feasigrasp.models.se3 import hat_kernel, so3_log_kernel


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
    any more. The body yields to contact as a mass on a spring would: force and torque are those of
    a harmonic oscillator of ``frequency`` [rad/s], plus the weight and the reference acceleration.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        body_index: BodyIndex,
        motion: HarmonicMotion,
        *,
        frequency: float = 60.0,
    ) -> None:
        """Reads the body's mass and inertia from the finalized plant."""
        super().__init__()
        body = plant.get_body(body_index)
        inertia = body.default_spatial_inertia()
        self._body_index = body_index
        self._motion = motion
        self._frequency = frequency
        self._mass = inertia.get_mass()
        self._p_BoBcm = inertia.get_com()
        self._I_BBcm = inertia.Shift(self._p_BoBcm).CalcRotationalInertia().CopyToFullMatrix3()
        self._gravity = plant.gravity_field().gravity_vector()
        self._time_step = plant.time_step()
        self._state = self.DeclareVectorInputPort("state", 13)
        self._hold = self.DeclareVectorInputPort("hold", 1)
        self.DeclareAbstractOutputPort(
            "spatial_force",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            self._calc,
        )

    def _calc(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        if self._hold.Eval(context)[0] < 0.5:
            output.set_value([])
            return
        x = self._state.Eval(context)
        R_WB = _rotation(x[:4])
        # The plant steps from t to t + dt, where the reference should be met.
        t = context.get_time() + self._time_step
        X_WR = self._motion.pose(t)
        V_WR = self._motion.velocity(t)
        w, m = self._frequency, self._mass
        p_error = X_WR[:3, 3] - x[4:7]
        v_error = V_WR[3:] - x[10:13]
        force = m * (
            w * w * p_error + 2 * w * v_error + self._motion.linear_acceleration(t) - self._gravity
        )
        angle_error = so3_log_kernel(X_WR[:3, :3] @ R_WB.T)
        I_WB = R_WB @ self._I_BBcm @ R_WB.T
        omega = x[7:10]
        torque = I_WB @ (w * w * angle_error + 2 * w * (V_WR[:3] - omega)) + hat_kernel(omega) @ (I_WB @ omega)
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = self._body_index
        applied.p_BoBq_B = self._p_BoBcm
        applied.F_Bq_W = SpatialForce(tau=torque, f=force)
        output.set_value([applied])


def _rotation(wxyz: np.ndarray) -> np.ndarray:
    w, x, y, z = wxyz / np.linalg.norm(wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
