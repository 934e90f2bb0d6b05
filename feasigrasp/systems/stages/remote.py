"""Perception in processes of its own: what is built there, and what stands for it here."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.control import PerceptionLate
from feasigrasp.models.objects.tracker_config import TrackerKind
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.grippers import load_gripper
from feasigrasp.scenario.files import dump_scenario, parse_scenario
from feasigrasp.scenario.parts import Part
from feasigrasp.systems.from_scenario import make_grasp_sampler, make_part, make_scene
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene
from feasigrasp.systems.remote.remote_stage import RemoteStage
from feasigrasp.systems.remote.served import inputs_of, outputs_of
from feasigrasp.systems.stages.cell import Cell


def make_object_stage(text: str) -> Diagram:
    """From the object's points to its field and its grasps, for the scenario of a YAML text.

    It has the ports of the scenario's perception, and ``grasps``.
    """
    scenario = parse_scenario(text)
    gripper = load_gripper(scenario.gripper)
    reachability = Reachability(gripper)
    builder = DiagramBuilder()
    perception = make_part(Part.PERCEPTION, scenario, reachability)
    builder.AddNamedSystem("perception", perception)
    sampling = make_grasp_sampler(
        scenario, make_part(Part.SAMPLER, scenario, reachability), gripper
    )
    sampler = builder.AddNamedSystem("sampler", sampling)
    builder.Connect(perception.GetOutputPort("gpdf"), sampler.get_input_port())
    for given in inputs_of(perception):
        builder.ExportInput(given, given.get_name())
    for told in (*outputs_of(perception), sampler.get_output_port()):
        builder.ExportOutput(told, told.get_name())
    return builder.Build()


def make_scene_stage(text: str, labels: Iterable[int]) -> PointCloudToScene:
    """What makes a scene of all pixels but those of some labels, for the scenario of a text."""
    scenario = parse_scenario(text)
    return make_scene(scenario, load_gripper(scenario.gripper), labels)


def remote_object(cell: Cell) -> RemoteStage:
    """What `make_object_stage` makes, in a process of its own.

    Raises:
        ScenarioError: A fault of the scenario lies within it.
    """
    scenario = cell.scenario
    if any(isinstance(fault, PerceptionLate) for fault in scenario.faults):
        raise ScenarioError(
            "!PerceptionLate delays what happens inside of perception.execution: processes; give "
            "perception: {execution: inline}, or a perception.latency"
        )
    camera = scenario.tracker.kind == TrackerKind.CAMERA
    period = scenario.tracker.image_period if camera else scenario.perception.period
    return _remote(cell, partial(make_object_stage, dump_scenario(scenario)), period)


def remote_scene(cell: Cell, labels: Iterable[int]) -> RemoteStage:
    """What `make_scene_stage` makes, in a process of its own."""
    make = partial(make_scene_stage, dump_scenario(cell.scenario), sorted(set(labels)))
    return _remote(cell, make, cell.scenario.scene.period)


def lapsed(cell: Cell) -> OutputPort | None:
    """Greater than 0 (V1) while a process of perception is gone; None where there are none."""
    if not cell.remote:
        return None
    port = cell["perception"].GetOutputPort("lapsed")
    if not cell.scenario.scene.enabled:
        return port
    either = cell.builder.AddNamedSystem("lapsed", Adder(2, 1))
    for i, name in enumerate(("perception", "scene_perception")):
        cell.builder.Connect(cell[name].GetOutputPort("lapsed"), either.get_input_port(i))
    return either.get_output_port()


def _remote(cell: Cell, make: partial, period: float) -> RemoteStage:
    latency = cell.scenario.perception.latency if cell.simulated else None
    return RemoteStage(make, period, latency=latency)
