"""The robot cell as one diagram: arm, gripper, wrist camera, table and a moving object."""

import copy
import tempfile
from collections.abc import Iterable

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import Demultiplexer, MatrixGain
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.objects.motion import ObjectMotion
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.objects.spring_drive import body_pose_kernel
from feasigrasp.models.robot.gripper import Gripper, SuctionCup
from feasigrasp.models.sensors.joint_errors import DrawnJointErrors
from feasigrasp.systems.ports import ArmPorts, add_connected, declare_pose_and_velocity
from feasigrasp.systems.station.camera import Scene, export_camera
from feasigrasp.systems.station.cell_models import StationConfig, add_cell, robot_instances
from feasigrasp.systems.station.exposures import Timing, add_exposures
from feasigrasp.systems.station.joints import FingerDrive, JointSensors
from feasigrasp.systems.station.object_model import (
    add_distractor_bodies,
    add_object,
    contact_friction,
    set_friction,
)
from feasigrasp.systems.station.object_servo import ObjectServo, SuctionSeal


class _BodyState(LeafSystem):
    """Pose and spatial velocity out of a floating body's V13 state."""

    def __init__(self) -> None:
        super().__init__()
        self._state = self.DeclareVectorInputPort("state", 13)
        declare_pose_and_velocity(self, self._calc, {self._state})

    def _calc(self, context: Context) -> tuple[Array, Array]:
        state = self._state.Eval(context)
        return body_pose_kernel(state), state[7:13]


