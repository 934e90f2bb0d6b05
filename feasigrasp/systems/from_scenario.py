"""Makes the systems of the pipeline from a scenario."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import ControlSpace, controller_names, parse_word
from feasigrasp.models.clouds.camera import BASELINE, Camera, stereo_deviation
from feasigrasp.models.control.horizon.law import HorizonOptions
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.control.planning.static_grid import static_grid
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.faults.object import ObjectPulled
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn
from feasigrasp.models.grasps.samplers import make_sampler
from feasigrasp.models.objects.static_obstacles import StaticObstacle
from feasigrasp.models.objects.tracking import TrackerKind
from feasigrasp.models.reach.interception import InterceptionOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.capsules import arm_balls, capsule_model
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.models.segmentation.modeled_bodies import ModeledBodies
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.plugins import load_plugin
from feasigrasp.scenario.modes import added_mode
from feasigrasp.scenario.parts import Part, make_named
from feasigrasp.scenario.sampling import (
    load_scenario_object,
    make_camera_noise,
    make_distractor_bodies,
    make_friction,
    make_hand_error,
    make_hand_eye,
    make_motion,
    make_static_obstacles,
)
from feasigrasp.scenario.schema import EXACT, Scenario, Segmentation
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.grasp_sampler import GraspSampler
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp.systems.object_tracker import ObjectTracker
from feasigrasp.systems.point_cloud_to_gpdf import KeyframesToGPDF, PointCloudToGPDF
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene
from feasigrasp.systems.reachability_filter import ReachabilityFilter
from feasigrasp.systems.segmentation.foreground_segmentation import (
    ForegroundSegmentation,
    MaskFn,
    MaskSegmentation,
)
from feasigrasp.systems.segmentation.segment_point_cloud import SegmentPointCloud
from feasigrasp.systems.station.camera import pixel_centred_intrinsics
from feasigrasp.systems.station.cell_models import StationConfig, cell_boxes
from feasigrasp.systems.station.directives import cell_directives, modeled_bodies
from feasigrasp.systems.station.station import Station
from feasigrasp.systems.tracking.field_tracker import FieldTracker
from feasigrasp.systems.velocity_drive import VelocityDrive


def make_station(scenario: Scenario) -> Station:
    """The robot cell of a scenario, with its moving object.

    Raises:
        ScenarioError: Drake cannot build it, e.g. a camera stands on a frame that there is not.
        MeshError: The object cannot be simulated.
    """
    # Only the simulated hand errs; planning uses the nominal one.
    config = replace(station_config(scenario), hand_error=make_hand_error(scenario))
    obj, motion = load_scenario_object(scenario), make_motion(scenario)
    config.distractor_bodies = make_distractor_bodies(scenario, obj, motion)
    try:
        return Station(config, obj, motion)
    except RuntimeError as error:
        raise ScenarioError(f"Drake cannot build the cell: {error}") from error


def station_config(scenario: Scenario) -> StationConfig:
    """Configuration of the station of a scenario."""
    safe = scenario.control.safe
    return StationConfig(
        plant=scenario.plant_config,
        directives=cell_directives(scenario),
        arm=load_arm(scenario.arm),
        gripper=load_gripper(scenario.gripper),
        cameras=scenario.cameras,
        camera_noise=make_camera_noise(scenario),
        hand_eye=make_hand_eye(scenario),
        joint_errors=scenario.sensors.joints.scaled(scenario.sensors.error_factor),
        noise_seed=scenario.random_seed,
        q_start=scenario.start,
        friction=make_friction(scenario),
        enforce_constraints=safe,
        touch_object=safe or scenario.grasp.close,
        carrier=scenario.carrier.hold,
        pulls=[fault for fault in scenario.faults if isinstance(fault, ObjectPulled)],
    )


def make_foreground_segmentation(
    scenario: Scenario, gripper: Gripper, name: str = "", mask: MaskFn | None = None
) -> LeafSystem:
    """The segmentation of a camera's images, by default of perception's.

    It is by ``mask``, by the mask that the scenario names, or else by depth. The ``unmodeled``
    bodies of the cell it has to see.

    Raises:
        ScenarioError: The mask that the scenario names cannot be made.
    """
    camera, cell = make_camera(scenario, name), scenario.cell
    stated = ["table", *cell.boxes, *cell.meshes, *modeled_bodies(scenario)]
    boxes = cell_boxes(station_config(scenario), stated)
    bodies = ModeledBodies(gripper, boxes, load_arm(scenario.arm))
    own = scenario.parts.get(Part.SEGMENTATION)
    if own is not None and mask is None:
        mask = make_named(Part.SEGMENTATION, own, camera)
    if mask is not None:
        return MaskSegmentation(mask, camera, bodies)
    period = scenario.tracker.image_period
    return ForegroundSegmentation(camera, bodies, scenario.carrier.hue, period=period)


def make_object_pixels(scenario: Scenario, name: str = "") -> SegmentPointCloud:
    """The object's points, of those that `make_foreground_segmentation` has labelled."""
    hiding = {Label.ROBOT, Label.CARRIER}
    errors = make_camera_noise(scenario).get(name or scenario.perception.camera)
    smears, camera = errors is not None and errors.smear > 0.0, make_camera(scenario, name)
    return SegmentPointCloud(Label.OBJECT, camera=camera, hiding=hiding, smears=smears)


