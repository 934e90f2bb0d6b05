"""The whole pipeline: what is called how often, what is connected, when the arm stands still."""

import dataclasses
import textwrap

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from feasigrasp.errors import ScenarioError
from feasigrasp.evaluation.metrics.robot_limits import self_collision_metrics
from feasigrasp.evaluation.metrics.robot_twin import robot_twin
from feasigrasp.models.clouds.usable import ViewFault
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import dump_scenario, load_scenario
from feasigrasp.systems import (
    gp_joint_controller,
    grasp_sampler,
    point_cloud_to_gpdf,
    reachability_filter,
    rmm_task_controller,
    velocity_drive,
)
from feasigrasp.systems.dynamic_grasp import Subsystems, make_dynamic_grasp
from feasigrasp.systems.from_scenario import make_controller
from feasigrasp.systems.gp_joint_controller import GPJointController
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.metrics import SAMPLE_NAMES
from feasigrasp.systems.rmm_task_controller import RMMTaskController
from feasigrasp.systems.station import object_servo

FILE = diagram_path("dynamic.scenarios.yaml")
DURATION = 1.0


def scenario(name="ReachLinear", text=""):
    return load_scenario(FILE, name, "{object: {model: soup_can}, random_seed: 3}", text)


def wrap(monkeypatch, calls, owner, name):
    """Counts the calls of a function, or method, under its name."""
    original = getattr(owner, name)

    def counting(*args, **kwargs):
        calls[name] = calls.get(name, 0) + 1
        return original(*args, **kwargs)

    monkeypatch.setattr(owner, name, counting)


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_every_stage_runs_at_its_own_rate(controller, monkeypatch):
    """Perception 2 Hz, adaptation 10 Hz, control 200 Hz, plant 400 Hz, over one second."""
    calls: dict[str, int] = {}
    for owner, name in (
        (point_cloud_to_gpdf, "complete_shape"),
        (NetworkSampler, "__call__"),
        (grasp_sampler.GraspSampler, "_calc"),
        (reachability_filter, "judge_grasps"),
        (rmm_task_controller.RMMTaskController, "update"),
        (rmm_task_controller, "task_space_velocity"),
        (gp_joint_controller.JointSpaceControl, "update"),
        (gp_joint_controller.JointSpaceControl, "velocity"),
        (velocity_drive.VelocityDrive, "_update"),
        (object_servo, "motion_wrench_kernel"),
    ):
        wrap(monkeypatch, calls, owner, name)
    config = scenario(text=f"{{control: {{controller: {controller}}}, grasp: {{close: false}}}}")
    simulator = Simulator(make_dynamic_grasp(config))
    calls.clear()  # a controller runs one step when it is made, to compile its kernels
    simulator.AdvanceTo(DURATION)

    assert calls.pop("complete_shape") == 2
    assert calls.pop("__call__") == 2
    assert calls.pop("_calc") == 2  # read by the latency's hold alone, 0.1 s after each view
    assert calls.pop("judge_grasps") == 10
    assert calls.pop("_update") == 200
    # Once more when the state of a slow stage changes between the log of the torque and the step.
    assert 400 <= calls.pop("motion_wrench_kernel") <= 410
    if controller == "task":
        assert calls.pop("update") == 10
        assert calls.pop("task_space_velocity") == 200
    else:
        assert calls.pop("update") == 10
        assert calls.pop("velocity") == 200
    assert calls == {}


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


#: Inputs that are for scenes that are looked at, and for measurements that come with a time stamp.
OPEN = {
    ("controller", "scene"),
    ("status", "scene"),
    ("tracker", "stamp"),
    ("metrics", "frame_pose"),
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
        "ReachLinear",
        f"{{motion: {{rate: 0.05, spin: 0}}, control: {{mode: {mode}}}, grasp: {{close: false}},"
        " camera_noise: {}}",
    )
    controller = own_controller()(Reachability(), mode=mode)
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


def arm_positions(config, duration):
    """Arm positions and commands at 50 Hz, and the diagram with its context at the end."""
    diagram = make_dynamic_grasp(config)
    simulator = Simulator(diagram)
    controller, station = (diagram.GetSubsystemByName(n) for n in ("controller", "station"))
    q, command = [], []
    for k in range(round(duration / 0.02) + 1):
        simulator.AdvanceTo(0.02 * k)
        root = simulator.get_context()
        q.append(
            station.GetOutputPort("iiwa.position_measured")
            .Eval(station.GetMyContextFromRoot(root))
            .copy()
        )
        command.append(
            controller.get_output_port().Eval(controller.GetMyContextFromRoot(root)).copy()
        )
    return np.array(q), np.array(command), diagram, simulator.get_context()


