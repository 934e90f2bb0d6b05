"""The whole pipeline: what is connected, and parts of one's own in it."""

import dataclasses
import textwrap

import numpy as np
import pytest
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from feasigrasp.errors import ScenarioError
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.scenario.files import dump_scenario
from feasigrasp.systems.dynamic_grasp import Subsystems, make_dynamic_grasp
from feasigrasp.systems.from_scenario import make_controller
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp.systems.metrics import SAMPLE_NAMES
from feasigrasp.systems.object_tracker import ObjectTracker
from feasigrasp.systems.ports import declare_input
from feasigrasp_lab.paper.modes import Unenforced
from tests.pipeline import scenario


@pytest.fixture(scope="module")
def diagram():
    return make_dynamic_grasp(scenario())


def test_the_subsystems_have_their_documented_names(diagram):
    named = make_dynamic_grasp.__doc__.split("there are")[1].split("With a Meshcat")[0]
    documented = {word for word in named.split("``")[1::2]} - {"safe"}
    assert len(documented) >= 12
    documented |= {entry.name for entry in dataclasses.fields(Subsystems)}
    assert documented == {system.get_name() for system in diagram.GetSystems()}


def test_building_leaves_the_scenario_as_it_is():
    """A result says which scenario it is of: it is found again only if that has not changed."""
    config = scenario()
    before = dump_scenario(config)
    make_dynamic_grasp(config)
    assert dump_scenario(config) == before


#: Inputs that are for a controller with grasps of its own, for scenes that are looked at, for
#: measurements with a time stamp, for a tracker that looks through the camera on the arm, and for
#: perception and planning in processes of their own.
OPEN = {
    ("controller", "plan"),
    ("controller", "scene"),
    ("controller", "static_obstacles"),
    ("sequencer", "arrival"),
    ("sequencer", "lapsed"),
    ("status", "contradicted"),
    ("status", "lapsed"),
    ("status", "scene"),
    ("tracker", "stamp"),
    ("metrics", "frame_pose"),
    ("perception", "image_time"),
    ("view_time(reachable)", "stamp"),
}


def test_every_input_is_connected(diagram):
    assert diagram.num_input_ports() == 0
    context = diagram.CreateDefaultContext()
    without = {
        (system.get_name(), port.get_name())
        for system in diagram.GetSystems()
        for port in map(system.get_input_port, range(system.num_input_ports()))
        if not port.HasValue(system.GetMyContextFromRoot(context))
    }
    assert without == OPEN


@pytest.mark.parametrize(
    ("controller", "cls"), [("task", RMMTaskController), ("joint", GPJointController)]
)
def test_the_scenario_chooses_the_controller(controller, cls):
    config = scenario(text=f"{{control: {{controller: {controller}}}}}")
    assert type(make_controller(config, Reachability())) is cls


@pytest.mark.parametrize(
    ("key", "value"), [("mode", "Paper"), ("controller", "cartesian")], ids=["mode", "controller"]
)
def test_a_word_that_no_file_has_checked_is_refused(key, value):
    config = scenario()
    setattr(config.control, key, value)
    with pytest.raises(ScenarioError, match=f"control.{key} is '{value}'; choose one of"):
        make_dynamic_grasp(config)


def own_controller():
    """The one that the base class' docstring shows."""
    example = GraspController.__doc__.split("by resolved rates::")[1].split("make_dynamic_grasp")[0]
    names = {"np": np, "se3": se3, "pose_and_jacobian": pose_and_jacobian}
    names["GraspController"] = GraspController
    exec(textwrap.dedent(example), names)
    return names["FirstGrasp"]


@pytest.mark.parametrize("mode", ["safe", "corrected"])
def test_a_sampler_and_a_controller_of_one_s_own(mode):
    """They do the work in the diagram: the arm comes to the best of the grasps sampled."""
    sets, antipodal = [], AntipodalSampler(n_grasps=8)

    def sampler(gpdf):
        # The same at every view: those of another view may be on the other side of the object.
        sets.append(sets[0] if sets else antipodal(gpdf))
        return sets[-1]

    config = scenario(
        "ReachLinearMocap",
        f"{{motion: {{rate: 0.05, spin: 0}}, control: {{mode: {mode}}}, grasp: {{close: false}},"
        " camera_noise: {}}",
    )
    kind = own_controller()
    if mode != "safe":
        kind = type("Free", (Unenforced, kind), {})
    controller = kind(Reachability())
    diagram = make_dynamic_grasp(config, sampler=sampler, controller=controller)
    simulator = Simulator(diagram)
    assert not sets
    simulator.AdvanceTo(4.0)
    assert diagram.GetSubsystemByName("controller") is controller
    assert len(sets) >= 2
    log = diagram.GetSubsystemByName("log(metrics)").FindLog(simulator.get_context())
    samples = dict(zip(SAMPLE_NAMES, log.data(), strict=True))
    error = samples["grasp_position_error"]
    assert np.nanmax(error) > 0.1
    # With limits and clearances enforced, the straight way need not lead all the way.
    assert error[-1] < (0.01 if mode == "corrected" else 0.5 * np.nanmax(error))


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_a_hand_that_is_told_to_waits_behind_the_grasps(controller):
    """It is as far behind one as it is told; on its way to another it passes some nearer."""
    text = f"{{grasp: {{close: false, standoff: 0.1}}, control: {{controller: {controller}}}}}"
    diagram = make_dynamic_grasp(scenario("ReachLinearMocap", text))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(5.5)
    log = diagram.GetSubsystemByName("log(metrics)").FindLog(simulator.get_context())
    samples = dict(zip(SAMPLE_NAMES, log.data(), strict=True))
    error = samples["grasp_position_error"][log.sample_times() > 3.0]
    assert np.nanmin(error) > 0.02
    assert 0.07 < np.nanmedian(error) < 0.13


