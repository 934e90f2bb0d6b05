"""The systems of the diagram, in the order of `feasigrasp.systems.wiring`."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort, System
from pydrake.systems.primitives import (
    ConstantValueSource,
    LogVectorOutput,
    PassThrough,
    ZeroOrderHold,
)

from feasigrasp.errors import ScenarioError
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.objects.tracking import TrackerKind
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.scenario.parts import Part, make_named
from feasigrasp.scenario.schema import Execution, Scenario, Segmentation
from feasigrasp.systems.from_scenario import (
    make_camera,
    make_drive,
    make_foreground_segmentation,
    make_grasp_sampler,
    make_object_pixels,
    make_reachability_filter,
    make_scene,
    make_static_grid,
)
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.metrics import SAMPLE_PERIOD, Metrics, TrueFrame
from feasigrasp.systems.monitoring.camera_pictures import CameraPictures
from feasigrasp.systems.monitoring.contact_sense import ContactSense
from feasigrasp.systems.monitoring.meshcat_view import GraspVisualizer, add_scene
from feasigrasp.systems.monitoring.status_monitor import StatusMonitor
from feasigrasp.systems.object_tracker import MotionPredictor
from feasigrasp.systems.reachability_filter import PayloadFilter, SceneFilter
from feasigrasp.systems.segmentation.foreground_segmentation import MaskFn
from feasigrasp.systems.segmentation.segment_point_cloud import SegmentPointCloud
from feasigrasp.systems.stages.delay import Delay
from feasigrasp.systems.stages.faults import FaultInjection
from feasigrasp.systems.stages.remote import add_lapsed, remote_scene, remote_tracker
from feasigrasp.systems.station.camera import is_on_arm
from feasigrasp.systems.station.exposures import PoseAt
from feasigrasp.systems.station.object_contact import ObjectContact, ObstacleDistance
from feasigrasp.systems.station.station import Station
from feasigrasp.systems.wiring import connect_all


@dataclass(frozen=True, eq=False)
class Cell:
    """The robot cell, and the builder that holds it and the systems that are added.

    Attributes:
        builder: The builder.
        scenario: What is built, resolved.
        gripper: The hand.
        arm: The arm.
        station: The cell.
        mask: The function that segments images; None for what the scenario says.
        signals: Sources that the table of connections names by one word. ``measured_pose``,
            ``cloud``, ``depth``, ``labels``, ``field`` and ``velocity`` are ports behind the
            scenario's faults; ``exposed`` is when the last view was taken; ``color``,
            ``second_color``, ``hand_camera``, ``hand_phase`` and ``remote_stamp`` are there where
            this scenario needs them.
    """

    builder: DiagramBuilder
    scenario: Scenario
    gripper: Gripper
    arm: Arm
    station: Station
    mask: MaskFn | None = None
    signals: dict[str, OutputPort] = field(default_factory=dict)

    @property
    def faults(self) -> FaultInjection:
        """Source of the scenario's faults."""
        return FaultInjection(self.builder, self.scenario)

    @property
    def simulated(self) -> bool:
        """Whether the cell is simulated, and its time with it."""
        return isinstance(self.station, Station)

    @property
    def masked(self) -> bool:
        """Whether a mask function segments images."""
        return self.mask is not None or Part.SEGMENTATION in self.scenario.parts

    @property
    def remote(self) -> bool:
        """Whether perception works in separate processes."""
        chosen = self.scenario.perception.execution
        return chosen == Execution.PROCESSES or (chosen == Execution.AUTO and not self.simulated)

    def port(self, name: str) -> OutputPort | None:
        """The station's output of that name, if it has one."""
        return self.station.GetOutputPort(name) if self.station.HasOutputPort(name) else None

    def camera_port(self, name: str, *, second: bool = False) -> OutputPort | None:
        """A port of perception's camera, or of its second one, if there is one."""
        config = self.scenario.perception
        return self.port(f"{config.second_camera if second else config.camera}.{name}")

    def late(self, initial: Any) -> LeafSystem:
        """Hands on values as late as grasps are, and ``initial`` until one arrives.

        Only in simulation, inline: elsewhere what is perceived takes the time that it takes.
        """
        latency = self.scenario.perception.latency
        if self.remote or not self.simulated or latency == 0.0:
            vector = isinstance(initial, np.ndarray)
            return PassThrough(len(initial) if vector else AbstractValue.Make(initial))
        return Delay(initial, latency, self.scenario.control.period)

    def __getitem__(self, name: str) -> System:
        """The system of that name."""
        return self.builder.GetSubsystemByName(name)

    def add(self, name: str, system: System) -> System:
        """Adds a system."""
        return self.builder.AddNamedSystem(name, system)

    def signal(self, name: str, port: OutputPort | None) -> None:
        """Names a port for the table of connections, if there is one."""
        if port is not None:
            self.signals[name] = port

    def connect(self) -> None:
        """Connects what has been added."""
        config = self.scenario.perception
        cameras = {"camera": config.camera, "second": config.second_camera}
        connect_all(self.builder, self.signals, {k: name for k, name in cameras.items() if name})


