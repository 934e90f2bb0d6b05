"""The whole pipeline as one diagram, from the scenario that describes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, OutputPort, System
from pydrake.systems.primitives import LogVectorOutput, PassThrough, ZeroOrderHold

from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.objects.tracker_config import TrackerKind
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.scenario.presets import resolve
from feasigrasp.scenario.sampling import make_hand_error
from feasigrasp.scenario.schema import Scenario, Segmentation
from feasigrasp.systems.carry_filter import CarryFilter
from feasigrasp.systems.faults.injection import FaultInjection
from feasigrasp.systems.from_scenario import (
    make_controller,
    make_field_tracker,
    make_foreground_segmentation,
    make_reachability_filter,
    make_scenario_sampler,
    make_station,
)
from feasigrasp.systems.grasp_sampler import GraspSampler
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.metrics import SAMPLE_PERIOD, Metrics
from feasigrasp.systems.monitoring.camera_pictures import CameraPictures
from feasigrasp.systems.monitoring.contact_sense import ContactSense
from feasigrasp.systems.monitoring.grasp_visualizer import GraspVisualizer
from feasigrasp.systems.monitoring.status_monitor import StatusMonitor
from feasigrasp.systems.monitoring.true_frame import TrueFrame
from feasigrasp.systems.object_tracker import ObjectTracker
from feasigrasp.systems.point_cloud_to_gpdf import PointCloudToGPDF
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene
from feasigrasp.systems.scene_filter import SceneFilter
from feasigrasp.systems.segmentation.segment_point_cloud import SegmentPointCloud
from feasigrasp.systems.station.cell_check import check_cell
from feasigrasp.systems.station.meshcat_scene import add_scene
from feasigrasp.systems.station.object_contact import ObjectContact
from feasigrasp.systems.station.obstacle_distance import ObstacleDistance
from feasigrasp.systems.station.pose_at import PoseAt
from feasigrasp.systems.station.station import Station
from feasigrasp.systems.tracking.keyframes_to_gpdf import KeyframesToGPDF
from feasigrasp.systems.velocity_drive import VelocityDrive


@dataclass(frozen=True, eq=False)
class _Cell:
    """What all stages share: the robot cell and the builder that holds it."""

    builder: DiagramBuilder
    scenario: Scenario
    gripper: ParallelGripper
    station: Station

    def port(self, name: str) -> OutputPort | None:
        """The station's output of that name, if it has one."""
        return self.station.GetOutputPort(name) if self.station.HasOutputPort(name) else None

    @property
    def faults(self) -> FaultInjection:
        """Where the scenario's faults come from."""
        return FaultInjection(self.builder, self.scenario)

    def __getitem__(self, name: str) -> System:
        """The system of that name."""
        return self.builder.GetSubsystemByName(name)

    def source(self, name: str, port: str) -> OutputPort:
        """What an input port of the system of that name is connected to."""
        system = self[name]
        index = system.GetInputPort(port).get_index()
        source, number = self.builder.connection_map()[system, index]
        return source.get_output_port(number)

    def add(self, name: str, system: System, *sources: System, **inputs: OutputPort) -> System:
        """Adds a system, its inputs connected as `connect` does."""
        self.builder.AddNamedSystem(name, system)
        self.connect(system, *sources, **inputs)
        return system

    def connect(self, system: System, *sources: System, **inputs: OutputPort) -> None:
        """Connects inputs: those named as told, others to the first source with that output."""
        for port in map(system.get_input_port, range(system.num_input_ports())):
            name = port.get_name()
            for source in sources:
                if name not in inputs and source.HasOutputPort(name):
                    inputs[name] = source.GetOutputPort(name)
        for name, output in inputs.items():
            self.builder.Connect(output, system.GetInputPort(name))