class Still(LeafSystem):
    """A controller that needs next to nothing, and asks for something unusual."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("position", 7)
        self.phase = self.DeclareVectorInputPort("phase", 1)
        self.DeclareVectorOutputPort("commanded_velocity", 7, self.calc)

    def calc(self, context, output):
        output.SetFromVector(np.full(7, self.phase.Eval(context)[0]))


def test_systems_and_logs_of_one_s_own():
    config = scenario(text="{perception: {sampler: antipodal}}")

    def connect(builder, subsystems):
        velocity = subsystems.drive.GetOutputPort("desired_velocity")
        LogVectorOutput(velocity, builder, 0.01).set_name("velocity")

    diagram = make_dynamic_grasp(config, controller=Still(), connect=connect)
    assert diagram.subsystems.controller is diagram.GetSubsystemByName("controller")
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1)
    log = diagram.GetSubsystemByName("velocity").FindLog(simulator.get_context())
    velocities = log.data()
    assert velocities.shape == (7, 11)
    assert not velocities.any()


def test_controller_inputs_go_through_the_sequencer(diagram):
    """Only so can it hold the arm on one grasp and lift."""
    connections = {
        (sink[0].get_name(), sink[0].get_input_port(sink[1]).get_name()): (
            source[0].get_name(),
            source[0].get_output_port(source[1]).get_name(),
        )
        for sink, source in diagram.connection_map().items()
    }
    for name in ("grasps", "object_pose", "object_velocity", "gpdf"):
        assert connections["controller", name] == ("sequencer", name)
    assert connections["station", "object.hold"] == ("sequencer", "object_hold")
    # Perception and the arm see what the tracker says; only the metrics see the truth.
    assert connections["perception", "object_pose"] == ("tracker", "object_pose")
    assert connections["metrics", "object_pose"] == ("station", "object.pose")


def test_with_a_scene_the_controllers_keep_clear_of_it():
    """The wiring: what the camera sees of the surroundings reaches the controller."""
    for controller in ("task", "joint"):
        config = scenario("ReachObstacleMocap", f"{{control: {{controller: {controller}}}}}")
        built = make_dynamic_grasp(config)
        sources = {
            (sink[0].get_name(), sink[0].get_input_port(sink[1]).get_name()): source[0].get_name()
            for sink, source in built.connection_map().items()
        }
        assert sources["controller", "scene"] == "scene_perception"
        assert sources["controller", "desired_velocity"] == "drive"
        assert sources["obstacle_distance", "query_object"] == "station"
        assert built.HasSubsystemNamed("log(obstacle_distance)")
    without = make_dynamic_grasp(scenario("ReachObstacleMocap", "{scene: {enabled: false}}"))
    assert not without.HasSubsystemNamed("scene_perception")


def test_a_tracker_of_ones_own_may_look_at_images_and_needs_no_outputs_but_those_documented():
    class OwnTracker(ObjectTracker):
        def __init__(self):
            super().__init__()
            declare_input(self, "point_cloud", PointCloud())

    setting = scenario(text="{perception: {segmentation: depth}}")
    diagram = make_dynamic_grasp(setting, tracker=OwnTracker())
    context = diagram.subsystems.tracker.GetMyContextFromRoot(diagram.CreateDefaultContext())
    assert diagram.subsystems.tracker.GetInputPort("point_cloud").HasValue(context)


@pytest.mark.parametrize(
    ("name", "outputs", "missing"),
    [
        ("ReachCircularMocap", ["object_pose"], "object_velocity"),
        ("ReachCircular", ["object_pose", "object_velocity"], "keyframe"),
    ],
)
def test_a_tracker_without_an_output_that_the_scenario_needs_is_refused(name, outputs, missing):
    tracker = LeafSystem()
    for output in outputs:
        tracker.DeclareVectorOutputPort(output, 1, lambda context, value: None)
    with pytest.raises(ScenarioError, match=f"LeafSystem, has no output port {missing};"):
        make_dynamic_grasp(scenario(name), tracker=tracker)
