"""Fault injection into the measured object pose."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.faults.pose import PoseFault
from feasigrasp.systems.ports import declare_input, declare_output, weakly


class FaultyPose(LeafSystem):
    """Passes a measured pose on, but for a fault.

    .. pydrake_system::

        name: FaultyPose
        input_ports:
        - pose
        output_ports:
        - pose

    Both are ``RigidTransform`` X_WO. Earlier poses, which a fault may need, are remembered at the
    rate of the measurement. What is random depends on seed and time only.
    """

    def __init__(self, fault: PoseFault, period: float, seed: int = 0) -> None:
        """A fault of a pose that is measured every ``period`` seconds."""
        super().__init__()
        self._fault, self._seed = fault, seed
        self._input = declare_input(self, "pose", RigidTransform())
        # Discrete, as in the tracker: an abstract one would update the whole diagram.
        self._past = self.DeclareDiscreteState(np.full(16 * fault.depth(period), np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._remember))
        declare_output(self, "pose", self._calc, model=RigidTransform())

    def _remember(self, context: Context, discrete_state) -> None:
        X_WO = self._input.Eval(context).GetAsMatrix4()
        past = self._fault.remembered(context.get_time(), self._poses(context), X_WO)
        discrete_state.get_mutable_vector().SetFromVector(past.ravel())

    def _calc(self, context: Context) -> RigidTransform:
        X_WO, time = self._input.Eval(context), context.get_time()
        if not self._fault.active(time):
            return X_WO
        rng = np.random.default_rng([self._seed, round(1e6 * time)])
        measured = self._fault.measured(X_WO.GetAsMatrix4(), self._poses(context), rng)
        return RigidTransform(measured)

    def _poses(self, context: Context) -> np.ndarray:
        values: np.ndarray = context.get_discrete_state_vector().value()
        return values.reshape(-1, 4, 4)