class Station(ArmPorts):
    """A robot cell; the port names follow Drake's hardware stations.

    .. pydrake_system::

        name: Station
        input_ports: [arm.desired_state, gripper.position, object.hold]
        output_ports: [arm.position_measured, arm.velocity_estimated, arm.state_estimated,
          arm.torque_measured, arm.torque_external, gripper.state_measured, object.pose,
          object.velocity, object.let_go, <camera>.point_cloud, <camera>.color_image,
          <camera>.depth_image, <camera>.label_image, <camera>.pose, <camera>.pose_now,
          <camera>.position, <camera>.gripper_state, <camera>.stamp, contact_results, query_object]

    ``arm.desired_state`` and ``arm.state_estimated`` are V14 (positions [rad], velocities
    [rad/s]). The latter is true, as ``arm.velocity_estimated``, its second half; of
    ``arm.position_measured`` V7, ``arm.desired_state`` and the torques see `JointSensors`.
    ``arm.torque_measured`` is V7, what the motors of the weightless arm give [Nm], and
    ``arm.torque_external`` V7, what contact does to the joints, which the real arm estimates [Nm];
    ``gripper.position`` is the distance between the pads [m] and
    ``gripper.state_measured`` that distance and its rate (see `SuctionSeal` for a cup);
    ``object.hold`` is 1 while the object is to be carried along its motion and 0 from the command
    to let it go on; ``object.let_go`` is the time at which its carrier does so [s], infinite
    before. Point clouds are in the world frame.

    A camera with an ``output_delay`` or a ``capture_offset`` takes images at its ``fps``, and what
    its ports show is of the instant of exposure: ``<camera>.stamp`` (V1) [s], NaN before the first
    image, until when no depth is measured. ``<camera>.position`` (V7) and
    ``<camera>.gripper_state`` (V2) are the measured joints and gripper at that instant, and
    ``<camera>.pose_now`` is X_WC by the present joints. The last four ports are those of such a
    camera only; others show what is there when they are read.
    """

    @checked(ScenarioError)
    def __init__(self, config: StationConfig, obj: RigidObject, motion: ObjectMotion) -> None:
        """Builds the cell around one object that moves as ``motion`` says."""
        super().__init__()
        # Renderers read mesh files late: the folder lives as long as the station.
        self._files = tempfile.TemporaryDirectory(prefix="feasigrasp-")
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlant(config.plant, builder)
        self.arm = config.arm
        plant = self.plant
        self.object_instance = self._add_models(plant, config, obj)
        self._gripper = plant.GetModelInstanceByName("gripper")
        set_friction(plant, self.scene_graph, self._gripper, config.friction)
        plant.SetDefaultFloatingBaseBodyPose(self.object_body, RigidTransform(motion.pose(0.0)))
        plant.Finalize()
        self._let_robot_pass(config)

        joints = DrawnJointErrors(config.joint_errors, config.arm.effort_limits, config.noise_seed)
        position = self._export_arm(builder, joints)
        self._export_gripper(builder, config.gripper, obj)
        object_pose = self._export_object(builder, motion, config)
        self._show_distractor_bodies(builder, config, self.scene_graph, "distractor_bodies")
        if config.cameras:
            seen = self.object_label, obj.material, object_pose
            present = Scene(self.scene_graph, plant, *seen, self.arm, position, joints.zero)
            self._export_cameras(builder, config, obj, present)
        builder.ExportOutput(plant.get_contact_results_output_port(), "contact_results")
        builder.ExportOutput(self.scene_graph.get_query_output_port(), "query_object")
        builder.BuildInto(self)

    @property
    def object_body(self) -> RigidBody:
        """The object; not stored, since Python never frees a plant that holds a body of its own."""
        return self.plant.GetBodyByName("object", self.object_instance)

    @property
    def object_label(self) -> int:
        """Label that the object has in label images."""
        return int(self.object_body.index())

    def robot_and_object_labels(self) -> list[int]:
        """Labels that arm, gripper, camera and object have in label images."""
        instances = [self.object_instance, *self.robot_instances()]
        return [int(b) for instance in instances for b in self.plant.GetBodyIndices(instance)]

    def robot_instances(self) -> list[ModelInstanceIndex]:
        """Model instances of the arm and its attachments."""
        return robot_instances(self.plant, self.arm)

    def contact_friction(self) -> float:
        """The Coulomb friction of contacts between gripper and object."""
        return contact_friction(self.plant, self.scene_graph, self._gripper, self.object_instance)

    def _add_models(
        self, plant: MultibodyPlant, config: StationConfig, obj: RigidObject
    ) -> ModelInstanceIndex:
        add_cell(plant, config)
        return add_object(plant, obj, directory=self._files.name, friction=config.friction)

    def _let_robot_pass(self, config: StationConfig) -> None:
        """Excludes from contact what the configuration lets the robot pass through."""
        passed = [self.object_instance]
        if not config.enforce_constraints:
            passed = [*map(ModelInstanceIndex, range(self.plant.num_model_instances()))]
        if config.touch_object:
            passed.remove(self.object_instance)
        robot = self._geometries(self.robot_instances())
        self.scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeBetween(robot, self._geometries(passed))
        )

    def _geometries(self, instances: Iterable[ModelInstanceIndex]) -> GeometrySet:
        bodies = [index for each in instances for index in self.plant.GetBodyIndices(each)]
        return self.plant.CollectRegisteredGeometries([*map(self.plant.get_body, bodies)])

    def _export_arm(self, builder: DiagramBuilder, errors: DrawnJointErrors) -> OutputPort:
        """Exports the arm; returns the port of its true positions."""
        plant, iiwa = self.plant, self.plant.GetModelInstanceByName(self.arm.name)
        state = plant.get_state_output_port(iiwa)
        sensors = builder.AddNamedSystem("joint_sensors", JointSensors(errors))
        builder.ExportInput(sensors.GetInputPort("desired_state"), "arm.desired_state")
        desired = sensors.GetOutputPort("true_desired_state")
        builder.Connect(desired, plant.get_desired_state_input_port(iiwa))
        position = Demultiplexer([self.arm.joints] * 2)
        add_connected(builder, "iiwa_position", position, state)
        builder.Connect(position.get_output_port(0), sensors.GetInputPort("position"))
        builder.ExportOutput(sensors.GetOutputPort("position_measured"), "arm.position_measured")
        builder.ExportOutput(position.get_output_port(1), "arm.velocity_estimated")
        builder.ExportOutput(state, "arm.state_estimated")
        builder.ExportOutput(plant.get_net_actuation_output_port(iiwa), "arm.torque_measured")
        contact = plant.get_generalized_contact_forces_output_port(iiwa)
        builder.Connect(contact, sensors.GetInputPort("torque_external"))
        builder.ExportOutput(sensors.GetOutputPort("torque_estimated"), "arm.torque_external")
        return position.get_output_port(0)

    def _export_gripper(self, builder: DiagramBuilder, hand: Gripper, obj: RigidObject) -> None:
        plant, gripper = self.plant, self._gripper
        if isinstance(hand, SuctionCup):
            seal = builder.AddNamedSystem("gripper_state", SuctionSeal(plant, hand, obj))
            builder.ExportInput(seal.GetInputPort("opening"), "gripper.position")
            builder.ExportOutput(seal.get_output_port(0), "gripper.state_measured")
            return
        drive = builder.AddNamedSystem("finger_drive", FingerDrive(plant.time_step()))
        builder.Connect(drive.get_output_port(), plant.get_desired_state_input_port(gripper))
        builder.ExportInput(drive.get_input_port(), "gripper.position")
        measured = MatrixGain(np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]]))
        add_connected(builder, "gripper_state", measured, plant.get_state_output_port(gripper))
        builder.ExportOutput(measured.get_output_port(), "gripper.state_measured")

    def _export_object(
        self, builder: DiagramBuilder, motion: ObjectMotion, config: StationConfig
    ) -> OutputPort:
        """Exports the object's motion; returns the port of its pose."""
        plant = self.plant
        state = plant.get_state_output_port(self.object_instance)
        body_state = add_connected(builder, "object_state", _BodyState(), state)
        pose = body_state.GetOutputPort("object_pose")
        builder.ExportOutput(pose, "object.pose")
        builder.ExportOutput(body_state.GetOutputPort("object_velocity"), "object.velocity")
        index = self.object_body.index()
        servo = ObjectServo(plant, index, motion, config.carrier, pulls=config.pulls)
        add_connected(builder, "object_servo", servo, state=state)
        force = servo.GetOutputPort("spatial_force")
        if isinstance(config.gripper, SuctionCup):
            seal = builder.GetSubsystemByName("gripper_state")
            for name, port in (
                ("object_state", state),
                ("body_poses", plant.get_body_poses_output_port()),
                ("body_velocities", plant.get_body_spatial_velocities_output_port()),
                ("carried", force),
            ):
                builder.Connect(port, seal.GetInputPort(name))
            force = seal.GetOutputPort("spatial_force")
        builder.Connect(force, plant.get_applied_spatial_force_input_port())
        builder.ExportInput(servo.GetInputPort("hold"), "object.hold")
        builder.ExportOutput(servo.GetOutputPort("let_go"), "object.let_go")
        return pose

    def _show_distractor_bodies(
        self,
        builder: DiagramBuilder,
        config: StationConfig,
        scene_graph: SceneGraph,
        name: str,
        then: OutputPort | None = None,
    ) -> None:
        """Shows the bodies without contact; the carrier withdraws once it has let go.

        ``then`` is the time of an exposure at which they are shown; None for now.
        """
        if not config.distractor_bodies:
            return
        shown = add_distractor_bodies(
            *(builder, scene_graph, config.distractor_bodies),
            name=name,
            directory=self._files.name,
            first_label=self.plant.num_bodies(),  # bodies of the plant have their index
        )
        servo = builder.GetSubsystemByName("object_servo")
        builder.Connect(servo.GetOutputPort("let_go"), shown.GetInputPort("let_go"))
        if then is not None:
            builder.Connect(then, shown.GetInputPort("time"))

    def _export_cameras(
        self, builder: DiagramBuilder, config: StationConfig, obj: RigidObject, present: Scene
    ) -> None:
        """Lets the cameras render from scene graphs of their own, one for each schedule.

        A scene graph moves what its renderers show at every step of the plant. These, fed from the
        state of the simulated plant, or from what that was at the exposure, move it only when
        somebody reads an image.
        """
        self._camera_plants: list[MultibodyPlant] = []
        scenes: dict[Timing | None, Scene] = {}
        for index, (name, camera) in enumerate(config.cameras.items()):
            timing = Timing.of(camera)
            if timing not in scenes:
                scenes[timing] = self._add_scene(builder, config, obj, timing, present)
            camera = copy.deepcopy(camera)  # the caller's stays as it is
            camera.name = name
            export_camera(
                *(builder, camera, scenes[timing], present.position),
                noise=config.camera_noise.get(name),
                hand_eye=config.hand_eye.get(name),
                seed=config.noise_seed + 2**32 * index,  # cameras err differently
            )

    def _add_scene(
        self,
        builder: DiagramBuilder,
        config: StationConfig,
        obj: RigidObject,
        timing: Timing | None,
        present: Scene,
    ) -> Scene:
        """The scene that cameras of one schedule render; the present one without a schedule."""
        number = len(self._camera_plants) or ""
        plant = MultibodyPlant(config.plant.time_step)
        graph = builder.AddNamedSystem(f"camera_scene_graph{number}", SceneGraph())
        plant.RegisterAsSourceForSceneGraph(graph)
        self._add_models(plant, config, obj)
        plant.Finalize()
        self._camera_plants.append(plant)
        state = self.plant.get_state_output_port()
        scene = present._replace(graph=graph, plant=plant)
        if timing is not None:
            zero = np.zeros(config.arm.joints)
            context = plant.CreateDefaultContext()
            start = plant.GetPositionsAndVelocities(context)
            sensors, fingers = map(builder.GetSubsystemByName, ("joint_sensors", "gripper_state"))
            object_state = self.plant.get_state_output_port(self.object_instance)
            (state, body, q, position, gripper_state), stamp = add_exposures(
                builder,
                f"exposures{number}",
                timing,
                (state, start),
                (object_state, plant.GetPositionsAndVelocities(context, self.object_instance)),
                (present.position, zero),
                (sensors.GetOutputPort("position_measured"), zero),
                (fingers.get_output_port(0), np.zeros(2)),
            )
            pose = add_connected(builder, f"exposed_object{number}", _BodyState(), body)
            scene = scene._replace(
                object_pose=pose.GetOutputPort("object_pose"),
                position=q,
                stamp=stamp,
                measured={"position": position, "gripper_state": gripper_state},
            )
        poses = MultibodyPositionToGeometryPose(plant, True)
        add_connected(builder, f"camera_geometry_poses{number}", poses, state)
        builder.Connect(poses.get_output_port(), graph.get_source_pose_port(plant.get_source_id()))
        name = f"camera_distractor_bodies{number}"
        self._show_distractor_bodies(builder, config, graph, name, scene.stamp)
        return scene