def make_dynamic_grasp(
    scenario: Scenario,
    meshcat: Meshcat | None = None,
    *,
    sampler: GraspSamplerFn | None = None,
    controller: LeafSystem | None = None,
    station: Diagram | None = None,
) -> Diagram:
    """Builds station, perception, grasp sampling, reachability, control and metrics.

    The subsystems are named ``station``, ``segmentation``, ``perception``, ``sampler``,
    ``latency``, ``carrying`` (in mode ``safe``), ``reachability``, ``reachable``, ``sequencer``,
    ``controller``, ``drive``, ``tracker``, ``metrics``, ``obstacle_distance``, ``contact``,
    ``contact_sense``, ``seen_at(latency)``, ``seen_at(reachable)`` and ``status``. The vector logs
    ``log(metrics)`` and ``log(obstacle_distance)`` hold their samples, ``log(drive)`` and
    ``log(arm)`` the commanded and the true state of the arm at the control rate, ``log(torque)``
    the torques of its motors at every step of the plant. With a Meshcat there are
    ``scene``, ``visualizer`` and ``camera_pictures`` as well; with a scene field
    ``scene_perception``, ``clear_grasps`` and ``clear_hand_poses``; with faults systems that
    `FaultInjection` adds.

    A port of any of them can be read while a simulator runs, and a log when it has run::

        drive = diagram.GetSubsystemByName("drive")
        drive.GetOutputPort("desired_state").Eval(drive.GetMyContextFromRoot(root_context))
        log = diagram.GetSubsystemByName("log(drive)").FindLog(root_context)

    Systems and logs of your own are added with `add_dynamic_grasp`.

    Args:
        scenario: What to build.
        meshcat: Where to show it; with the completed cloud and the grasps on the object.
        sampler: From a field of the object to its grasps; the scenario's unless given.
        controller: A system with the ports of `GraspController`, of the optional ones as many as
            it likes; the scenario's unless given. What else it has is connected where tracker,
            sequencer or drive have an output of that name.
        station: A cell with the ports of `Station`; the scenario's, simulated, unless given. One
            that is not simulated, such as `HardwareStation`, has no ports of truth: then nothing
            that measures it is built.
    """
    builder = DiagramBuilder()
    add_dynamic_grasp(
        builder, scenario, meshcat, sampler=sampler, controller=controller, station=station
    )
    diagram = builder.Build()
    diagram.set_name("dynamic_grasp")
    return diagram


def add_dynamic_grasp(
    builder: DiagramBuilder,
    scenario: Scenario,
    meshcat: Meshcat | None = None,
    *,
    sampler: GraspSamplerFn | None = None,
    controller: LeafSystem | None = None,
    station: Diagram | None = None,
) -> None:
    """Adds what `make_dynamic_grasp` is made of to a builder; the arguments are the same.

    For example with a log of the commanded velocity::

        builder = DiagramBuilder()
        add_dynamic_grasp(builder, scenario)
        drive = builder.GetSubsystemByName("drive")
        log = LogVectorOutput(drive.GetOutputPort("desired_velocity"), builder, 0.01)
        simulator = Simulator(builder.Build())
        simulator.AdvanceTo(5.0)
        velocities = log.FindLog(simulator.get_context()).data()
    """
    gripper, scenario = ParallelGripper(), resolve(scenario)
    reachability = Reachability(gripper)
    hand_error = np.eye(4) if station else make_hand_error(scenario)
    station = builder.AddNamedSystem("station", station or make_station(scenario))
    check_cell(station.plant, gripper, hand_error=hand_error)
    cell = _Cell(builder, scenario, gripper, station)
    if scenario.tracker.kind == TrackerKind.CAMERA:
        builder.AddNamedSystem("tracker", make_field_tracker(scenario))
    else:
        measured = cell.faults.pose(station.GetOutputPort("object.pose"))
        stamp = _given(stamp=cell.port("object.stamp"))
        cell.add("tracker", ObjectTracker(scenario.tracker), pose=measured, **stamp)
    gpdf = _add_perception(cell, sampler or make_scenario_sampler(scenario, gripper))
    _add_control(cell, reachability, controller or make_controller(scenario, reachability), gpdf)
    _add_status(cell)
    if isinstance(station, Station):
        _add_measurement(cell)
    if meshcat is not None:
        _add_visualization(cell, meshcat)


def _add_perception(cell: _Cell, sampler: GraspSamplerFn) -> OutputPort:
    """Camera -> object's points -> distance field, which it returns -> grasps, all in O."""
    station, config, scene_config = cell.station, cell.scenario.perception, cell.scenario.scene
    cloud, labels, camera_pose = (
        station.GetOutputPort(f"{config.camera}.{name}")
        for name in ("point_cloud", "label_image", "pose")
    )
    label, no_scene = station.object_label, station.robot_and_object_labels()
    cloud = cell.faults.cloud(cloud, labels, camera_pose, label)
    if config.segmentation == Segmentation.DEPTH:
        label, no_scene = Label.OBJECT, [Label.OBJECT, Label.ROBOT, Label.UNCLEAR]
        foreground = make_foreground_segmentation(cell.scenario, cell.gripper)
        labels = cell.builder.AddNamedSystem("foreground", foreground).get_output_port()
    images = {"point_cloud": cloud, "label_image": cell.faults.mask(labels, label)}
    segmentation = cell.add("segmentation", SegmentPointCloud(label), **images)
    field = cell.add("perception", _make_perception(cell.scenario))
    seen_pose = _pose_at_view(cell)
    if cell.scenario.tracker.kind == TrackerKind.CAMERA:
        cell.connect(field, cell["tracker"])
        image = {
            "depth_image": cell.port(f"{config.camera}.depth_image"),
            "image_time": cell.port(f"{config.camera}.stamp"),
        }
        sources = segmentation, field
        cell.connect(cell["tracker"], *sources, camera_pose=camera_pose, **_given(**image))
    else:
        tracking = cell["tracker"].GetOutputPort("tracking")
        poses = {"camera_pose": camera_pose, "object_pose": seen_pose}
        cell.connect(field, segmentation, tracking=tracking, **poses)
    gpdf = cell.faults.field(field.GetOutputPort("gpdf"))
    if config.segmentation == Segmentation.DEPTH:
        cell.connect(
            foreground,
            cell["tracker"],
            object_pose=seen_pose,
            point_cloud=cloud,
            camera_pose=camera_pose,
            position=cell.port(f"{config.camera}.position") or cell.port("iiwa.position_measured"),
            gripper_state=station.GetOutputPort("gripper.state_measured"),
            gpdf=gpdf,
        )
    checks = cell.gripper if config.filter else None
    sampling = GraspSampler(sampler, checks, mass=cell.scenario.object.mass)
    grasps = cell.add("sampler", sampling, gpdf=gpdf)
    latency = _late(AbstractValue.Make(GraspSet.empty()), config.period, config.latency)
    cell.add("latency", latency, u=grasps.get_output_port())
    if scene_config.enabled:
        scene = PointCloudToScene(
            no_scene,
            gripper=cell.gripper,
            period=scene_config.period,
            resolution=scene_config.resolution,
        )
        position = station.GetOutputPort("iiwa.position_measured")
        cell.add("scene_perception", scene, camera_pose=camera_pose, position=position, **images)
    return gpdf


