"""Kinematic roll-out of the control loop, without physics and camera.

The systems that run in `feasigrasp.systems.dynamic_grasp` (tracker, reachability filter,
controller, drive, metrics) run here too, but the grasps come from the object's whole surface, once,
and the arm is wherever the drive wants it. What is left out is what a controller should not depend
on: contact, the arm's own dynamics, and what the camera happens to see. Three laps take seconds.
"""

import dataclasses as dc
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    ConstantValueSource,
    ConstantVectorSource,
    Demultiplexer,
    LogVectorOutput,
    ZeroOrderHold,
)

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.motion import ObjectMotion
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.one_thread import one_thread
from feasigrasp.runs.metrics.motion_limits import limit_metrics
from feasigrasp.runs.metrics.reference_robot import reference_robot, self_collision_metrics
from feasigrasp.runs.metrics.run_metrics import summarize
from feasigrasp.scenario.sampling import lap, make_motion
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import (
    make_controller,
    make_drive,
    make_reachability,
    make_reachability_filter,
)
from feasigrasp.systems.metrics import SAMPLE_PERIOD, Metrics
from feasigrasp.systems.object_tracker import ObjectTracker
from feasigrasp.systems.ports import weakly
from feasigrasp.systems.station.directives import cell_directives

#: Makes the controller of a scenario; its ports are those of `GraspController`.
ControllerFactory = Callable[[Scenario, Reachability], LeafSystem]


@dc.dataclass(frozen=True, eq=False)
class Rollout:
    """What happened.

    Attributes:
        metrics: Those of `feasigrasp.runs.metrics.run_metrics.summarize`, of a run that never
            closes the gripper.
        times: Times of the samples [s], shape (n,).
        samples: Samples, one row per entry of `feasigrasp.systems.metrics.SAMPLE_NAMES`.
        states: Joint positions [rad], then velocities [rad/s], at every tick, shape (m, 14).
    """

    metrics: dict[str, Any]
    times: Array
    samples: Array
    states: Array


class _ObjectPose(LeafSystem):
    """The pose of an object that moves."""

    def __init__(self, motion: ObjectMotion) -> None:
        super().__init__()
        self._motion = motion
        self.DeclareAbstractOutputPort(
            "pose", Value[RigidTransform], weakly(self._calc), {self.time_ticket()}
        )

    def _calc(self, context: Context, output) -> None:
        output.set_value(RigidTransform(self._motion.pose(context.get_time())))


@lru_cache(maxsize=64)
def object_grasps(model: str, scale: float = 1.0, seed: int = 0, n_grasps: int = 64) -> GraspSet:
    """Grasps of an object whose whole surface is known, in its frame, best score first.

    Args:
        model: Name of a built-in object, or a mesh file.
        scale: Factor from the mesh's unit to metres.
        seed: Seed of the surface points and of the approach directions.
        n_grasps: Most grasps returned.
    """
    surface_points = 512
    mesh = load_object(model, scale=scale).mesh
    state = np.random.RandomState(seed)  # what trimesh samples with
    weights = mesh.area_faces / mesh.area_faces.sum()
    faces = state.choice(len(weights), surface_points, p=weights)
    a, b = np.sort(state.random_sample((2, surface_points, 1)), axis=0)
    corners = mesh.triangles[faces]
    points = a * corners[:, 0] + (b - a) * corners[:, 1] + (1.0 - b) * corners[:, 2]
    return AntipodalSampler(n_grasps=n_grasps, seed=seed)(fit_gpdf(points))


