"""The whole pipeline as one diagram, from the scenario that describes it."""

from collections.abc import Callable
from dataclasses import dataclass

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, System

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn
from feasigrasp.models.robot.arm import Arm
from feasigrasp.scenario.checks import check_segmentation, check_types_too
from feasigrasp.scenario.parts import Part
from feasigrasp.scenario.sampling import make_hand_error
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import (
    make_part,
    make_reachability,
    make_station,
    tracks_from_depth,
)
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.pipeline import (
    Cell,
    add_control,
    add_measurement,
    add_perception,
    add_tracker,
    add_visualization,
)
from feasigrasp.systems.segmentation.foreground_segmentation import MaskFn
from feasigrasp.systems.stages.remote import remote_object, remote_planner
from feasigrasp.systems.station.cell_check import check_cell
from feasigrasp.systems.station.station import Station


@dataclass(frozen=True, eq=False)
class Subsystems:
    """The systems of the pipeline that ports are read from, by name.

    Attributes:
        station: The cell.
        tracker: Where the object is.
        segmentation: Which points are the object's.
        perception: Its completed shape.
        sampler: Its grasps; the perception itself, if that is in a process of its own.
        reachability: Those in reach.
        sequencer: When to close, and what the controller is given.
        controller: The arm's velocity.
        drive: What the arm is sent.
        status: What goes on, in words.
    """

    station: Diagram
    tracker: LeafSystem
    segmentation: LeafSystem
    perception: LeafSystem
    sampler: LeafSystem
    reachability: LeafSystem
    sequencer: LeafSystem
    controller: LeafSystem
    drive: LeafSystem
    status: LeafSystem

    def __post_init__(self) -> None:
        """Checks that they are systems."""
        check_fields(self, ScenarioError)


class DynamicGrasp(Diagram):
    """The whole pipeline; `make_dynamic_grasp` builds it.

    Attributes:
        subsystems: Its systems.
    """

    subsystems: Subsystems


#: Adds systems and logs to the builder that holds the subsystems.
Connect = Callable[[DiagramBuilder, Subsystems], None]


