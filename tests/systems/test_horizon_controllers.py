"""What both receding-horizon controllers do: rates, states, commands, and whole roll-outs."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ZeroOrderHold

from feasigrasp.errors import ControlError
from feasigrasp.models.control.horizon.law import HorizonOptions
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems import horizon_controller
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp.systems.metrics import SAMPLE_NAMES
from feasigrasp.systems.velocity_drive import VelocityDrive
from feasigrasp_lab.paper.modes import PaperJointController
from feasigrasp_lab.protocols.changes import at_spin
from tests.controller_bench import HOME, NEAR, REACH, STILL, UNKNOWN, Bench
from tests.rollout import object_grasps, roll_out

CONTROLLERS = [RMMTaskController, GPJointController]
both = pytest.mark.parametrize("make", CONTROLLERS)
PERIOD, TICK = ProgramOptions().steps[0], SafetyOptions().period


def grasps_near(X_OG, n=20, seed=0):
    """Grasps scattered about a pose."""
    rng = np.random.default_rng(seed)
    noise = se3.exp(rng.normal(size=(n, 6)) * [0.1, 0.1, 0.1, 0.01, 0.01, 0.01])
    return GraspSet(X_OG @ noise, np.full(n, 0.04), np.ones(n))


def two_clusters(seed=0):
    turned = se3.exp([0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
    first, second = grasps_near(np.eye(4), seed=seed), grasps_near(turned, seed=seed + 1)
    return GraspSet(np.concatenate([first.X_OG, second.X_OG]), np.full(40, 0.04), np.ones(40))


def grasp_ahead(distance):
    """A grasp ahead of the hand at HOME, along its approach direction."""
    ahead = RigidTransform([0.0, 0.0, distance]).GetAsMatrix4()
    X_WG = forward_kinematics(HOME, REACH.gripper.X_FG) @ ahead
    return GraspSet((NEAR.inverse().GetAsMatrix4() @ X_WG)[None], np.array([0.04]), np.ones(1))


def memory(bench):
    return bench.dut.memory(bench.context)


def test_options_of_another_arm_are_refused():
    with pytest.raises(ControlError, match="is iiwa, that of reachability iiwa14; give Safety"):
        RMMTaskController(Reachability(arm=load_arm("iiwa14")), HorizonOptions())


@both
@pytest.mark.parametrize("period", [0.02, 0.05])
def test_plans_are_made_exactly_once_per_period(make, monkeypatch, period):
    times, plan = [], horizon_controller.next_plan
    steps = (period, *ProgramOptions().steps[1:])
    bench = Bench(make, options=HorizonOptions(program=ProgramOptions(steps=steps)))

    def counting(before, now, *args, **kwargs):
        times.append(now.time)
        return plan(before, now, *args, **kwargs)

    monkeypatch.setattr(horizon_controller, "next_plan", counting)
    for k in range(1, 80):
        bench.advance(0.005 * k)
        bench.command()
    np.testing.assert_allclose(times, np.arange(period, 0.395, period), atol=1e-9)


@both
def test_before_its_first_update_it_stops(make):
    dut = make(REACH)
    context = dut.CreateDefaultContext()
    for name, value in {
        "position": HOME,
        "grasps": AbstractValue.Make(grasp_ahead(0.05)),
        "object_pose": AbstractValue.Make(NEAR),
        "object_velocity": AbstractValue.Make(STILL),
    }.items():
        dut.GetInputPort(name).FixValue(context, value)
    qd = dut.GetOutputPort("commanded_velocity").Eval(context)
    np.testing.assert_array_equal(qd, np.zeros(7))


@pytest.mark.parametrize("make", [*CONTROLLERS, PaperJointController])
def test_it_heads_for_the_only_grasp(make):
    """The hand moves straight ahead: the solution nearest to HOME is near the straight line."""
    qd = Bench(make, grasps=grasp_ahead(0.03)).command()
    before = forward_kinematics(HOME, REACH.gripper.X_FG)
    after = forward_kinematics(HOME + 1e-4 * qd, REACH.gripper.X_FG)
    direction = (after - before)[:3, 3]
    assert direction @ before[:3, 2] / np.linalg.norm(direction) > 0.95


@both
def test_a_hand_at_a_grasp_goes_with_the_object(make):
    """Two seconds: the object moves 10 cm, and the arm with it."""
    speed, grasps = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0]), grasp_ahead(0.0)
    bench, q, qd = Bench(make, grasps=grasps, velocity=SpatialVelocity(speed)), HOME, np.zeros(7)
    for k in range(1, 401):
        moved = RigidTransform(NEAR.rotation(), NEAR.translation() + speed[3:] * TICK * k)
        qd = bench.command()
        q = q + TICK * qd
        bench.fix(position=q, object_pose=moved, desired_velocity=qd)
        bench.advance(TICK * k)
    hand = forward_kinematics(q, REACH.gripper.X_FG)
    target = moved.GetAsMatrix4() @ grasps.X_OG[0]
    assert np.linalg.norm((hand - target)[:3, 3]) < 0.002
    assert np.linalg.norm((hand - forward_kinematics(HOME, REACH.gripper.X_FG))[:3, 3]) > 0.09


@both
def test_a_hand_that_has_committed_is_at_the_grasp_that_it_is_given(make):
    """One that has not goes on with what it went for, for a while, and then changes its mind."""
    first = grasps_near(np.eye(4), n=1)
    flip = first.with_symmetric().select([1])
    free, committed = Bench(make, grasps=first), Bench(make, grasps=first)
    committed.fix(phase=[Phase.CLOSE])
    for bench in (free, committed):
        np.testing.assert_array_equal(memory(bench).X_OG, first.X_OG[0])
        bench.fix(grasps=flip)
        bench.advance(2.0 * PERIOD)
    np.testing.assert_array_equal(memory(free).X_OG, first.X_OG[0])
    np.testing.assert_array_equal(memory(committed).X_OG, flip.X_OG[0])
    chosen = committed.dut.GetOutputPort("chosen_grasp").Eval(committed.context)
    np.testing.assert_array_equal(chosen, flip.X_OG[0].ravel())
    free.advance(1.0)
    assert memory(free).X_OG is None or np.array_equal(memory(free).X_OG, flip.X_OG[0])


@both
def test_without_grasps_there_is_no_plan_and_no_motion(make):
    bench = Bench(make, grasps=GraspSet.empty())
    assert memory(bench).X_OG is None and memory(bench).v is None
    np.testing.assert_array_equal(bench.command(), np.zeros(7))
    assert np.isnan(bench.dut.GetOutputPort("chosen_grasp").Eval(bench.context)).all()


@both
def test_the_output_is_a_function_of_the_context(make):
    """Asked again, in whatever order, it says the same; asking changes nothing."""
    bench, commands = Bench(make, grasps=two_clusters()), {}
    for _ in range(2):
        for angle in (0.0, 0.2, -0.1):
            bench.fix(position=HOME + angle, desired_velocity=np.full(7, angle))
            qd = bench.command()
            np.testing.assert_array_equal(commands.setdefault(angle, qd), qd)
    assert len({tuple(qd) for qd in commands.values()}) == 3


@both
def test_the_desired_velocity_limits_the_next_command(make):
    bench = Bench(make, grasps=two_clusters())
    free = bench.command()
    last = -0.2 * np.ones(7)
    bench.fix(desired_velocity=last)
    qd = bench.command()
    assert (np.abs(qd - last) <= IIWA_7.acceleration_limits * TICK + 1e-9).all()
    assert np.abs(qd - free).max() > 0.1


@both
@pytest.mark.parametrize("updates", [0, 3])
def test_a_lost_object_makes_the_arm_brake_not_stop_dead(make, updates):
    bench, last = Bench(make, grasps=two_clusters()), np.full(7, 0.5)
    bench.fix(object_pose=UNKNOWN, desired_velocity=last)
    bench.advance(0.001 + updates * PERIOD)
    qd = bench.command()
    assert (qd < last).all() and (qd > 0.4).all()


def test_the_two_differ_among_several_grasps():
    """One pulls the hand, the other the joints; with one grasp ahead, both lead there."""
    two = [Bench(make, grasps=two_clusters()) for make in CONTROLLERS]
    np.testing.assert_array_equal(*(memory(bench).X_OG for bench in two))
    assert np.abs(memory(two[0]).v - memory(two[1]).v).max() > 0.05


@both
def test_new_grasps_cause_no_jump_in_a_loop_with_the_drive(make):
    """Every 0.1 s other grasps of the same kind; measured before the drive clips anything."""
    builder = DiagramBuilder()
    controller, drive = builder.AddSystem(make(REACH)), builder.AddSystem(VelocityDrive(TICK))
    pose = builder.AddSystem(ConstantValueSource(AbstractValue.Make(NEAR)))
    twist = builder.AddSystem(ConstantValueSource(AbstractValue.Make(STILL)))
    grasps = builder.AddSystem(ZeroOrderHold(1e3, AbstractValue.Make(GraspSet.empty())))
    builder.ExportInput(grasps.get_input_port(), "sets")
    for source, port in (
        (grasps.get_output_port(), "grasps"),
        (pose.get_output_port(), "object_pose"),
        (twist.get_output_port(), "object_velocity"),
        (drive.GetOutputPort("desired_velocity"), "desired_velocity"),
    ):
        builder.Connect(source, controller.GetInputPort(port))
    builder.Connect(controller.GetOutputPort("commanded_velocity"), drive.GetInputPort("velocity"))
    builder.ExportInput(drive.GetInputPort("position"), "position")
    builder.ConnectInput("position", controller.GetInputPort("position"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    hold = grasps.GetMyMutableContextFromRoot(context)
    diagram.GetInputPort("position").FixValue(context, HOME)
    diagram.GetInputPort("sets").FixValue(context, AbstractValue.Make(GraspSet.empty()))
    simulator.Initialize()
    state = drive.GetOutputPort("desired_state")
    command, last, moved = controller.GetOutputPort("commanded_velocity"), np.zeros(7), 0.0
    for tick in range(200):
        if tick % 20 == 0:
            hold.SetAbstractState(0, two_clusters(seed=tick))
        qd = command.Eval(controller.GetMyContextFromRoot(context))
        assert (np.abs(qd - last) <= IIWA_7.acceleration_limits * TICK + 1e-9).all()
        simulator.AdvanceTo((tick + 1) * TICK)
        desired = state.Eval(drive.GetMyContextFromRoot(context))
        diagram.GetInputPort("position").FixValue(context, desired[:7])
        last, moved = desired[7:].copy(), max(moved, np.abs(qd).max())
    assert moved > 0.3


@pytest.mark.parametrize("space", ["task", "joint"])
def test_a_ball_that_spins_at_1_5_rad_s_is_followed_inside_the_limits(space):
    """The hand is at a grasp within 6 mm and 0.08 rad, as for closing."""
    text = f"{{control: {{controller: {space}}}}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachCircularMocap", text)
    scenario.random_seed = scenario.tracker.seed = 101
    scenario.object.model = "ball"
    at_spin(1.5)(scenario)
    run = roll_out(scenario, object_grasps("ball", 1.0, 101), duration=4.0)
    x = dict(zip(SAMPLE_NAMES, run.samples, strict=True))
    there = (x["grasp_position_error"] < 0.006) & (x["grasp_angle_error"] < 0.08)
    assert there[run.times > 1.0].mean() > 0.2
    for limit in ("joint_limit", "velocity_limit", "acceleration_limit"):
        assert run.metrics[f"{limit}_violation_percent"] == 0.0
    assert run.metrics["self_collision_percent"] == 0.0