def _make_perception(scenario: Scenario) -> LeafSystem:
    """What merges views: those of every period, or those that the camera's tracker picks."""
    config, tracker = scenario.perception, scenario.tracker
    camera = tracker.kind == TrackerKind.CAMERA
    make = KeyframesToGPDF if camera else PointCloudToGPDF
    return make(
        tracker.image_period if camera else config.period,
        preset=config.preset,
        max_points=config.max_points,
        length_scale=config.length_scale,
        voxel_size=config.voxel_size,
        hidden_side=config.hidden_side,
        max_views=config.views,
    )


def _pose_at_view(cell: _Cell) -> OutputPort:
    """The object's pose when the image was taken, which is now where images have no stamp."""
    pose = cell["tracker"].GetOutputPort("object_pose")
    stamp = cell.port(f"{cell.scenario.perception.camera}.stamp")
    if stamp is None:
        return pose
    seen = PoseAt(cell.scenario.control.period)
    return cell.add("pose_at_view", seen, pose=pose, stamp=stamp).get_output_port()


def _given(**ports: OutputPort | None) -> dict[str, OutputPort]:
    """Those of the ports that there are."""
    return {name: port for name, port in ports.items() if port is not None}


def _clear_of_scene(cell: _Cell, name: str, grasps: OutputPort, **options: bool) -> OutputPort:
    """The grasps at which the open hand is clear of the scene; all if nobody looks at it."""
    config = cell.scenario.scene
    if not config.enabled:
        return grasps
    clear = SceneFilter(cell.gripper, margin=config.margin, **options)
    sources = cell["tracker"], cell["scene_perception"]
    return cell.add(name, clear, *sources, grasps=grasps).get_output_port()


def _add_control(
    cell: _Cell, reachability: Reachability, controller: LeafSystem, gpdf: OutputPort
) -> None:
    """Grasps -> those in reach -> sequencer -> controller -> drive -> arm and gripper."""
    station, tracker, scenario = cell.station, cell["tracker"], cell.scenario
    config, safe = scenario.reachability, scenario.control.safe
    grasps = cell["latency"].get_output_port()
    if safe:
        grasps = cell.add("carrying", CarryFilter(), tracker, grasps=grasps).get_output_port()
    # What hits the scene either way round takes no place among those that are judged.
    grasps = _clear_of_scene(cell, "clear_grasps", grasps, either_way_round=True)
    in_reach = make_reachability_filter(scenario, reachability)
    cell.add("reachability", in_reach, tracker, grasps=grasps)
    hand_poses = _clear_of_scene(cell, "clear_hand_poses", in_reach.GetOutputPort("grasps"))
    reachable = ZeroOrderHold(config.period, AbstractValue.Make(GraspSet.empty()))
    cell.add("reachable", reachable, u=hand_poses)

    position = station.GetOutputPort("iiwa.position_measured")
    sequencer = cell.add(
        "sequencer",
        GripperSequencer(scenario.grasp, cell.gripper, period=config.period),
        tracker,
        **({"gpdf": gpdf} if safe else {}),
        perceived=cell["perception"].GetOutputPort("perceived"),
        position=position,
        grasps=reachable.get_output_port(),
        gripper_state=station.GetOutputPort("gripper.state_measured"),
    )
    sense = cell.add(
        "contact_sense",
        ContactSense(scenario.plant_config.time_step),
        sequencer,
        torque_external=station.GetOutputPort("iiwa.torque_external"),
    )
    drive = VelocityDrive(scenario.control.period, enforce_limits=safe)
    cell.builder.AddNamedSystem("drive", drive)
    scene = [cell["scene_perception"]] if scenario.scene.enabled else []
    cell.add("controller", controller, sequencer, tracker, drive, sense, *scene, position=position)
    cell.connect(drive, velocity=cell.faults.command(controller), position=position)
    for name, port in (
        ("iiwa.desired_state", drive.GetOutputPort("desired_state")),
        ("gripper.position", sequencer.GetOutputPort("gripper_position")),
        ("object.hold", sequencer.GetOutputPort("object_hold")),
    ):
        if station.HasInputPort(name):
            cell.builder.Connect(port, station.GetInputPort(name))


