"""What goes on, in words, and what a run is judged by."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import OutputPort, System
from pydrake.systems.primitives import LogVectorOutput

from feasigrasp.models.objects.tracker_config import TrackerKind
from feasigrasp.systems.metrics import SAMPLE_PERIOD, Metrics
from feasigrasp.systems.monitoring.status_monitor import StatusMonitor
from feasigrasp.systems.monitoring.true_frame import TrueFrame
from feasigrasp.systems.stages.cell import Cell, given
from feasigrasp.systems.stages.delay import Delay
from feasigrasp.systems.station.object_contact import ObjectContact, ObstacleDistance


def add_status(cell: Cell) -> None:
    """Adds what says in words what goes on."""
    scene = ["scene_perception"] if cell.scenario.scene.enabled else []
    cell.add(
        "status",
        StatusMonitor(cell.gripper, cell.scenario.grasp),
        *(cell[name] for name in ("tracker", "perception", "drive", "sequencer", *scene)),
        cell["contact_sense"],
        **given(lapsed=cell.source("sequencer", "lapsed") if cell.remote else None),
        position=cell.station.GetOutputPort("iiwa.position_measured"),
        grasps=cell["latency"].get_output_port(),
        verdicts=cell["reachability"].GetOutputPort("verdicts"),
        reachable=cell["sequencer"].GetOutputPort("grasps"),
    )


def add_measurement(cell: Cell) -> None:
    """Adds what reads the truth, and the logs of what arm and drive do."""
    frame: dict[str, OutputPort] = {}
    if cell.scenario.tracker.kind == TrackerKind.CAMERA:  # whose frame is that of its first view
        pose = cell.station.GetOutputPort("object.pose")
        tracked = cell["tracker"].GetOutputPort("object_pose")
        looks = TrueFrame(cell.station.plant.time_step())
        judge = cell.add("true_frame", looks, object_pose=pose, tracked_pose=tracked)
        frame["frame_pose"] = judge.get_output_port()
    add_judges(
        cell,
        cell["sequencer"],
        **frame,
        sampled_grasps=cell["latency"].get_output_port(),
        seen_at=_as_late_as_the_grasps(cell, cell["perception"].GetOutputPort("seen_at")),
    )
    desired = cell["drive"].GetOutputPort("desired_state")
    LogVectorOutput(desired, cell.builder, cell.scenario.control.period).set_name("log(drive)")


def add_judges(cell: Cell, sequencer: System, **inputs: OutputPort) -> None:
    """Adds what a run is judged by, in the whole pipeline or beside the drivers, and its logs.

    Args:
        cell: A cell whose station is simulated.
        sequencer: What tells the phase of the grasp, and may tell grasps.
        inputs: Further inputs of `Metrics`.
    """
    station = cell.station
    state = station.GetOutputPort("iiwa.state_estimated")
    inputs |= {"state": state, "object_pose": station.GetOutputPort("object.pose")}
    metrics = cell.add("metrics", Metrics(cell.gripper), sequencer, **inputs)
    distance = ObstacleDistance(station.plant, station.robot_instances())
    cell.add("obstacle_distance", distance, station)
    contact = ObjectContact(station.plant, station.object_body.index(), station.robot_instances())
    cell.add("contact", contact, station, sequencer)
    for name, port, period in (
        ("metrics", metrics.get_output_port(), SAMPLE_PERIOD),
        ("obstacle_distance", distance.get_output_port(), SAMPLE_PERIOD),
        ("arm", state, cell.scenario.control.period),
        # At every step of the plant, which computes them anyway; in between it would do so anew.
        ("torque", station.GetOutputPort("iiwa.torque_measured"), station.plant.time_step()),
    ):
        LogVectorOutput(port, cell.builder, period).set_name(f"log({name})")


def _as_late_as_the_grasps(cell: Cell, seen_at: OutputPort) -> OutputPort:
    """The time of a view, held back as the grasps are on their way to the controller."""
    never = np.array([np.nan])
    arrives = cell.add("seen_at(latency)", cell.late(never), u=seen_at).get_output_port()
    # No `ZeroOrderHold`: of a vector it sees what is made at its ticks, of a set of grasps not yet.
    held = Delay(never, 0.0, cell.scenario.reachability.period)
    cell.add("seen_at(reachable)", held, u=arrives)
    return held.get_output_port()
