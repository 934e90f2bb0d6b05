"""The whole pipeline as one diagram, from the scenario that describes it."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import LogVectorOutput, ZeroOrderHold

from feasigrasp.models.control.joint.law import JointControlOptions
from feasigrasp.models.control.joint.search import SolutionOptions
from feasigrasp.models.control.planning.prices import Prices
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.control.task.choice import ChoiceOptions
from feasigrasp.models.control.task.safe_law import TaskControlOptions
from feasigrasp.models.geometry.sphere import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.samplers import make_sampler
from feasigrasp.models.objects.rigid_object import RigidObject, load_object
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.scenario.sampling import make_camera_noise, make_motion
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.gp_joint_controller import GPJointController
from feasigrasp.systems.grasp_sampler import GraspSampler
from feasigrasp.systems.grasp_visualizer import GraspVisualizer
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.meshcat_scene import add_scene
from feasigrasp.systems.metrics import SAMPLE_PERIOD, Metrics
from feasigrasp.systems.object_tracker import ObjectTracker
from feasigrasp.systems.obstacle_distance import ObstacleDistance
from feasigrasp.systems.point_cloud_to_gpdf import PointCloudToGPDF
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene, SceneFilter
from feasigrasp.systems.reachability_filter import ReachabilityFilter
from feasigrasp.systems.rmm_task_controller import RMMTaskController
from feasigrasp.systems.segment_point_cloud import SegmentPointCloud
from feasigrasp.systems.station.station import Station, StationConfig
from feasigrasp.systems.velocity_drive import VelocityDrive

#: Period of the metrics' log [s].
LOG_PERIOD = SAMPLE_PERIOD


def load_scenario_object(scenario: Scenario) -> RigidObject:
    """The object that a scenario names, built-in or from a mesh file."""
    config = scenario.object
    return load_object(config.model, scale=config.scale, mass=config.mass)


def make_station(scenario: Scenario) -> Station:
    """The robot cell of a scenario, with its moving object."""
    safe = scenario.control.mode == "safe"
    return Station(
        StationConfig(
            plant=scenario.plant_config,
            directives=scenario.directives,
            cameras=scenario.cameras,
            camera_noise=make_camera_noise(scenario),
            noise_seed=scenario.random_seed,
            q_start=np.deg2rad(scenario.q_start),
            friction=scenario.object.friction,
            enforce_constraints=safe,
            touch_object=safe or scenario.grasp.close,
        ),
        load_scenario_object(scenario),
        make_motion(scenario),
    )


def make_controller(scenario: Scenario, reachability: Reachability) -> LeafSystem:
    """The controller of a scenario; both kinds have the same ports."""
    mode, period = scenario.control.mode, scenario.reachability.period
    safety = SafetyOptions(period=scenario.control.period)
    if scenario.control.controller == "joint":
        solutions = SolutionOptions(source=scenario.control.source)
        prices = Prices.of_a_field(1.5 if scenario.grasp.close else 3.0)
        options = JointControlOptions(solutions=solutions, prices=prices, safety=safety)
        return GPJointController(reachability, options, solution_period=period, mode=mode)
    choice = ChoiceOptions(Prices.to_grasp_soon() if scenario.grasp.close else Prices())
    return RMMTaskController(
        reachability,
        TaskControlOptions(choice=choice, safety=safety),
        period=period,
        mode=mode,
        seed=scenario.random_seed,
    )


def make_dynamic_grasp(scenario: Scenario, meshcat: Meshcat | None = None) -> Diagram:
    """Builds station, perception, grasp sampling, reachability, control and metrics.

    The subsystems are named ``station``, ``segmentation``, ``perception``, ``sampler``,
    ``latency``, ``reachability``, ``reachable``, ``sequencer``, ``controller``, ``drive``,
    ``tracker``, ``metrics`` and ``obstacle_distance``. The vector logs ``log(metrics)`` and
    ``log(obstacle_distance)`` hold their samples, ``log(drive)`` and ``log(arm)`` the commanded and
    the true state of the arm at the control rate. With a Meshcat there are ``scene`` and
    ``visualizer`` as well; with a scene field ``scene_perception``, ``clear_grasps`` and
    ``clear_hand_poses``.

    Args:
        scenario: What to build.
        meshcat: Where to show it; with the completed cloud and the grasps on the object.
    """
    gripper = ParallelGripper()
    reachability = Reachability(gripper)
    perception = scenario.perception
    camera = perception.camera
    empty = AbstractValue.Make(GraspSet.empty())

    builder = DiagramBuilder()
    add, connect = builder.AddNamedSystem, builder.Connect
    station = add("station", make_station(scenario))
    tracker = add("tracker", ObjectTracker(scenario.tracker))
    segmentation = add("segmentation", SegmentPointCloud(int(station.object_body.index())))
    to_gpdf = add(
        "perception",
        PointCloudToGPDF(
            perception.period,
            preset=perception.preset,
            max_points=perception.max_points,
            length_scale=perception.length_scale,
            voxel_size=perception.voxel_size,
        ),
    )
    sampling = make_sampler(
        perception.sampler,
        gripper,
        n_candidates=perception.n_candidates,
        n_grasps=perception.n_grasps,
        least_score=0.0,  # which of them are in reach decides
    )
    sampling(fit_gpdf(sphere_points(64, 0.03)))  # compiles its kernels, before the first tick
    sampler = add("sampler", GraspSampler(sampling, gripper))
    latency = add("latency", ZeroOrderHold(perception.period, empty, perception.latency))
    reach = add(
        "reachability",
        ReachabilityFilter(
            reachability,
            method=scenario.reachability.method,
            horizon=scenario.reachability.horizon,
        ),
    )
    reachable = add("reachable", ZeroOrderHold(scenario.reachability.period, empty))
    sequencer = add(
        "sequencer",
        GripperSequencer(scenario.grasp, gripper, period=scenario.reachability.period),
    )
    controller = add("controller", make_controller(scenario, reachability))
    drive = add(
        "drive",
        VelocityDrive(
            scenario.control.period, enforce_position_limits=scenario.control.mode == "safe"
        ),
    )
    metrics = add("metrics", Metrics(gripper))

    # Perception: camera -> object's points -> distance field -> grasps, all in the object frame.
    connect(station.GetOutputPort("object.pose"), tracker.GetInputPort("pose"))
    connect(
        station.GetOutputPort(f"{camera}.point_cloud"), segmentation.GetInputPort("point_cloud")
    )
    connect(
        station.GetOutputPort(f"{camera}.label_image"), segmentation.GetInputPort("label_image")
    )
    connect(segmentation.GetOutputPort("point_cloud"), to_gpdf.GetInputPort("point_cloud"))
    connect(tracker.GetOutputPort("object_pose"), to_gpdf.GetInputPort("object_pose"))
    connect(station.GetOutputPort(f"{camera}.pose"), to_gpdf.GetInputPort("camera_pose"))
    connect(to_gpdf.GetOutputPort("gpdf"), sampler.GetInputPort("gpdf"))
    connect(sampler.GetOutputPort("grasps"), latency.get_input_port())

    # Adaptation: what can be reached as the object moves.
    offered, in_reach = latency.get_output_port(), reach.GetOutputPort("grasps")
    if scenario.scene.enabled:
        offered, in_reach = _add_scene(builder, scenario, gripper, offered, in_reach)
    connect(offered, reach.GetInputPort("grasps"))
    connect(in_reach, reachable.get_input_port())
    for port in ("object_pose", "object_velocity"):
        connect(tracker.GetOutputPort(port), reach.GetInputPort(port))
        connect(tracker.GetOutputPort(port), sequencer.GetInputPort(port))
        connect(sequencer.GetOutputPort(port), controller.GetInputPort(port))

    # Control: sequencer -> controller -> drive -> arm and gripper.
    connect(reachable.get_output_port(), sequencer.GetInputPort("grasps"))
    connect(sequencer.GetOutputPort("grasps"), controller.GetInputPort("grasps"))
    if scenario.control.mode == "safe":
        connect(to_gpdf.GetOutputPort("gpdf"), sequencer.GetInputPort("gpdf"))
        connect(sequencer.GetOutputPort("gpdf"), controller.GetInputPort("gpdf"))
    connect(controller.GetOutputPort("commanded_velocity"), drive.GetInputPort("velocity"))
    connect(drive.GetOutputPort("desired_velocity"), controller.GetInputPort("desired_velocity"))
    connect(tracker.GetOutputPort("object_motion"), reach.GetInputPort("object_motion"))
    if controller.HasInputPort("object_motion"):
        connect(tracker.GetOutputPort("object_motion"), controller.GetInputPort("object_motion"))
    connect(drive.GetOutputPort("desired_state"), station.GetInputPort("iiwa.desired_state"))
    for system in (sequencer, controller, drive):
        connect(station.GetOutputPort("iiwa.position_measured"), system.GetInputPort("position"))
    connect(
        station.GetOutputPort("gripper.state_measured"), sequencer.GetInputPort("gripper_state")
    )
    connect(sequencer.GetOutputPort("gripper_position"), station.GetInputPort("gripper.position"))
    connect(sequencer.GetOutputPort("object_hold"), station.GetInputPort("object.hold"))

    # Measurement.
    connect(station.GetOutputPort("iiwa.state_estimated"), metrics.GetInputPort("state"))
    connect(station.GetOutputPort("object.pose"), metrics.GetInputPort("object_pose"))
    connect(sequencer.GetOutputPort("grasps"), metrics.GetInputPort("grasps"))
    connect(sequencer.GetOutputPort("phase"), metrics.GetInputPort("phase"))
    distance = add("obstacle_distance", ObstacleDistance(station.plant, station.robot_instances()))
    connect(station.GetOutputPort("query_object"), distance.get_input_port())
    for name, port, period in (
        ("metrics", metrics.get_output_port(), LOG_PERIOD),
        ("obstacle_distance", distance.get_output_port(), LOG_PERIOD),
        ("drive", drive.GetOutputPort("desired_state"), scenario.control.period),
        ("arm", station.GetOutputPort("iiwa.state_estimated"), scenario.control.period),
    ):
        LogVectorOutput(port, builder, period).set_name(f"log({name})")

    if meshcat is not None:
        _add_visualization(builder, gripper, meshcat)
    diagram = builder.Build()
    diagram.set_name("dynamic_grasp")
    return diagram


def _add_scene(
    builder: DiagramBuilder,
    scenario: Scenario,
    gripper: ParallelGripper,
    offered: OutputPort,
    in_reach: OutputPort,
) -> tuple[OutputPort, OutputPort]:
    """Lets the camera see the surroundings, and keeps the arm and its grasps clear of them.

    Grasps offered are dropped if the hand hits the scene either way round, so that they take no
    place among those that are judged; hand poses in reach, each by itself.
    """
    connect, config, camera = builder.Connect, scenario.scene, scenario.perception.camera
    station, tracker, controller = (
        builder.GetSubsystemByName(name) for name in ("station", "tracker", "controller")
    )
    perceived = builder.AddNamedSystem(
        "scene_perception",
        PointCloudToScene(
            station.robot_and_object_labels(), period=config.period, resolution=config.resolution
        ),
    )
    for output, port in (
        ("point_cloud", "point_cloud"),
        ("label_image", "label_image"),
        ("pose", "camera_pose"),
    ):
        connect(station.GetOutputPort(f"{camera}.{output}"), perceived.GetInputPort(port))
    connect(perceived.GetOutputPort("scene"), controller.GetInputPort("scene"))
    ports = []
    for name, grasps, either in (
        ("clear_grasps", offered, True),
        ("clear_hand_poses", in_reach, False),
    ):
        clear = SceneFilter(gripper, margin=config.margin, either_way_round=either)
        builder.AddNamedSystem(name, clear)
        connect(grasps, clear.GetInputPort("grasps"))
        connect(tracker.GetOutputPort("object_pose"), clear.GetInputPort("object_pose"))
        connect(perceived.GetOutputPort("scene"), clear.GetInputPort("scene"))
        ports.append(clear.GetOutputPort("grasps"))
    return ports[0], ports[1]


def _add_visualization(builder: DiagramBuilder, gripper: ParallelGripper, meshcat: Meshcat) -> None:
    """Shows the cell, and on the object what perception and reachability make of it."""
    station = builder.GetSubsystemByName("station")
    object_path = add_scene(builder, station, meshcat)
    visualizer = builder.AddNamedSystem(
        "visualizer", GraspVisualizer(meshcat, object_path, gripper)
    )
    for source, output, target in (
        ("perception", "perceived", "perceived"),
        ("latency", "y", "grasps"),
        ("sequencer", "grasps", "reachable"),
        ("sequencer", "phase", "phase"),
    ):
        builder.Connect(
            builder.GetSubsystemByName(source).GetOutputPort(output),
            visualizer.GetInputPort(target),
        )