def _add_status(cell: _Cell) -> None:
    scene = ["scene_perception"] if cell.scenario.scene.enabled else []
    cell.add(
        "status",
        StatusMonitor(cell.gripper),
        *(cell[name] for name in ("tracker", "perception", "drive", "sequencer", *scene)),
        cell["contact_sense"],
        position=cell.station.GetOutputPort("iiwa.position_measured"),
        grasps=cell["latency"].get_output_port(),
        verdicts=cell["reachability"].GetOutputPort("verdicts"),
        reachable=cell["sequencer"].GetOutputPort("grasps"),
    )


def _add_measurement(cell: _Cell) -> None:
    station, control_period = cell.station, cell.scenario.control.period
    state = station.GetOutputPort("iiwa.state_estimated")
    pose = station.GetOutputPort("object.pose")
    distance = ObstacleDistance(station.plant, station.robot_instances())
    metrics = Metrics(cell.gripper)
    frame: dict[str, OutputPort] = {}
    if cell.scenario.tracker.kind == TrackerKind.CAMERA:  # whose frame is that of its first view
        tracked = cell["tracker"].GetOutputPort("object_pose")
        judge = cell.add("true_frame", TrueFrame(), object_pose=pose, tracked_pose=tracked)
        frame["frame_pose"] = judge.get_output_port()
    cell.add(
        "metrics",
        metrics,
        cell["sequencer"],
        **frame,
        state=state,
        object_pose=pose,
        sampled_grasps=cell["latency"].get_output_port(),
        seen_at=_as_late_as_the_grasps(cell, cell["perception"].GetOutputPort("seen_at")),
    )
    cell.add("obstacle_distance", distance, station)
    contact = ObjectContact(station.plant, station.object_body.index(), station.robot_instances())
    cell.add("contact", contact, station, cell["sequencer"])
    for name, port, period in (
        ("metrics", metrics.get_output_port(), SAMPLE_PERIOD),
        ("obstacle_distance", distance.get_output_port(), SAMPLE_PERIOD),
        ("drive", cell["drive"].GetOutputPort("desired_state"), control_period),
        ("arm", state, control_period),
        # At every step of the plant, which computes them anyway; in between it would do so anew.
        ("torque", station.GetOutputPort("iiwa.torque_measured"), station.plant.time_step()),
    ):
        LogVectorOutput(port, cell.builder, period).set_name(f"log({name})")


def _late(value: AbstractValue | int, period: float, latency: float) -> LeafSystem:
    """Hands on a value of that kind, or a vector of that size, every period, after a latency."""
    # A hold that samples with the camera would see what there was before the view.
    return ZeroOrderHold(period, value, latency) if latency > 0.0 else PassThrough(value)


def _as_late_as_the_grasps(cell: _Cell, seen_at: OutputPort) -> OutputPort:
    """The time of a view, held back as the grasps are on their way to the controller."""
    perception, period = cell.scenario.perception, cell.scenario.reachability.period
    late = cell.add("seen_at(latency)", _late(1, perception.period, perception.latency), u=seen_at)
    held = cell.add("seen_at(reachable)", ZeroOrderHold(period, 1), u=late.get_output_port())
    return held.get_output_port()


def _add_visualization(cell: _Cell, meshcat: Meshcat) -> None:
    """Shows the cell, and on the object what perception and reachability make of it."""
    object_path = add_scene(cell.builder, cell.station, meshcat)
    cell.add(
        "visualizer",
        GraspVisualizer(meshcat, object_path, cell.gripper),
        cell["perception"],
        cell["sequencer"],
        grasps=cell["latency"].get_output_port(),
        reachable=cell["sequencer"].GetOutputPort("grasps"),
    )
    camera = cell.scenario.perception.camera
    cell.add(
        "camera_pictures",
        CameraPictures(int(cell.station.object_body.index())),
        color_image=cell.station.GetOutputPort(f"{camera}.color_image"),
        label_image=cell.source("segmentation", "label_image"),
    )