def add_tracker(cell: Cell, tracker: LeafSystem) -> None:
    """Adds the object's tracker, and the predictor that the scenario names."""
    cell.add("tracker", tracker)
    if own := cell.scenario.parts.get(Part.PREDICTOR):
        predict = make_named(Part.PREDICTOR, own, cell.scenario.tracker)
        cell.add("predictor", MotionPredictor(predict))
    if tracker.HasInputPort("pose"):
        cell.signal("measured_pose", cell.faults.pose(cell.station.GetOutputPort("object.pose")))


def add_perception(
    cell: Cell,
    field: LeafSystem,
    sampler: GraspSamplerFn | None = None,
    *,
    tracks_elsewhere: bool = False,
) -> None:
    """Adds what leads from the camera's image to grasps on the object.

    Args:
        cell: The cell.
        field: What fits a field to the points.
        sampler: From the field to grasps; None where ``field`` puts out grasps as well.
        tracks_elsewhere: Whether the tracker, which looks at images that are segmented by their
            depth, does so in another process.

    Raises:
        ScenarioError: The tracker lacks an output port.
    """
    station, config, tracker = cell.station, cell.scenario.perception, cell["tracker"]
    needed = ("object_pose", "object_velocity", *["keyframe"] * field.HasInputPort("keyframe"))
    if missing := [name for name in needed if not tracker.HasOutputPort(name)]:
        raise ScenarioError(
            f"the tracker, a {type(tracker).__name__}, has no output port {' or '.join(missing)}; "
            "derive it from ObjectTracker, with tracker: {kind: camera} from FieldTracker"
        )
    cloud, labels, camera_pose = (
        station.GetOutputPort(f"{config.camera}.{name}")
        for name in ("point_cloud", "label_image", "pose")
    )
    label, no_scene = station.object_label, station.robot_and_object_labels()
    depth, cloud = cell.faults.depth(cell.camera_port("depth_image"), cloud, camera_pose)
    cell.signal("depth", depth)
    cell.signal("cloud", cell.faults.cloud(cloud, labels, camera_pose, label))
    by_depth = config.segmentation == Segmentation.DEPTH
    if by_depth:
        no_scene = [Label.OBJECT, Label.ROBOT, Label.UNCLEAR, Label.CARRIER]
        foreground = make_foreground_segmentation(cell.scenario, cell.gripper, mask=cell.mask)
        labels = cell.add("foreground", foreground).GetOutputPort("label_image")
        segment = make_object_pixels(cell.scenario)
    else:
        segment = SegmentPointCloud(label, camera=make_camera(cell.scenario), hiding=no_scene)
    cell.signal("labels", cell.faults.mask(labels, segment.label))
    cell.add("segmentation", segment)
    cell.add("perception", field)
    if not tracker.HasOutputPort("pose_at_view") and cell.camera_port("stamp"):
        cell.add("pose_at_view", PoseAt(cell.scenario.control.period))
    if cell.remote:
        cell.signal("remote_stamp", cell.camera_port("stamp"))
    gpdf = field.GetOutputPort("gpdf")
    cell.signal("field", cell.faults.field(gpdf))
    if cell.signals["field"] is gpdf and field.HasOutputPort("view_time"):
        cell.signal("exposed", field.GetOutputPort("view_time"))
    if by_depth:
        cell.signal("color", _color_image(cell))
        if config.second_camera:
            _add_second_camera(cell, tracks_elsewhere)
        if tracks_elsewhere:
            cell.add("remote_tracker", remote_tracker(cell.scenario, cell.simulated))
    if sampler is not None:
        cell.add("sampler", make_grasp_sampler(cell.scenario, sampler, cell.gripper))
    cell.add("latency", cell.late(GraspSet.empty()))
    if cell.scenario.scene.enabled and cell.remote:
        cell.add("scene_perception", remote_scene(cell.scenario, cell.simulated, no_scene))
    elif cell.scenario.scene.enabled:
        cell.add("scene_perception", make_scene(cell.scenario, cell.gripper, no_scene))


