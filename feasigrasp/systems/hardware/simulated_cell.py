"""Simulated cell behind driver messages."""

import copy

import numpy as np
from drake import (
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_robot_state,
    lcmt_schunk_wsg_command,
    lcmt_schunk_wsg_status,
)
from pydrake.common.schema import Transform
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import (
    IiwaCommandReceiver,
    IiwaControlMode,
    IiwaStatusSender,
    SchunkWsgCommandReceiver,
    SchunkWsgStatusSender,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    ConstantVectorSource,
    LogVectorOutput,
    StateInterpolatorWithDiscreteDerivative,
)

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.sequence import GraspSequenceConfig, Phase, has_closed, pressing_since
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.scenario.sampling import make_hand_eye
from feasigrasp.scenario.schema import Scenario, Segmentation
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.channels import IIWA_PERIOD, add_publisher, add_subscriber
from feasigrasp.systems.hardware.measurements import ObjectPoseSender, publish_images
from feasigrasp.systems.pipeline import Cell, add_judges
from feasigrasp.systems.ports import add_connected, declare_output, weakly
from feasigrasp.systems.station.camera import calibration_error
from feasigrasp.systems.station.station import Station


class SimulatedIiwaDriver(LeafSystem):
    """Does with commanded positions what drake-iiwa-driver does.

    .. pydrake_system::

        name: SimulatedIiwaDriver
        input_ports: [position, torque_external]
        output_ports: [position, stopped]

    ``position`` is V7 [rad], for each joint of the arm, clamped to the driver's limits and kept for
    ever; ``torque_external`` is V7 [Nm]. Where that exceeds a joint's threshold the driver stops:
    from then on the arm stays where it is commanded to be. ``stopped`` is V1: the joint that
    stopped it, counted from 1; 0 while it works.
    """

    def __init__(self, arm: Arm = IIWA_7) -> None:
        super().__init__()
        self._arm = arm
        self._position = self.DeclareVectorInputPort("position", arm.joints)
        self._torque = self.DeclareVectorInputPort("torque_external", arm.joints)
        kept = self.DeclareDiscreteState(arm.joints)
        stopped = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("position", kept)
        self.DeclareStateOutputPort("stopped", stopped)
        self.DeclareInitializationDiscreteUpdateEvent(weakly(self._update))
        self.DeclarePeriodicDiscreteUpdateEvent(IIWA_PERIOD, 0.0, weakly(self._update))

    def _update(self, context: Context, state) -> None:
        stopped = context.get_discrete_state(1).value()[0]
        beyond = np.abs(self._torque.Eval(context)) > self._arm.driver.external_torque
        if stopped != 0.0:
            return
        if not beyond.any():
            driver = self._arm.driver
            command = np.clip(self._position.Eval(context), driver.lower, driver.upper)
            state.get_mutable_vector(0).SetFromVector(command)
        else:
            state.get_mutable_vector(1).SetFromVector([1.0 + np.argmax(beyond)])


class Handover(LeafSystem):
    """Release by the carrier after the grip, and the phase of the gripper.

    .. pydrake_system::

        name: Handover
        input_ports: [target, gripper_state]
        output_ports: [gripper_position, object_hold, phase]

    ``target`` is the commanded distance between the pads [m], ``gripper_state`` the measured one
    and its rate. The phases follow from the gripper alone: it closes, and if something is between
    the pads when they have squeezed it for ``squeeze_time``, its carrier is asked to let go; from
    ``handover_time`` later on, lift, shake and hold last as long as the scenario says.
    ``gripper_position`` is what the fingers are sent: a gripper with the command to close squeezes
    with all its force, however wide the object is.
    """

    PERIOD = 0.01
    #: A gripper that is commanded narrower than its opening by less stays open [m].
    _OPEN = 1e-3
    #: The sequence of the controller is behind that of the carrier by what messages take [s].
    _LATE = 0.3

    def __init__(self, config: GraspSequenceConfig, gripper: Gripper) -> None:
        super().__init__()
        self._config, self._gripper = config, gripper
        self._target = self.DeclareVectorInputPort("target", 1)
        self._measured = self.DeclareVectorInputPort("gripper_state", 2)
        # Phase, since when; pressing and asked to let go since when.
        state = self.DeclareDiscreteState([0.0, 0.0, np.nan, np.nan])
        self.DeclarePeriodicDiscreteUpdateEvent(self.PERIOD, 0.0, weakly(self._update))
        kept = {self.discrete_state_ticket(state)}
        declare_output(self, "gripper_position", self._calc_gripper, {self._target}, size=1)
        declare_output(self, "object_hold", lambda of: np.isnan(_kept(of)[3]), kept, size=1)
        declare_output(self, "phase", lambda context: _kept(context)[0], kept, size=1)

    def _update(self, context: Context, state) -> None:
        phase, since, pressing, asked = _kept(context)
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
                asked = t if gripped and np.isnan(asked) else asked
                after = Phase.LIFT if t - asked >= config.handover_time - 1e-9 else None
        elif elapsed >= lasts.get(Phase(int(phase)), np.inf) - 1e-9:
            after = Phase(int(phase) + 1)
        kept = [phase, since, pressing, asked]
        if after is not None:
            kept = [float(after), t, np.nan, np.nan if after <= Phase.CLOSE else asked]
        state.get_mutable_vector().SetFromVector(kept)

    def _calc_gripper(self, context: Context) -> float:
        opening = self._target.Eval(context)[0]
        return opening if opening > self._OPEN else GripperSequencer.CLOSED


def _kept(context: Context) -> Array:
    """The state of a `Handover`."""
    return context.get_discrete_state(0).value()


