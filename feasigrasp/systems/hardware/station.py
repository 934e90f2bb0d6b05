"""The station's ports on top of driver messages."""

from collections.abc import Mapping

from drake import (
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_image_array,
    lcmt_robot_state,
    lcmt_schunk_wsg_command,
    lcmt_schunk_wsg_status,
)
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import (
    IiwaCommandSender,
    IiwaControlMode,
    IiwaStatusReceiver,
    SchunkWsgCommandSender,
    SchunkWsgStatusReceiver,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.perception import DepthImageToPointCloud
from pydrake.systems.framework import DiagramBuilder, OutputPort, TriggerType
from pydrake.systems.lcm import LcmPublisherSystem
from pydrake.systems.primitives import Demultiplexer, Saturation
from pydrake.systems.sensors import CameraConfig, PixelType

from feasigrasp.errors import ScenarioError
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import station_config
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.channels import add_publisher, add_subscriber
from feasigrasp.systems.hardware.measurements import ObjectPoseReceiver, RgbdReceiver
from feasigrasp.systems.ports import ArmPorts, add_connected
from feasigrasp.systems.station.camera import pixel_centred_intrinsics
from feasigrasp.systems.station.cell_models import add_cell
from feasigrasp.systems.station.exposures import CameraPose, PositionAt


class HardwareStation(ArmPorts):
    """The ports of `feasigrasp.systems.station.station.Station` that a real cell has.

    .. pydrake_system::

        name: HardwareStation
        input_ports: [arm.desired_state, gripper.position]
        output_ports: [arm.position_measured, arm.velocity_estimated, arm.torque_external,
          gripper.state_measured, object.pose, object.stamp, <camera>.point_cloud,
          <camera>.depth_image, <camera>.label_image, <camera>.pose, <camera>.pose_now,
          <camera>.position, <camera>.gripper_state, <camera>.stamp]

    Of ``arm.desired_state`` (V14) the positions are sent, and nothing else: to the guard, which
    commands the arm. ``arm.velocity_estimated`` V7 [rad/s] and ``arm.torque_external`` V7 [Nm]
    are as the driver estimates them.
    ``object.pose`` is a measurement, made at ``object.stamp``. ``<camera>.pose`` X_WC follows from
    the measured joints at the instant of the image, ``<camera>.position`` (V7), as
    ``<camera>.gripper_state`` (V2) is the gripper's; that instant is ``<camera>.stamp``.
    ``<camera>.pose_now`` is where the camera is by ``arm.position_measured``. Stamps are V1 [s],
    of the clock of the arm's status messages, which the diagram's time has to follow.

    Attributes:
        arm: The arm.
        plant: The cell without the object: the frames that cameras are mounted on.
        request: The publisher of what is asked of the guard; it publishes on request.
    """

    #: Labels of object and robot in masks.
    object_label = channels.MaskLabel.OBJECT

    def __init__(self, scenario: Scenario, inbox: DrakeLcm, outbox: DrakeLcm) -> None:
        """The cell of a scenario, whose object is not looked at, behind two message buses.

        Messages come from ``inbox`` and go to ``outbox``.

        Raises:
            ScenarioError: A camera is mounted neither on the arm nor in the world.
        """
        super().__init__()
        builder = DiagramBuilder()
        self.plant = MultibodyPlant(scenario.plant_config.time_step)
        config = station_config(scenario)
        self.arm = config.arm
        add_cell(self.plant, config)
        self.plant.Finalize()
        self._inbox, self._outbox = inbox, outbox
        fingers = self._add_gripper(builder, load_gripper(scenario.gripper))
        position, measured_at = self._add_arm(builder)
        self._add_object(builder)
        # The gripper's messages have no time on the arm's clock: they are of now.
        measured = {"position": position, "gripper_state": fingers}
        period = scenario.control.period
        for name, camera in scenario.cameras.items():
            self._add_camera(builder, name, camera, measured, measured_at, period)
        builder.BuildInto(self)

    def robot_and_object_labels(self) -> list[int]:
        """Labels that arm, gripper and object have in masks."""
        return [channels.MaskLabel.OBJECT, channels.MaskLabel.ROBOT]

    def _add_arm(self, builder: DiagramBuilder) -> tuple[OutputPort, OutputPort]:
        """Exports the arm's ports; returns the measured positions, and when they were measured."""
        messages = add_subscriber(builder, channels.IIWA_STATUS, lcmt_iiwa_status, self._inbox)
        status = IiwaStatusReceiver(self.arm.joints)
        add_connected(builder, "iiwa_status", status, messages)
        position = status.GetOutputPort("position_measured")
        builder.ExportOutput(position, "arm.position_measured")
        for port in ("velocity_estimated", "torque_external"):
            builder.ExportOutput(status.GetOutputPort(port), f"arm.{port}")

        desired = builder.AddNamedSystem("desired_position", Demultiplexer([self.arm.joints] * 2))
        builder.ExportInput(desired.get_input_port(), "arm.desired_state")
        command = IiwaCommandSender(self.arm.joints, IiwaControlMode.kPositionOnly)
        add_connected(builder, "iiwa_request", command, position=desired.get_output_port(0))
        self.request = LcmPublisherSystem.Make(
            channels.IIWA_REQUEST,
            lcmt_iiwa_command,
            self._outbox,
            publish_triggers={TriggerType.kForced},
            use_cpp_serializer=True,
        )
        add_connected(builder, channels.IIWA_REQUEST, self.request, command.get_output_port())
        return position, status.GetOutputPort("time_measured")

    def _add_gripper(self, builder: DiagramBuilder, gripper: Gripper) -> OutputPort:
        """Exports the gripper's ports; returns its measured state."""
        if not isinstance(gripper, ParallelGripper):
            raise ScenarioError(
                "gripper: there is no driver of a suction cup; run it in simulation, or choose a "
                "parallel gripper"
            )
        kind = lcmt_schunk_wsg_status
        messages = add_subscriber(builder, channels.WSG_STATUS, kind, self._inbox)
        status = add_connected(builder, "wsg_status", SchunkWsgStatusReceiver(), messages)
        builder.ExportOutput(status.GetOutputPort("state"), "gripper.state_measured")
        # A real gripper squeezes as hard as its force limit says; it needs no distance below zero.
        opening = Saturation([0.0], [gripper.max_opening])
        builder.AddNamedSystem("opening", opening)
        builder.ExportInput(opening.get_input_port(), "gripper.position")
        command = SchunkWsgCommandSender()
        add_connected(builder, "wsg_command", command, position=opening.get_output_port())
        add_publisher(
            *(builder, channels.WSG_COMMAND, lcmt_schunk_wsg_command, self._outbox),
            *(command.get_output_port(), channels.WSG_PERIOD),
        )
        return status.GetOutputPort("state")

    def _add_object(self, builder: DiagramBuilder) -> None:
        messages = add_subscriber(builder, channels.OBJECT_POSE, lcmt_robot_state, self._inbox)
        receiver = add_connected(builder, "object_pose", ObjectPoseReceiver(), messages)
        builder.ExportOutput(receiver.GetOutputPort("pose"), "object.pose")
        builder.ExportOutput(receiver.GetOutputPort("stamp"), "object.stamp")

    def _add_camera(
        self,
        builder: DiagramBuilder,
        name: str,
        camera: CameraConfig,
        measured: Mapping[str, OutputPort],
        measured_at: OutputPort,
        period: float,
    ) -> None:
        """Exports what a camera shows, and what of the arm was measured at that instant."""
        channel = channels.image_channel(name)
        messages = add_subscriber(builder, channel, lcmt_image_array, self._inbox)
        images = RgbdReceiver(camera.width, camera.height)
        add_connected(builder, f"{name}_images", images, messages)
        names = ("depth_image", "label_image", "stamp")
        shown, ports = {port: images.GetOutputPort(port) for port in names}, {}
        for what, now in measured.items():
            then = PositionAt(period, now.size())
            add_connected(builder, f"{name}_{what}", then, now, measured_at, shown["stamp"])
            ports[what] = then.get_output_port()

        def pose(what: str, position: OutputPort) -> OutputPort:
            system = CameraPose(self.plant, name, camera, self.arm)
            return add_connected(builder, f"{name}_{what}", system, position).get_output_port()

        X_WC = pose("pose", ports["position"])
        cloud = DepthImageToPointCloud(pixel_centred_intrinsics(camera), PixelType.kDepth32F)
        inputs = {"depth_image": shown["depth_image"], "camera_pose": X_WC}
        add_connected(builder, f"{name}_point_cloud", cloud, **inputs)
        ports |= {"point_cloud": cloud.point_cloud_output_port()} | shown | {"pose": X_WC}
        ports["pose_now"] = pose("pose_now", measured["position"])
        for what, port in ports.items():
            builder.ExportOutput(port, f"{name}.{what}")