@pytest.mark.parametrize("controller", ["task", "joint"])
@pytest.mark.parametrize(
    ("center", "reason"),
    [([-1.5, 0.0, 0.5], "object not seen"), ([1.15, 0.0, 0.75], "wrist out of reach")],
    ids=["not seen", "out of reach"],
)
def test_an_object_that_cannot_be_grasped_leaves_the_arm_where_it_is(controller, center, reason):
    config = scenario(
        text=f"{{motion: {{center: {center}, amplitude: [0, 0, 0]}},"
        f" control: {{controller: {controller}}}}}"
    )
    if reason == "wrist out of reach":  # look ahead, to where the object is
        config.q_start = [0.0, -30.0, 0.0, -90.0, 0.0, 25.0, 0.0]
    q, command, diagram, context = arm_positions(config, 0.3)
    np.testing.assert_array_equal(command, 0.0)
    np.testing.assert_allclose(q, np.tile(np.deg2rad(config.q_start), (len(q), 1)), atol=1e-4)
    reachable = diagram.GetSubsystemByName("reachable")
    grasps = reachable.get_output_port().Eval(reachable.GetMyContextFromRoot(context))
    assert len(grasps) == 0
    assert grasps.rejected[reason] > 0


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_the_arm_sets_off_for_a_grasp_once_it_has_one(controller):
    config = scenario(text=f"{{control: {{controller: {controller}}}}}")
    q, command, diagram, context = arm_positions(config, 0.6)
    # Nothing before the latency of perception has passed.
    before = np.arange(len(q)) * 0.02 < config.perception.latency - 1e-9
    np.testing.assert_array_equal(command[before], 0.0)
    assert np.linalg.norm(command[-1]) > 0.02
    assert np.isfinite(command).all()
    assert np.all(np.abs(q) < IIWA_7.position_limits)
    logger = diagram.GetSubsystemByName("log(metrics)")
    samples = dict(zip(SAMPLE_NAMES, logger.FindLog(context).data(), strict=True))
    error = samples["grasp_position_error"][np.isfinite(samples["grasp_position_error"])]
    assert error[-1] < error[0]
    assert self_collision_metrics(robot_twin(config.directives), q)["self_collision_percent"] == 0.0


def test_latency_delays_the_grasps(monkeypatch):
    slow = scenario(text="{perception: {latency: 0.3}}")
    _, command, _, _ = arm_positions(slow, 0.5)
    moving = np.flatnonzero(np.any(command, axis=1)) * 0.02
    assert 0.3 - 1e-9 <= moving[0] <= 0.3 + slow.reachability.period + 0.02


def test_the_time_of_a_view_arrives_with_its_grasps():
    built = make_dynamic_grasp(scenario(text="{perception: {latency: 0.23}}"))
    grasps, seen_at = (built.GetSubsystemByName(n) for n in ("latency", "seen_at(latency)"))
    simulator, pairs = Simulator(built), []
    for t in np.arange(0.0, 1.5, 0.01):
        simulator.AdvanceTo(t)
        root = simulator.get_context()
        there = grasps.get_output_port().Eval(grasps.GetMyContextFromRoot(root))
        time = seen_at.get_output_port().Eval(seen_at.GetMyContextFromRoot(root))[0]
        if len(there) > 0:
            pairs.append((there, time, t))
    sets, times = {id(there) for there, _, _ in pairs}, {time for _, time, _ in pairs}
    assert times == {0.0, 0.5, 1.0}
    assert len(sets) == len({(id(there), time) for there, time, _ in pairs}) == 3
    assert all(0.22 < t - time < 0.74 for _, time, t in pairs)


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
        config = scenario("ReachObstacle", f"{{control: {{controller: {controller}}}}}")
        built = make_dynamic_grasp(config)
        sources = {
            (sink[0].get_name(), sink[0].get_input_port(sink[1]).get_name()): source[0].get_name()
            for sink, source in built.connection_map().items()
        }
        assert sources["controller", "scene"] == "scene_perception"
        assert sources["controller", "desired_velocity"] == "drive"
        assert sources["obstacle_distance", "query_object"] == "station"
        assert built.HasSubsystemNamed("log(obstacle_distance)")
    without = make_dynamic_grasp(scenario("ReachObstacle", "{scene: {enabled: false}}"))
    assert not without.HasSubsystemNamed("scene_perception")


def test_an_object_that_was_never_measured_moves_nothing():
    """No truth leaks: nothing is perceived, the arm stays where it is, and every view is named."""
    config = scenario("ReachObstacle", "{tracker: {dropout: 1.0}}")
    diagram = make_dynamic_grasp(config)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.6)
    context = simulator.get_context()
    perception, log = (diagram.GetSubsystemByName(name) for name in ("perception", "log(drive)"))
    seen = perception.GetOutputPort("perceived").Eval(perception.GetMyContextFromRoot(context))
    assert seen.gpdf is None
    assert seen.faults == {ViewFault.UNKNOWN_POSE: 2}  # at 0 and at 0.5 s
    q = log.FindLog(context).data()[
        :7
    ]  # what is sent: the object that nobody sees may push the arm
    np.testing.assert_array_equal(q, np.broadcast_to(q[:, :1], q.shape))