def make_simulated_cell(scenario: Scenario, lcm: DrakeLcm) -> Diagram:
    """A scenario's plant, cameras and drivers behind messages, and what judges a run of it.

    The subsystems are named ``station``, ``driver``, ``handover``, ``metrics``, ``contact`` and
    ``obstacle_distance``, and after the channels; the logs are those of `make_dynamic_grasp`, but
    for ``log(drive)``. What the controller means to grasp is not known here, so that there are no
    grasps in the samples. A camera that has a hand-eye error stands off the place at which the
    scenario, and so the controller, has it.
    """
    scenario = _with_true_mounts(scenario)
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", make_station(scenario))
    builder.AddNamedSystem("lcm", _Messages(lcm))
    _add_arm(builder, station, lcm)
    _add_gripper(builder, station, lcm, scenario)
    sender, period = ObjectPoseSender(scenario.tracker), scenario.tracker.period
    add_connected(builder, "object_pose", sender, station.GetOutputPort("object.pose"))
    add_publisher(
        builder, channels.OBJECT_POSE, lcmt_robot_state, lcm, sender.get_output_port(), period
    )
    mask = scenario.perception.segmentation == Segmentation.LABELS
    for name, camera in scenario.cameras.items():
        publish_images(builder, station, name, camera, lcm, mask=mask)
    cell = Cell(builder, scenario, load_gripper(scenario.gripper), station.arm, station)
    add_judges(cell)
    cell.connect()
    diagram = builder.Build()
    diagram.set_name("simulated_cell")
    return diagram


class _Messages(LeafSystem):
    """Takes messages from a bus at the beginning of every step.

    As Drake's ``LcmInterfaceSystem``, which crashes in Drake 1.58 where a handler is in Python.
    """

    def __init__(self, lcm: DrakeLcm) -> None:
        super().__init__()
        self._lcm = lcm
        self.DeclarePerStepDiscreteUpdateEvent(weakly(self._take))

    def _take(self, context, discrete_state) -> None:
        self._lcm.HandleSubscriptions(0)


def _with_true_mounts(scenario: Scenario) -> Scenario:
    """The scenario with its cameras at their true instead of their calibrated poses."""
    true = copy.deepcopy(scenario)
    for name, error in make_hand_eye(scenario).items():
        X_CB = RigidTransform(calibration_error(error, scenario.random_seed))
        calibrated = scenario.cameras[name].X_PB
        X_PB = Transform(RigidTransform(calibrated.GetDeterministicValue()) @ X_CB.inverse())
        X_PB.base_frame = calibrated.base_frame
        true.cameras[name].X_PB = X_PB
    return true


def _add_arm(builder: DiagramBuilder, station: Station, lcm: DrakeLcm) -> None:
    n = station.arm.joints
    measured = station.GetOutputPort("arm.position_measured")
    torque = station.GetOutputPort("arm.torque_external")
    command = add_subscriber(builder, channels.IIWA_COMMAND, lcmt_iiwa_command, lcm)
    receiver = IiwaCommandReceiver(n, IiwaControlMode.kPositionOnly)
    inputs = {"lcmt_iiwa_command": command, "position_measured": measured}
    add_connected(builder, "iiwa_command", receiver, **inputs)
    driver = SimulatedIiwaDriver(station.arm)
    commanded = receiver.GetOutputPort("position")
    add_connected(builder, "driver", driver, position=commanded, torque_external=torque)
    position = driver.GetOutputPort("position")
    LogVectorOutput(position, builder, IIWA_PERIOD).set_name("log(driver)")
    # The arm's own controller takes its feed-forward from the positions, as Drake's SimIiwaDriver.
    interpolator = StateInterpolatorWithDiscreteDerivative(n, IIWA_PERIOD)
    add_connected(builder, "interpolator", interpolator, position)
    builder.Connect(interpolator.get_output_port(), station.GetInputPort("arm.desired_state"))

    drive_torque = station.GetOutputPort("arm.torque_measured")
    status = add_connected(
        builder,
        "iiwa_status",
        IiwaStatusSender(n),
        position_commanded=position,
        position_measured=measured,
        velocity_estimated=station.GetOutputPort("arm.velocity_estimated"),
        torque_commanded=drive_torque,
        torque_measured=drive_torque,
        torque_external=torque,
    )
    add_publisher(
        builder, channels.IIWA_STATUS, lcmt_iiwa_status, lcm, status.get_output_port(), IIWA_PERIOD
    )


def _add_gripper(
    builder: DiagramBuilder, station: Station, lcm: DrakeLcm, scenario: Scenario
) -> None:
    gripper, state = load_gripper(scenario.gripper), station.GetOutputPort("gripper.state_measured")
    command = add_subscriber(builder, channels.WSG_COMMAND, lcmt_schunk_wsg_command, lcm)
    receiver = SchunkWsgCommandReceiver(initial_position=gripper.max_opening)
    add_connected(builder, "wsg_command", receiver, command)
    handover = Handover(scenario.sequence, gripper)
    target = receiver.GetOutputPort("position")
    add_connected(builder, "handover", handover, target=target, gripper_state=state)
    for output, given in (("gripper_position", "gripper.position"), ("object_hold", "object.hold")):
        builder.Connect(handover.GetOutputPort(output), station.GetInputPort(given))
    force = builder.AddNamedSystem("wsg_force", ConstantVectorSource([0.0]))  # it has no reader
    status = SchunkWsgStatusSender()
    add_connected(builder, "wsg_status", status, state, force.get_output_port())
    kind, port = lcmt_schunk_wsg_status, status.get_output_port()
    add_publisher(builder, channels.WSG_STATUS, kind, lcm, port, channels.WSG_PERIOD)
