"""What stands in for the drivers, and for whoever carries the object, in a simulated cell."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.grasps.sequence import (
    GraspSequenceConfig,
    Phase,
    has_closed,
    pressing_since,
)
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.hardware.channels import IIWA_PERIOD


class SimulatedIiwaDriver(LeafSystem):
    """Does with commanded positions what drake-iiwa-driver does.

    .. pydrake_system::

        name: SimulatedIiwaDriver
        input_ports:
        - position
        - torque_external
        output_ports:
        - position
        - stopped

    ``position`` is V7 [rad], clamped to the driver's limits and kept for ever; ``torque_external``
    is V7 [Nm]. Where that exceeds a joint's threshold the driver stops: from then on the arm stays
    where it is commanded to be. ``stopped`` is V1: the joint that stopped it, counted from 1; 0
    while it works.
    """

    def __init__(self) -> None:
        """A driver with the period of the real one."""
        super().__init__()
        self._position = self.DeclareVectorInputPort("position", IIWA_7.joints)
        self._torque = self.DeclareVectorInputPort("torque_external", IIWA_7.joints)
        kept = self.DeclareDiscreteState(IIWA_7.joints)
        stopped = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("position", kept)
        self.DeclareStateOutputPort("stopped", stopped)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(IIWA_PERIOD, 0.0, self._update)

    def _update(self, context: Context, state) -> EventStatus:
        stopped = context.get_discrete_state(1).value()[0]
        beyond = np.abs(self._torque.Eval(context)) > IIWA_7.driver.external_torque
        if stopped == 0.0 and not beyond.any():
            limit = IIWA_7.driver.position
            command = np.clip(self._position.Eval(context), -limit, limit)
            state.get_mutable_vector(0).SetFromVector(command)
        elif stopped == 0.0:
            state.get_mutable_vector(1).SetFromVector([1.0 + np.argmax(beyond)])
        return EventStatus.Succeeded()


class Handover(LeafSystem):
    """Whoever carries the object lets it go once it is gripped; and what the gripper is doing.

    .. pydrake_system::

        name: Handover
        input_ports:
        - target
        - gripper_state
        output_ports:
        - gripper_position
        - object_hold
        - phase

    ``target`` is the commanded distance between the pads [m], ``gripper_state`` the measured one
    and its rate. The phases are told by the gripper alone: it closes, and if something is between
    the pads when they have squeezed it for ``squeeze_time``, that is let go; lift, shake and hold
    last as long as the scenario says. ``gripper_position`` is what the fingers are sent: a gripper
    that is told to close squeezes with all its force, however wide the object is.
    """

    PERIOD = 0.01
    #: A gripper that is commanded narrower than its opening by less stays open [m].
    _OPEN = 1e-3
    #: The sequence of the controller is behind that of the carrier by what messages take [s].
    _LATE = 0.3

    def __init__(self, config: GraspSequenceConfig, gripper: ParallelGripper) -> None:
        """A carrier that knows how long a grasp takes."""
        super().__init__()
        self._config, self._gripper = config, gripper
        self._target = self.DeclareVectorInputPort("target", 1)
        self._measured = self.DeclareVectorInputPort("gripper_state", 2)
        state = self.DeclareDiscreteState([0.0, 0.0, np.nan])  # phase, since when, pressing since
        self.DeclarePeriodicDiscreteUpdateEvent(self.PERIOD, 0.0, self._update)
        ticket = {self.discrete_state_ticket(state)}
        self.DeclareVectorOutputPort(
            "gripper_position", 1, self._calc_gripper, {self._target.ticket()}
        )
        self.DeclareVectorOutputPort("object_hold", 1, self._calc_hold, ticket)
        self.DeclareVectorOutputPort("phase", 1, self._calc_phase, ticket)

    def _update(self, context: Context, state) -> EventStatus:
        phase, since, pressing = context.get_discrete_state(0).value()
        t, config = context.get_time(), self._config
        elapsed = t - since
        width, rate = self._measured.Eval(context)
        opening = self._target.Eval(context)[0]
        closing = opening < self._gripper.max_opening - self._OPEN
        lasts = {
            Phase.LIFT: config.lift_time,
            Phase.SHAKE: config.shake_time,
            Phase.HOLD: config.hold_time + self._LATE,
        }
        after = None
        if phase == Phase.APPROACH:
            after = Phase.CLOSE if closing else None
        elif phase == Phase.CLOSE:
            if not closing:
                after = Phase.APPROACH
            else:
                squeezed = opening <= self._OPEN  # what is still closing does not press as hard
                pressing = pressing_since(pressing, t, elapsed, rate) if squeezed else np.nan
                gripped = has_closed(t, since, pressing, config) and width >= config.min_width
                after = Phase.LIFT if gripped else None
        elif elapsed >= lasts.get(Phase(int(phase)), np.inf) - 1e-9:
            after = Phase(int(phase) + 1)
        kept = [phase, since, pressing] if after is None else [float(after), t, np.nan]
        state.get_mutable_vector().SetFromVector(kept)
        return EventStatus.Succeeded()

    def _calc_gripper(self, context: Context, output) -> None:
        opening = self._target.Eval(context)[0]
        output.SetAtIndex(0, opening if opening > self._OPEN else GripperSequencer.CLOSED)

    def _calc_hold(self, context: Context, output) -> None:
        output.SetAtIndex(0, float(context.get_discrete_state(0).value()[0] <= Phase.CLOSE))

    def _calc_phase(self, context: Context, output) -> None:
        output.SetAtIndex(0, context.get_discrete_state(0).value()[0])