def tracks_from_depth(scenario: Scenario) -> bool:
    """Whether the object is found and tracked in depth images, by the scenario's own tracker."""
    camera = scenario.tracker.kind == TrackerKind.CAMERA and Part.TRACKER not in scenario.parts
    return camera and scenario.perception.segmentation == Segmentation.DEPTH


def make_camera(scenario: Scenario, name: str = "") -> Camera:
    """A camera as estimators take it, by default perception's.

    Its noise is `stereo_deviation`, whatever errors the simulated camera makes; both have the same
    baseline and decimation.
    """
    name = name or scenario.perception.camera
    config, noise = scenario.cameras[name], scenario.camera_noise.get(name, {})
    info = pixel_centred_intrinsics(config)
    intrinsics = info.focal_x(), info.focal_y(), info.center_x(), info.center_y()
    focal, baseline = info.focal_x() * noise.get("decimation", 1), noise.get("baseline", BASELINE)
    deviation = stereo_deviation(focal, baseline)
    return Camera(intrinsics, info.width(), info.height(), config.z_near, deviation)


def make_scenario_sampler(scenario: Scenario, gripper: Gripper) -> GraspSamplerFn:
    """The grasp sampler of a scenario, compiled."""
    config = scenario.perception
    sampler = make_sampler(
        config.sampler,
        gripper,
        filtered=config.filter,
        n_candidates=config.n_candidates,
        n_grasps=config.n_grasps,
        least_score=0.0,  # which of them are in reach decides
    )
    sampler(fit_gpdf(sphere_points(64, 0.03)))
    return sampler


def make_grasp_sampler(
    scenario: Scenario, sampler: GraspSamplerFn, gripper: Gripper, period: float = 0.05
) -> GraspSampler:
    """The grasp sampler of a scenario, with its filter, and the period of its history [s]."""
    checks = gripper if scenario.perception.filter else None
    # A tracker's field changes with every keyframe; grasps need not be sampled so often [s].
    rest = 0.25 if scenario.tracker.kind == TrackerKind.CAMERA else 0.0
    return GraspSampler(sampler, checks, mass=scenario.object.mass, period=period, rest=rest)


def make_scene(scenario: Scenario, gripper: Gripper, labels: Iterable[int]) -> PointCloudToScene:
    """The scene fusion of all pixels but those of some labels."""
    config = scenario.scene
    return PointCloudToScene(
        labels,
        gripper=gripper,
        period=config.period,
        resolution=config.resolution,
        arm=load_arm(scenario.arm),
    )


def make_perception(scenario: Scenario) -> LeafSystem:
    """The view fusion of a scenario: periodic views, or keyframes of the tracker."""
    config, tracker = scenario.perception, scenario.tracker
    if tracker.kind == TrackerKind.CAMERA:
        return KeyframesToGPDF(tracker.image_period, config)
    return PointCloudToGPDF(
        config.period,
        preset=config.preset,
        max_points=config.max_points,
        length_scale=config.length_scale,
        voxel_size=config.voxel_size,
        hidden_side=config.hidden_side,
        max_views=config.views,
    )


def make_tracker(scenario: Scenario) -> LeafSystem:
    """The tracker of a scenario; on perception's cameras it has their noise models."""
    if scenario.tracker.kind != TrackerKind.CAMERA:
        return ObjectTracker(scenario.tracker)
    second = scenario.perception.second_camera
    other = make_camera(scenario, second) if second else None
    return FieldTracker(make_camera(scenario), scenario.tracker, other)


