"""From grasps to what arm and gripper are sent."""

from __future__ import annotations

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import LeafSystem, OutputPort
from pydrake.systems.primitives import ConstantValueSource, ZeroOrderHold

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.systems.from_scenario import (
    carries_its_camera,
    led_by_its_camera,
    make_view_filter,
)
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.monitoring.contact_sense import ContactSense
from feasigrasp.systems.reachability_filter import CarryFilter, SceneFilter
from feasigrasp.systems.stages.cell import Cell, given
from feasigrasp.systems.stages.controllers import (
    make_drive,
    make_reachability_filter,
    make_static_grid,
)
from feasigrasp.systems.stages.remote import lapsed


def _clear_of_scene(cell: Cell, name: str, grasps: OutputPort, **options: bool) -> OutputPort:
    """The grasps at which the open hand is clear of the scene; all if nobody looks at it."""
    config = cell.scenario.scene
    if not config.enabled:
        return grasps
    clear = SceneFilter(cell.gripper, margin=config.margin, **options)
    sources = cell["tracker"], cell["scene_perception"]
    return cell.add(name, clear, *sources, grasps=grasps).get_output_port()


def add_control(
    cell: Cell,
    reachability: Reachability,
    controller: LeafSystem,
    gpdf: OutputPort,
    planner: LeafSystem | None = None,
) -> None:
    """Grasps -> those in reach -> sequencer -> controller -> drive -> arm and gripper.

    Args:
        cell: The cell.
        reachability: What the arm can reach.
        controller: The arm's velocity.
        gpdf: The object's field.
        planner: What plans for the controller; None where it does that itself.
    """
    station, tracker, scenario = cell.station, cell["tracker"], cell.scenario
    config, safe = scenario.reachability, scenario.control.safe
    sees = carries_its_camera(scenario) and controller.HasInputPort("camera_pose")
    looks = sees and led_by_its_camera(scenario)
    position = station.GetOutputPort("iiwa.position_measured")
    own_camera = {"position": position}
    if sees:
        # Where images come late, a camera's `pose` is of their instant, and not of the joints'.
        pose = f"{scenario.perception.camera}.pose"
        now = f"{pose}_now" if station.HasOutputPort(f"{pose}_now") else pose
        own_camera["camera_pose"] = station.GetOutputPort(now)
    grasps = cell["latency"].get_output_port()
    if safe:
        grasps = cell.add("carrying", CarryFilter(), tracker, grasps=grasps).get_output_port()
    # What hits the scene either way round takes no place among those that are judged.
    grasps = _clear_of_scene(cell, "clear_grasps", grasps, either_way_round=True)
    in_reach = make_reachability_filter(scenario, reachability)
    cell.add("reachability", in_reach, tracker, grasps=grasps)
    hand_poses = _clear_of_scene(cell, "clear_hand_poses", in_reach.GetOutputPort("grasps"))
    if looks:
        view = make_view_filter(scenario, cell.gripper)
        cell.add("in_view", view, grasps=hand_poses, gpdf=gpdf, **own_camera)
        hand_poses = view.get_output_port()
    reachable = ZeroOrderHold(config.period, AbstractValue.Make(GraspSet.empty()))
    cell.add("reachable", reachable, u=hand_poses)

    if planner:
        cell.builder.AddNamedSystem("planner", planner)
    sequencer = cell.add(
        "sequencer",
        GripperSequencer(
            scenario.sequence,
            cell.gripper,
            speed=scenario.control.speed,
            period=config.period,
            looks=looks,
            reachability=reachability if safe else None,
        ),
        tracker,
        **own_camera,
        gpdf=gpdf,
        perceived=cell["perception"].GetOutputPort("perceived"),
        grasps=reachable.get_output_port(),
        gripper_state=station.GetOutputPort("gripper.state_measured"),
        **given(lapsed=lapsed(cell)),
    )
    if sees and tracker.HasInputPort("phase"):
        for name in ("tracker", "remote_tracker"):
            if cell.builder.HasSubsystemNamed(name):
                cell.connect(cell[name], phase=sequencer.GetOutputPort("phase"))
    sense = cell.add(
        "contact_sense",
        ContactSense(scenario.plant_config.time_step),
        sequencer,
        torque_external=station.GetOutputPort("iiwa.torque_external"),
    )
    drive = make_drive(scenario)
    cell.builder.AddNamedSystem("drive", drive)
    sources = [sequencer, tracker, drive, sense]
    if scenario.scene.enabled:
        sources.append(cell["scene_perception"])
    cell.builder.AddNamedSystem("controller", controller)
    static = make_static_grid(scenario) if safe else None
    if static is not None and controller.HasInputPort("static_obstacles"):
        source = ConstantValueSource(AbstractValue.Make(static))
        cell.add("static_obstacles", source)
        cell.connect(controller, static_obstacles=source.get_output_port())
    for system in filter(None, (planner, controller)):
        cell.connect(system, *sources, **own_camera)
    if planner:
        cell.connect(controller, planner)
    if controller.HasOutputPort("arrival"):
        cell.connect(sequencer, arrival=controller.GetOutputPort("arrival"))
    cell.connect(drive, velocity=cell.faults.command(controller), position=position)
    for name, port in (
        ("iiwa.desired_state", drive.GetOutputPort("desired_state")),
        ("gripper.position", sequencer.GetOutputPort("gripper_position")),
        ("object.hold", sequencer.GetOutputPort("object_hold")),
    ):
        if station.HasInputPort(name):
            cell.builder.Connect(port, station.GetInputPort(name))