def _add_second_camera(cell: Cell, tracks_elsewhere: bool) -> None:
    """Adds what shows the object's points in the second camera's images to the tracker."""
    cell.signal("second_color", _color_image(cell, second=True))
    if tracks_elsewhere or not cell["tracker"].HasInputPort("second_point_cloud"):
        return
    name = cell.scenario.perception.second_camera
    foreground = make_foreground_segmentation(cell.scenario, cell.gripper, name, cell.mask)
    cell.add("second_foreground", foreground)
    cell.add("second_segmentation", make_object_pixels(cell.scenario, name))


def _color_image(cell: Cell, *, second: bool = False) -> OutputPort | None:
    """A camera's color image, where a mask function or a carrier's hue needs it.

    Raises:
        ScenarioError: The cell has none.
    """
    hue, config = cell.scenario.carrier.hue, cell.scenario.perception
    if hue is None and not cell.masked:
        return None
    if port := cell.camera_port("color_image", second=second):
        return port
    camera = config.second_camera if second else config.camera
    if cell.masked:
        raise ScenarioError(
            f"parts.segmentation looks at colors, but {camera} of this cell sends none; have the "
            "camera's driver send the masks, with perception: {segmentation: labels}, see "
            "docs/hardware.md"
        )
    raise ScenarioError(
        f"carrier.hue is {hue:g}, but {camera} of this cell sends no color image; leave it out"
    )


