"""Perception and planning stages in separate processes: construction and proxies."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import Adder

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.fault import PerceptionLate
from feasigrasp.models.objects.tracking import TrackerKind
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.scenario.files import dump_scenario, parse_scenario
from feasigrasp.scenario.parts import Part
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import (
    make_foreground_segmentation,
    make_grasp_sampler,
    make_object_pixels,
    make_part,
    make_reachability,
    make_scene,
)
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene
from feasigrasp.systems.ports import add_connected, declare_output
from feasigrasp.systems.remote.remote_stage import RemoteStage
from feasigrasp.systems.remote.served import inputs_of, outputs_of
from feasigrasp.systems.wiring import CAMERA

#: After this time a tracked pose is there, where the cell is simulated [s]. Source: guessed.
PROMPT_LATENCY = 0.02


def make_object_stage(text: str) -> Diagram:
    """From the object's points to its field and its grasps, for the scenario of a YAML text.

    It has the ports of the scenario's perception, and ``grasps``.
    """
    scenario = parse_scenario(text)
    reachability = make_reachability(scenario)
    builder = DiagramBuilder()
    perception = make_part(Part.PERCEPTION, scenario, reachability)
    builder.AddNamedSystem("perception", perception)
    sampler = make_grasp_sampler(
        *(scenario, make_part(Part.SAMPLER, scenario, reachability), reachability.gripper),
        # `Served` does what is due at the very instants of the posts.
        period=_object_period(scenario),
    )
    add_connected(builder, "sampler", sampler, gpdf=perception.GetOutputPort("gpdf"))
    for given in inputs_of(perception):
        builder.ExportInput(given, given.get_name())
    for output in (*outputs_of(perception), sampler.get_output_port()):
        builder.ExportOutput(output, output.get_name())
    return builder.Build()


def make_scene_stage(text: str, labels: Iterable[int]) -> PointCloudToScene:
    """The scene fusion of all pixels but those of some labels, from a scenario as text."""
    scenario = parse_scenario(text)
    return make_scene(scenario, load_gripper(scenario.gripper), labels)


def make_planner_stage(text: str) -> Diagram:
    """From what the controller is given to its ``plan``, for the scenario of a YAML text."""
    scenario = parse_scenario(text)
    reachability = make_reachability(scenario)
    builder = DiagramBuilder()
    controller = make_part(Part.CONTROLLER, scenario, reachability)
    builder.AddNamedSystem("controller", controller)
    for given in inputs_of(controller):
        if given.get_name() not in ("plan", "static_obstacles"):  # plans do without these
            builder.ExportInput(given, given.get_name())
    plan = declare_output(controller, "plan", controller.memory, controller.memory_tickets)
    builder.ExportOutput(plan, "plan")
    return builder.Build()


def make_tracker_stage(text: str) -> Diagram:
    """From images of the cell to the ``track`` of the object, for the scenario of a YAML text."""
    scenario = parse_scenario(text)
    reachability = make_reachability(scenario)
    builder = DiagramBuilder()
    tracker = builder.AddNamedSystem("tracker", make_part(Part.TRACKER, scenario, reachability))
    tracked = {
        "object_pose": tracker.GetOutputPort("pose_at_view"),
        "tracking": tracker.GetOutputPort("tracking"),
    }
    prefixes: dict[System, str] = {}
    cameras = {"": scenario.perception.camera, "second_": scenario.perception.second_camera}
    for prefix, name in cameras.items():
        if not name:
            continue
        foreground = make_foreground_segmentation(scenario, reachability.gripper, name)
        # One by a mask function does not read the track.
        given = {key: port for key, port in tracked.items() if foreground.HasInputPort(key)}
        add_connected(builder, f"{prefix}foreground", foreground, **given)
        labels = foreground.GetOutputPort("label_image")
        segmentation = make_object_pixels(scenario, name)
        add_connected(builder, f"{prefix}segmentation", segmentation, label_image=labels)
        cloud = segmentation.GetOutputPort("point_cloud")
        builder.Connect(cloud, tracker.GetInputPort(f"{prefix}point_cloud"))
        prefixes |= {foreground: prefix, segmentation: prefix}
    exported: set[str] = set()
    for system in (*prefixes, tracker):
        for port in inputs_of(system):
            name = port.get_name()
            if builder.IsConnectedOrExported(port) or name == "track":
                continue
            if name in CAMERA:
                name = prefixes.get(system, "") + name
            if name in exported:
                builder.ConnectInput(name, port)
            else:
                builder.ExportInput(port, name)
                exported.add(name)
    builder.ExportOutput(tracker.GetOutputPort("track"), "track")
    return builder.Build()


def remote_object(scenario: Scenario, simulated: bool) -> RemoteStage:
    """The proxy of `make_object_stage`; in a cell that is ``simulated`` it takes its latency.

    Raises:
        ScenarioError: A fault of the scenario lies within it.
    """
    if any(isinstance(fault, PerceptionLate) for fault in scenario.faults):
        raise ScenarioError(
            "!PerceptionLate delays what happens inside of perception.execution: processes; give "
            "perception: {execution: inline}, or a perception.latency"
        )
    times = _object_period(scenario), _after_image(scenario)
    return _remote(scenario, simulated, make_object_stage, *times)


def _object_period(scenario: Scenario) -> float:
    """Time between posts to `make_object_stage` [s]."""
    camera = scenario.tracker.kind == TrackerKind.CAMERA
    return scenario.tracker.image_period if camera else scenario.perception.period


def remote_scene(scenario: Scenario, simulated: bool, labels: Iterable[int]) -> RemoteStage:
    """The proxy of `make_scene_stage`."""
    times, known = (scenario.scene.period, _after_image(scenario)), sorted(set(labels))
    return _remote(scenario, simulated, make_scene_stage, *times, labels=known)


def remote_tracker(scenario: Scenario, simulated: bool) -> RemoteStage:
    """The proxy of `make_tracker_stage`."""
    period = scenario.tracker.image_period
    return _remote(scenario, simulated, make_tracker_stage, period, PROMPT_LATENCY)


def remote_planner(scenario: Scenario, simulated: bool, period: float) -> RemoteStage:
    """The proxy of `make_planner_stage`, for a controller that plans every ``period`` [s]."""
    time = scenario.control.planning_time or PROMPT_LATENCY
    return _remote(scenario, simulated, make_planner_stage, period, time)


def _after_image(scenario: Scenario) -> float:
    """From an image, which is there that late, until what is made of it is there [s]."""
    config = scenario.perception
    late = scenario.cameras[config.camera].output_delay
    return max(config.latency - late, min(config.latency, PROMPT_LATENCY))


def add_lapsed(builder: DiagramBuilder) -> None:
    """Adds ``lapsed``, greater than 0 (V1) while one of the processes is gone, if there are any."""
    stages = [system for system in builder.GetSystems() if isinstance(system, RemoteStage)]
    if stages:
        lapsed = (stage.GetOutputPort("lapsed") for stage in stages)
        add_connected(builder, "lapsed", Adder(len(stages), 1), *lapsed)


def _remote(
    scenario: Scenario,
    simulated: bool,
    make: Callable[..., System],
    period: float,
    latency: float,
    **options: Any,
) -> RemoteStage:
    """What ``make`` makes of the scenario; the latency counts where the cell is simulated."""
    made = partial(make, dump_scenario(scenario), **options)
    return RemoteStage(made, period, latency=latency if simulated else None)