def make_rollout(
    scenario: Scenario, grasps: GraspSet, controller: ControllerFactory = make_controller
) -> Diagram:
    """Tracker, reachability filter, controller, drive and metrics around an ideal arm.

    The subsystems are named ``object``, ``tracker``, ``grasps``, ``reachability``, ``reachable``,
    ``controller``, ``drive`` and ``metrics``, as in `make_dynamic_grasp`; the logs are
    ``log(metrics)`` at the metrics' rate and ``log(drive)`` at the control rate.
    """
    reachability = make_reachability(scenario)
    gripper = reachability.gripper
    builder = DiagramBuilder()
    add, connect = builder.AddNamedSystem, builder.Connect
    pose = add("object", _ObjectPose(make_motion(scenario)))
    tracker = add("tracker", ObjectTracker(scenario.tracker))
    source = add("grasps", ConstantValueSource(AbstractValue.Make(grasps)))
    reach = add("reachability", make_reachability_filter(scenario, reachability))
    held = ZeroOrderHold(scenario.reachability.period, AbstractValue.Make(GraspSet.empty()))
    reachable = add("reachable", held)
    follow = add("controller", controller(scenario, reachability))
    drive = add("drive", make_drive(scenario))
    arm = add("arm", Demultiplexer([IIWA_7.joints, IIWA_7.joints]))
    metrics = add("metrics", Metrics(gripper))
    phase = add("phase", ConstantVectorSource([0.0]))

    connect(pose.get_output_port(), tracker.GetInputPort("pose"))
    connect(source.get_output_port(), reach.GetInputPort("grasps"))
    for port in ("object_pose", "object_velocity"):
        for system in (reach, follow):
            connect(tracker.GetOutputPort(port), system.GetInputPort(port))
    connect(reach.GetOutputPort("grasps"), reachable.get_input_port())
    connect(reachable.get_output_port(), follow.GetInputPort("grasps"))
    connect(follow.GetOutputPort("commanded_velocity"), drive.GetInputPort("velocity"))
    for source_port, port in (
        (drive.GetOutputPort("desired_velocity"), "desired_velocity"),
        (tracker.GetOutputPort("object_motion"), "object_motion"),
    ):
        for system in (reach, follow):  # each may do without
            if system.HasInputPort(port):
                connect(source_port, system.GetInputPort(port))
    # The arm is where the drive wants it to be.
    connect(drive.GetOutputPort("desired_state"), arm.get_input_port())
    for system in (reach, follow, drive):
        if system.HasInputPort("position"):
            connect(arm.get_output_port(0), system.GetInputPort("position"))
    connect(drive.GetOutputPort("desired_state"), metrics.GetInputPort("state"))
    connect(pose.get_output_port(), metrics.GetInputPort("object_pose"))
    connect(reachable.get_output_port(), metrics.GetInputPort("grasps"))
    connect(source.get_output_port(), metrics.GetInputPort("sampled_grasps"))
    connect(phase.get_output_port(), metrics.GetInputPort("phase"))
    log = LogVectorOutput(metrics.GetOutputPort("sample"), builder, SAMPLE_PERIOD)
    log.set_name("log(metrics)")
    log = LogVectorOutput(drive.GetOutputPort("desired_state"), builder, scenario.control.period)
    log.set_name("log(drive)")
    return builder.Build()


def roll_out(
    scenario: Scenario,
    grasps: GraspSet | None = None,
    *,
    duration: float | None = None,
    controller: ControllerFactory = make_controller,
) -> Rollout:
    """Runs a scenario kinematically.

    Args:
        scenario: What to run; its cell, cameras, perception and sequencer play no part.
        grasps: Grasps in the object frame; those of the scenario's object if not given.
        duration: Length [s]; if not given, three laps of the motion, or what the scenario has for
            one that has none.
        controller: Makes the controller; the scenario's own if not given.

    Raises:
        MeshError: The scenario's object cannot be loaded.
    """
    if grasps is None:
        grasps = object_grasps(scenario.object.model, scenario.object.scale, scenario.random_seed)
    if duration is None:
        laps = 3.0 * lap(scenario)
        duration = laps if np.isfinite(laps) else scenario.simulation_duration
    with one_thread():
        diagram = make_rollout(scenario, grasps, controller)
        simulator = Simulator(diagram)
        drive = diagram.GetSubsystemByName("drive")
        state = np.concatenate([scenario.start, np.zeros(IIWA_7.joints)])
        drive.GetMyMutableContextFromRoot(simulator.get_mutable_context()).SetDiscreteState(
            0, state
        )
        simulator.Initialize()
        simulator.AdvanceTo(duration)
    context = simulator.get_context()
    logs = [
        diagram.GetSubsystemByName(f"log({name})").FindLog(context) for name in ("metrics", "drive")
    ]
    (times, samples), (_, states) = [(log.sample_times().copy(), log.data().copy()) for log in logs]
    period = scenario.control.period
    q, qd = np.split(states.T, 2, axis=1)
    every = max(1, round(SAMPLE_PERIOD / period))
    return Rollout(
        summarize(samples, closes=False, limits=limit_metrics(q, qd, period, period))
        | self_collision_metrics(reference_robot(cell_directives(scenario)), q[::every]),
        times,
        samples,
        states.T,
    )