def add_control(
    cell: Cell,
    reachability: Reachability,
    controller: LeafSystem,
    planner: LeafSystem | None = None,
) -> None:
    """Adds what leads from grasps to what arm and gripper are sent, and says what goes on.

    The ``planner`` plans for the controller; None where that does so itself.
    """
    scenario = cell.scenario
    config, safe = scenario.reachability, scenario.control.safe
    camera = scenario.cameras[scenario.perception.camera]
    sees = is_on_arm(camera) and controller.HasInputPort("camera_pose")
    looks = sees and scenario.tracker.kind == TrackerKind.CAMERA
    if sees:
        # Where images come late, a camera's `pose` is of their instant, and not of the joints'.
        cell.signal("hand_camera", cell.camera_port("pose_now") or cell.camera_port("pose"))
    if safe:
        cell.add("carrying", PayloadFilter())
    if scenario.scene.enabled:
        margin = scenario.scene.margin
        # What hits the scene either way round takes no place among those that are judged.
        either = SceneFilter(cell.gripper, margin=margin, either_way_round=True)
        cell.add("clear_grasps", either)
    cell.add("reachability", make_reachability_filter(scenario, reachability))
    if scenario.scene.enabled:
        cell.add("clear_hand_poses", SceneFilter(cell.gripper, margin=margin))
    cell.add("reachable", ZeroOrderHold(config.period, AbstractValue.Make(GraspSet.empty())))
    if planner:
        cell.add("planner", planner)
    add_lapsed(cell.builder)
    options: dict[str, Any] = {"period": config.period, "looks": looks, "gives_up": safe}
    sequencer = GripperSequencer(scenario.sequence, cell.gripper, arm=cell.arm, **options)
    cell.add("sequencer", sequencer)
    if sees:
        cell.signal("hand_phase", sequencer.GetOutputPort("phase"))
    cell.add("contact_sense", ContactSense(scenario.plant_config.time_step, cell.arm))
    cell.add("drive", make_drive(scenario))
    cell.add("controller", controller)
    if safe and cell.simulated and planner is None and isinstance(controller, GraspController):
        controller.take_time(scenario.control.planning_time)
    static = make_static_grid(scenario) if safe else None
    if static is not None and controller.HasInputPort("static_obstacles"):
        cell.add("static_obstacles", ConstantValueSource(AbstractValue.Make(static)))
    cell.signal("velocity", cell.faults.command(controller))
    measured = cell.scenario.tracker.kind != TrackerKind.CAMERA
    monitor = StatusMonitor(cell.gripper, cell.scenario.grasp, sees_slip=measured, arm=cell.arm)
    cell.add("status", monitor)


def add_measurement(cell: Cell) -> None:
    """Adds what reads the truth, and the logs of what arm and drive do."""
    if cell.scenario.tracker.kind == TrackerKind.CAMERA:  # whose frame is that of its first view
        step = cell.station.plant.time_step()
        cell.add("true_frame", TrueFrame(step))
        if cell["tracker"].HasOutputPort("stamp"):
            cell.add("true_pose_at_view", PoseAt(step))
    never = np.array([np.nan])
    cell.add("view_time(latency)", cell.late(never))
    # No `ZeroOrderHold`: of a vector it sees what is made at its ticks, of a set of grasps not yet.
    cell.add("view_time(reachable)", Delay(never, 0.0, cell.scenario.reachability.period))
    add_judges(cell)
    desired = cell["drive"].GetOutputPort("desired_state")
    LogVectorOutput(desired, cell.builder, cell.scenario.control.period).set_name("log(drive)")


def add_judges(cell: Cell) -> None:
    """Adds what a run in a simulated station is judged by, with or without pipeline; its logs."""
    station = cell.station
    metrics = cell.add("metrics", Metrics(cell.gripper, cell.arm))
    distance = ObstacleDistance(station.plant, station.robot_instances())
    cell.add("obstacle_distance", distance)
    contact = ObjectContact(station.plant, station.object_body.index(), station.robot_instances())
    cell.add("contact", contact)
    for name, port, period in (
        ("metrics", metrics.get_output_port(), SAMPLE_PERIOD),
        ("obstacle_distance", distance.get_output_port(), SAMPLE_PERIOD),
        ("arm", station.GetOutputPort("arm.state_estimated"), cell.scenario.control.period),
        # At every step of the plant, which computes them anyway; in between it would do so anew.
        ("torque", station.GetOutputPort("arm.torque_measured"), station.plant.time_step()),
        ("velocity", station.GetOutputPort("arm.velocity_estimated"), station.plant.time_step()),
    ):
        LogVectorOutput(port, cell.builder, period).set_name(f"log({name})")


def add_visualization(cell: Cell, meshcat: Meshcat) -> None:
    """Adds what shows the cell, and on the object what perception and reachability make of it."""
    add_scene(cell.builder, cell.station, meshcat)
    cell.add("visualizer", GraspVisualizer(meshcat, cell.gripper))
    cell.add("camera_pictures", CameraPictures(cell["segmentation"].label))