@checked(ScenarioError)
def make_dynamic_grasp(
    scenario: Scenario,
    meshcat: Meshcat | None = None,
    *,
    sampler: GraspSamplerFn | None = None,
    controller: LeafSystem | None = None,
    tracker: LeafSystem | None = None,
    perception: LeafSystem | None = None,
    segmentation: MaskFn | None = None,
    station: Diagram | None = None,
    connect: Connect | None = None,
) -> DynamicGrasp:
    """Builds station, perception, grasp sampling, reachability, control and metrics.

    Beside the `Subsystems`, which have the same names in the diagram, there are ``latency``,
    ``carrying`` (in mode ``safe``), ``reachable``, ``contact_sense``, ``metrics``,
    ``obstacle_distance``, ``contact``, ``view_time(latency)`` and ``view_time(reachable)``. The
    vector logs ``log(metrics)`` and ``log(obstacle_distance)`` hold their samples, ``log(drive)``
    and ``log(arm)`` the commanded and the true state of the arm at the control rate,
    ``log(torque)`` and ``log(velocity)`` the torques of its motors and its true velocity at every
    step of the plant. With a Meshcat there are
    ``scene``, ``visualizer`` and ``camera_pictures`` as well; with a scene field
    ``scene_perception``, ``clear_grasps`` and ``clear_hand_poses``; with ``segmentation: depth``
    ``foreground``; with a tracker of ``kind: camera`` ``true_frame``; where images have a stamp,
    and the tracker has no such port, ``pose_at_view``; with ``execution: processes`` ``planner``,
    and ``remote_tracker`` if it looks at images; with faults systems that `FaultInjection` adds.

    A port of any of them can be read while a simulator runs, and a log of one's own when it has
    run::

        def connect(builder, subsystems):
            velocity = subsystems.drive.GetOutputPort("desired_velocity")
            LogVectorOutput(velocity, builder, 0.01).set_name("velocity")

        diagram = make_dynamic_grasp(scenario, connect=connect)
        simulator = Simulator(diagram)
        simulator.AdvanceTo(5.0)
        log = diagram.GetSubsystemByName("velocity").FindLog(simulator.get_context())

    Parts that are not given are those that the scenario names in ``parts``, or its own.

    Args:
        scenario: What to build.
        meshcat: Where to show it; with the completed cloud and the grasps on the object.
        sampler: From a field of the object to its grasps.
        controller: A system with the ports of `GraspController`, of the optional ones as many as
            it likes. What else it has is connected where tracker, sequencer or drive have an output
            of that name.
        tracker: A system with the outputs of `ObjectTracker`. Of the inputs ``pose`` (what a motion
            capture system measures), ``stamp`` and those of `FieldTracker` it is given those that
            it has.
        perception: A system with the ports of `PointCloudToGPDF`.
        segmentation: From colors (height, width, 3), depths (height, width) [m] and time [s] to the
            mask of the object, see `MaskSegmentation`; with ``segmentation: depth``.
        station: A cell with the ports of `Station`; the scenario's, simulated, unless given. One
            that is not simulated, such as `HardwareStation`, has no ports of truth: then nothing
            that measures it is built.
        connect: Adds systems and logs before the diagram is built.

    Raises:
        ScenarioError: A part that the scenario names cannot be made, or one that is given would
            have to go to another process.
    """
    check_types_too(scenario)
    reachability = make_reachability(scenario)
    gripper = reachability.gripper
    hand_error = None if station else make_hand_error(scenario)
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", station or make_station(scenario))
    check_cell(station.plant, gripper, reachability.arm, hand_error)
    cell = Cell(builder, scenario, gripper, reachability.arm, station, segmentation)
    check_segmentation(scenario, own=cell.masked)
    add_tracker(cell, tracker or make_part(Part.TRACKER, scenario, reachability))
    if cell.remote:
        if sampler or perception or segmentation:
            raise ScenarioError(
                "perception.execution: processes builds sampler, perception and segmentation "
                "elsewhere; name them in parts, or give perception: {execution: inline}"
            )
        # A fault of the mask has no place over there.
        tracks = not tracker and not scenario.faults and tracks_from_depth(scenario)
        add_perception(cell, remote_object(scenario, cell.simulated), tracks_elsewhere=tracks)
    else:
        add_perception(
            cell,
            perception or make_part(Part.PERCEPTION, scenario, reachability),
            sampler or make_part(Part.SAMPLER, scenario, reachability),
        )
    made = controller or make_part(Part.CONTROLLER, scenario, reachability)
    _check_controller(made, reachability.arm)
    planner = None
    if cell.remote and not controller and isinstance(made, GraspController):
        planner = remote_planner(scenario, cell.simulated, made.period)
    add_control(cell, reachability, made, planner)
    if isinstance(station, Station):
        add_measurement(cell)
    if meshcat is not None:
        add_visualization(cell, meshcat)
    cell.connect()
    # In a process of its own perception samples as well.
    other = {"sampler": "perception"} if cell.remote else {}
    names = {name: other.get(name, name) for name in Subsystems.__annotations__}
    subsystems = Subsystems(**{name: cell[there] for name, there in names.items()})
    if connect is not None:
        connect(builder, subsystems)
    diagram = DynamicGrasp()
    diagram.subsystems = subsystems
    builder.BuildInto(diagram)
    diagram.set_name("dynamic_grasp")
    return diagram


def _check_controller(controller: LeafSystem, arm: Arm) -> None:
    """Makes sure that a controller has what every one is given, and what the drive obeys."""
    name, output = type(controller).__name__, "commanded_velocity"
    if not (
        isinstance(controller, System)
        and controller.HasInputPort("position")
        and controller.HasOutputPort(output)
    ):
        raise ScenarioError(
            f"the controller, a {name}, has no input port position or no output port {output}; see "
            "docs/own_parts.md"
        )
    size = controller.GetOutputPort(output).size()
    if size != arm.joints:
        raise ScenarioError(
            f"{name}.{output} has {size} numbers; give the velocities of {arm.joints} joints "
            "[rad/s]"
        )
