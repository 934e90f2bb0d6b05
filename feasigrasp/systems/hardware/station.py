"""The station's ports on top of driver messages."""

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
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.primitives import Demultiplexer, Saturation
from pydrake.systems.sensors import CameraConfig, PixelType

from feasigrasp.errors import ScenarioError
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import station_config
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.measurements import ObjectPoseReceiver, RgbdReceiver
from feasigrasp.systems.station.arm_ports import ArmPorts
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
        for name, camera in scenario.cameras.items():
            images = self._add_images(builder, name, camera)
            for port, measured in (("position", position), ("gripper_state", fingers)):
                then = PositionAt(scenario.control.period, measured.size())
                builder.AddNamedSystem(f"{name}_{port}", then)
                builder.Connect(measured, then.GetInputPort("position"))
                # The gripper's messages have no time on the arm's clock: they are of now.
                builder.Connect(measured_at, then.GetInputPort("measured_at"))
                builder.Connect(images.GetOutputPort("stamp"), then.GetInputPort("stamp"))
                builder.ExportOutput(then.get_output_port(), f"{name}.{port}")
            self._add_camera(builder, name, camera, images)
            now = builder.AddNamedSystem(
                f"{name}_pose_now", CameraPose(self.plant, name, camera, self.arm)
            )
            builder.Connect(position, now.get_input_port())
            builder.ExportOutput(now.get_output_port(), f"{name}.pose_now")
        builder.BuildInto(self)

    def robot_and_object_labels(self) -> list[int]:
        """Labels that arm, gripper and object have in masks."""
        return [channels.MaskLabel.OBJECT, channels.MaskLabel.ROBOT]

    def _messages(
        self, builder: DiagramBuilder, channel: str, kind: type, *, native: bool
    ) -> OutputPort:
        """What comes in on a channel; ``native`` where a system in C++ reads it."""
        subscriber = LcmSubscriberSystem.Make(channel, kind, self._inbox, use_cpp_serializer=native)
        return builder.AddNamedSystem(channel, subscriber).get_output_port()

    def _add_arm(self, builder: DiagramBuilder) -> tuple[OutputPort, OutputPort]:
        """Exports the arm's ports; returns the measured positions, and when they were measured."""
        status = builder.AddNamedSystem("iiwa_status", IiwaStatusReceiver(self.arm.joints))
        messages = self._messages(builder, channels.IIWA_STATUS, lcmt_iiwa_status, native=True)
        builder.Connect(messages, status.get_input_port())
        position = status.GetOutputPort("position_measured")
        builder.ExportOutput(position, "arm.position_measured")
        for port in ("velocity_estimated", "torque_external"):
            builder.ExportOutput(status.GetOutputPort(port), f"arm.{port}")

        desired = builder.AddNamedSystem("desired_position", Demultiplexer([self.arm.joints] * 2))
        builder.ExportInput(desired.get_input_port(), "arm.desired_state")
        command = IiwaCommandSender(self.arm.joints, IiwaControlMode.kPositionOnly)
        builder.AddNamedSystem("iiwa_request", command)
        builder.Connect(desired.get_output_port(0), command.GetInputPort("position"))
        self.request = builder.AddNamedSystem(
            channels.IIWA_REQUEST,
            LcmPublisherSystem.Make(
                channels.IIWA_REQUEST,
                lcmt_iiwa_command,
                self._outbox,
                publish_triggers={TriggerType.kForced},
                use_cpp_serializer=True,
            ),
        )
        builder.Connect(command.get_output_port(), self.request.get_input_port())
        return position, status.GetOutputPort("time_measured")

    def _add_gripper(self, builder: DiagramBuilder, gripper: Gripper) -> OutputPort:
        """Exports the gripper's ports; returns its measured state."""
        if not isinstance(gripper, ParallelGripper):
            raise ScenarioError(
                "gripper: there is no driver of a suction cup; run it in simulation, or choose a "
                "parallel gripper"
            )
        status = builder.AddNamedSystem("wsg_status", SchunkWsgStatusReceiver())
        kind = lcmt_schunk_wsg_status
        messages = self._messages(builder, channels.WSG_STATUS, kind, native=True)
        builder.Connect(messages, status.get_input_port(0))
        builder.ExportOutput(status.GetOutputPort("state"), "gripper.state_measured")
        # A real gripper squeezes as hard as its force limit says; it needs no distance below zero.
        opening = Saturation([0.0], [gripper.max_opening])
        builder.AddNamedSystem("opening", opening)
        builder.ExportInput(opening.get_input_port(), "gripper.position")
        command = builder.AddNamedSystem("wsg_command", SchunkWsgCommandSender())
        builder.Connect(opening.get_output_port(), command.GetInputPort("position"))
        publisher = LcmPublisherSystem.Make(
            channels.WSG_COMMAND,
            lcmt_schunk_wsg_command,
            self._outbox,
            publish_period=channels.WSG_PERIOD,
            use_cpp_serializer=True,
        )
        builder.AddNamedSystem(channels.WSG_COMMAND, publisher)
        builder.Connect(command.get_output_port(), publisher.get_input_port())
        return status.GetOutputPort("state")

    def _add_object(self, builder: DiagramBuilder) -> None:
        receiver = builder.AddNamedSystem("object_pose", ObjectPoseReceiver())
        messages = self._messages(builder, channels.OBJECT_POSE, lcmt_robot_state, native=False)
        builder.Connect(messages, receiver.get_input_port())
        builder.ExportOutput(receiver.GetOutputPort("pose"), "object.pose")
        builder.ExportOutput(receiver.GetOutputPort("stamp"), "object.stamp")

    def _add_images(self, builder: DiagramBuilder, name: str, camera: CameraConfig) -> RgbdReceiver:
        receiver = RgbdReceiver(camera.width, camera.height)
        builder.AddNamedSystem(f"{name}_images", receiver)
        channel = channels.image_channel(name)
        messages = self._messages(builder, channel, lcmt_image_array, native=False)
        builder.Connect(messages, receiver.get_input_port())
        return receiver

    def _add_camera(
        self, builder: DiagramBuilder, name: str, camera: CameraConfig, receiver: RgbdReceiver
    ) -> None:
        """Exports what a camera shows, from its images and the joints at their instant."""
        then = builder.GetSubsystemByName(f"{name}_position")
        pose = builder.AddNamedSystem(
            f"{name}_pose", CameraPose(self.plant, name, camera, self.arm)
        )
        builder.Connect(then.get_output_port(), pose.get_input_port())
        cloud = DepthImageToPointCloud(pixel_centred_intrinsics(camera), PixelType.kDepth32F)
        builder.AddNamedSystem(f"{name}_point_cloud", cloud)
        builder.Connect(receiver.GetOutputPort("depth_image"), cloud.depth_image_input_port())
        builder.Connect(pose.get_output_port(), cloud.camera_pose_input_port())
        builder.ExportOutput(cloud.point_cloud_output_port(), f"{name}.point_cloud")
        for port in ("depth_image", "label_image", "stamp"):
            builder.ExportOutput(receiver.GetOutputPort(port), f"{name}.{port}")
        builder.ExportOutput(pose.get_output_port(), f"{name}.pose")