def make_part(part: Part, scenario: Scenario, reachability: Reachability) -> Any:
    """A part of the pipeline: the one that the scenario names, or else its own.

    Raises:
        ScenarioError: The one that it names cannot be made.
    """
    gripper = reachability.gripper
    given: dict[Part, tuple[Any, Callable[[], Any]]] = {
        Part.SAMPLER: (gripper, lambda: make_scenario_sampler(scenario, gripper)),
        Part.CONTROLLER: (reachability, lambda: make_controller(scenario, reachability)),
        Part.TRACKER: (scenario.tracker, lambda: make_tracker(scenario)),
        Part.PERCEPTION: (scenario.perception, lambda: make_perception(scenario)),
    }
    argument, make = given[part]
    own = scenario.parts.get(part)
    return make() if own is None else make_named(part, own, argument)


def make_static_grid(scenario: Scenario) -> ObstacleGrid | None:
    """Distances to the bodies of the scenario's cell but robot and table; None if it has none.

    Raises:
        ScenarioError: The arm begins in one of them.
        MeshError: A mesh cannot be read, or is flat.
    """
    obstacles = make_static_obstacles(scenario)
    if names := modeled_bodies(scenario):
        X_WB, half, _ = cell_boxes(station_config(scenario), names)
        name = ", ".join(names)
        obstacles += [StaticObstacle.box(name, 2.0 * h, X) for X, h in zip(X_WB, half, strict=True)]
    if not obstacles:
        return None
    balls = arm_balls(capsule_model(load_gripper(scenario.gripper), load_arm(scenario.arm)))
    center = balls.placed(scenario.start)
    for obstacle in obstacles:
        room = float(np.min(obstacle.distance(center) - balls.radius))
        if room < 0.0:
            raise ScenarioError(
                f"the obstacle {obstacle.name} of cell is {-100.0 * room:.1f} cm in the arm at "
                "q_start; move one of them"
            )
    return static_grid(obstacles)


def make_reachability(scenario: Scenario) -> Reachability:
    """Reachability of a scenario's arm, with its hand above its table."""
    cell, ours = scenario.cell, Reachability.table_clearance - SafetyOptions.table_clearance
    return Reachability(
        load_gripper(scenario.gripper),
        arm=load_arm(scenario.arm),
        table_clearance=cell.table_clearance + ours,
        table_height=cell.table_height,
    )


def make_reachability_filter(scenario: Scenario, reachability: Reachability) -> LeafSystem:
    """The reachability filter of a scenario."""
    config = scenario.reachability
    if config.method != EXACT:
        return load_plugin("judges", config.method)(scenario, reachability)
    return ReachabilityFilter(
        reachability,
        options=_interception(scenario),
        prediction=scenario.control.prediction,
        symmetric_grasps=config.symmetric_grasps,
        period=config.period,
    )


def make_controller(scenario: Scenario, reachability: Reachability) -> GraspController:
    """The controller of a scenario."""
    config, arm = scenario.control, reachability.arm
    fastest = config.speed * SafetyOptions.velocity_scale
    most = arm.braking_rate(fastest, arm.acceleration_share)
    safety = SafetyOptions(
        approach_gain=min(SafetyOptions.approach_gain, most),
        period=config.period,
        speed=config.speed,
        table_height=reachability.table_height,
        table_clearance=scenario.cell.table_clearance,
        acceleration_scale=arm.acceleration_share,
        position_margin=arm.position_margin,
        arm=arm,
    )
    name = parse_word(controller_names(), config.controller, "control.controller", ScenarioError)
    if name not in [*ControlSpace]:
        return load_plugin("controllers", name)(scenario, reachability, safety)
    mode = added_mode(config.mode)
    if mode is not None:
        return mode.make_controller(scenario, reachability)
    options = HorizonOptions(
        prediction=config.prediction,
        neighbours=HorizonOptions.neighbours if config.density else 1,
        rank_period=scenario.reachability.period,
        corridor=ApproachCorridor(min_standoff=scenario.grasp.standoff),
        interception=_interception(scenario),
        program=ProgramOptions(safety=safety),
    )
    kind = GPJointController if config.controller == ControlSpace.JOINT else RMMTaskController
    return kind(reachability, options)


def _interception(scenario: Scenario) -> InterceptionOptions:
    """What can be followed at the arm's speed, scores counted if the scenario says so."""
    config, default = scenario.control, InterceptionOptions
    x, y, z = scenario.grasp.lift if scenario.grasp.close else default.lift
    return InterceptionOptions(
        velocity=config.speed * default.velocity,
        score=default.score if config.score else 0.0,
        lift=(x, y, z),
    )


def make_drive(scenario: Scenario) -> LeafSystem:
    """The drive between the controller's velocity and the arm."""
    config = scenario.control
    if mode := added_mode(config.mode):
        return mode.make_drive(scenario)
    return VelocityDrive(config.period, speed=config.speed, arm=load_arm(scenario.arm))
