"""Fault injection into joint velocity commands."""

from __future__ import annotations

from typing import Any
from unittest import mock

import daqp
import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.faults.control import CommandFault, SolverFailure
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.controller_inputs import ControllerInputs
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.ports import weakly


class FaultyCommand(LeafSystem):
    """Passes commanded joint velocities on, but for a fault.

    .. pydrake_system::

        name: FaultyCommand
        input_ports:
        - velocity
        output_ports:
        - velocity

    Both are V7 [rad/s]. What is random depends on seed and time only.
    """

    def __init__(self, fault: CommandFault, seed: int = 0) -> None:
        """A fault of the command."""
        super().__init__()
        self._fault, self._seed = fault, seed
        self._input = self.DeclareVectorInputPort("velocity", IIWA_7.joints)
        self.DeclareVectorOutputPort("velocity", IIWA_7.joints, weakly(self._calc))

    def _calc(self, context: Context, output) -> None:
        qd, time = self._input.Eval(context), context.get_time()
        if self._fault.active(time):
            rng = np.random.default_rng([self._seed, round(1e6 * time)])
            qd = self._fault.command(qd, rng)
        output.SetFromVector(qd)


def fail_solver(controller: GraspController, fault: SolverFailure) -> None:
    """Lets the solver of a controller's QP give up while there is a fault.

    The solver is a library's function: while the fault is there, another stands in its place for
    the time of a command. What the controller makes of that is its own code.
    """
    velocity = controller.velocity

    def with_fault(memory: Any, inputs: ControllerInputs) -> Array:
        if not fault.active(inputs.time):
            return velocity(memory, inputs)
        with mock.patch.object(daqp, "solve", _give_up):
            return velocity(memory, inputs)

    controller.velocity = with_fault  # type: ignore[method-assign]


def _give_up(H: Array, *_: Array) -> tuple[Array, float, int, dict[str, Any]]:
    """What DAQP returns if there is no solution: exit flag -1."""
    return np.full(len(H), np.nan), np.nan, -1, {}
