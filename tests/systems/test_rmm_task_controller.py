"""The mixture is fitted once per grasp set and goes on from the one before; commands are smooth."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ZeroOrderHold

from feasigrasp.models.control.task import memory as task_memory
from feasigrasp.models.control.task.safe_law import TaskControlOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.rmm_task_controller import RMMTaskController
from feasigrasp.systems.velocity_drive import VelocityDrive

REACH = Reachability()
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
X_WO = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])
STILL = SpatialVelocity.Zero()
PERIOD = 0.05


def grasps_near(X_OG, n=20, seed=0):
    """Grasps scattered about a pose."""
    rng = np.random.default_rng(seed)
    noise = se3.exp(rng.normal(size=(n, 6)) * [0.1, 0.1, 0.1, 0.01, 0.01, 0.01])
    return GraspSet(X_OG @ noise, np.full(n, 0.04), np.ones(n))


def two_clusters(seed=0):
    predicted = np.eye(4)
    turned = se3.exp([0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
    first, second = grasps_near(predicted, seed=seed), grasps_near(turned, seed=seed + 1)
    return GraspSet(np.concatenate([first.X_OG, second.X_OG]), np.full(40, 0.04), np.ones(40))


class Bench:
    """A controller with inputs set by hand, after its first update."""

    def __init__(self, *, grasps, q=HOME, velocity=STILL, **kwargs):
        self.dut = RMMTaskController(REACH, period=PERIOD, **kwargs)
        self.simulator = Simulator(self.dut)
        self.context = self.simulator.get_mutable_context()
        self.fix(position=q, grasps=grasps, object_pose=X_WO, object_velocity=velocity)
        self.simulator.Initialize()
        self.simulator.AdvanceTo(1e-3)

    def fix(self, **inputs):
        for name, value in inputs.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def next_update(self):
        self.simulator.AdvanceTo(self.context.get_time() + PERIOD)

    @property
    def mixture(self):
        return self.dut.memory(self.context).mixture

    def command(self):
        return self.dut.GetOutputPort("commanded_velocity").Eval(self.context).copy()


def test_the_mixture_is_fitted_once_per_grasp_set(monkeypatch):
    fits, fit = [], task_memory.fit_grasp_mixture

    def counting(grasps, *args):
        fits.append(grasps)
        return fit(grasps, *args)

    monkeypatch.setattr(task_memory, "fit_grasp_mixture", counting)
    first, second = grasps_near(np.eye(4)), grasps_near(np.eye(4), seed=1)
    bench = Bench(grasps=first)
    fits[:] = [grasps for grasps in fits if grasps is first]  # others: to compile the kernels
    for k in range(3):
        bench.fix(position=HOME + 0.01 * k)
        bench.next_update()
        bench.command()
    assert len(fits) == 1
    bench.fix(grasps=second)
    bench.next_update()
    bench.next_update()
    assert [grasps is second for grasps in fits] == [False, True]
    assert bench.mixture.X_OG is second.X_OG


def test_components_keep_their_identity_when_grasps_go_and_come_back():
    everything = two_clusters()
    bench = Bench(grasps=everything)
    before = bench.mixture
    assert len(before.mixture) == 2
    predicted = np.argmin(np.abs(before.mixture.means - np.eye(4)).max(axis=(1, 2)))
    keep = before.component == predicted
    for grasps in (everything.select(keep), GraspSet.empty(), everything.select(keep)):
        bench.fix(grasps=grasps)
        bench.next_update()
    (identity,) = bench.mixture.identity
    assert identity == before.identity[predicted]
    bench.fix(grasps=everything)
    bench.next_update()
    assert len(bench.mixture.mixture) == 2
    assert identity in bench.mixture.identity


def test_a_hand_that_has_committed_is_at_the_grasp_that_it_is_given():
    """One that has not goes on with what it went for, for a while, and then changes its strand."""
    first = grasps_near(np.eye(4), n=1)
    flip = first.with_symmetric().select([1])
    free, committed = Bench(grasps=first), Bench(grasps=first)
    committed.fix(phase=[Phase.CLOSE])
    for bench in (free, committed):
        bench.fix(grasps=flip)
        bench.next_update()
    chosen = [bench.dut.memory(bench.context).choice for bench in (free, committed)]
    np.testing.assert_array_equal(chosen[0].X_OG, first.X_OG[0])
    np.testing.assert_array_equal(chosen[1].X_OG, flip.X_OG[0])
    assert chosen[0].count == chosen[1].count == 1


def test_the_seed_decides_the_mixture():
    """Grasps without clusters: where the components come to lie depends on where they start."""
    spread = se3.exp(np.random.default_rng(0).normal(size=(60, 6)) * [0.5, 0.5, 0.5, 0.1, 0.1, 0.1])
    grasps = GraspSet(spread, np.full(60, 0.04), np.ones(60))
    first, again, other = (Bench(grasps=grasps, seed=seed).mixture.mixture for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.means, again.means)
    np.testing.assert_array_equal(first.covariances, again.covariances)
    assert len(other) != len(first) or np.abs(other.means - first.means).max() > 1e-3


def test_without_grasps_there_is_no_mixture_and_no_motion():
    bench = Bench(grasps=GraspSet.empty())
    assert bench.mixture is None
    np.testing.assert_array_equal(bench.command(), np.zeros(7))


def test_the_output_is_a_function_of_the_context():
    """Asked again, in whatever order, it says the same; asking changes nothing."""
    bench = Bench(grasps=two_clusters())
    commands = {}
    for _ in range(2):
        for angle in (0.0, 0.2, -0.1):
            bench.fix(position=HOME + angle)
            qd = bench.command()
            np.testing.assert_array_equal(commands.setdefault(angle, qd), qd)
    assert len({tuple(qd) for qd in commands.values()}) == 3


def test_the_desired_velocity_limits_the_next_command():
    bench = Bench(grasps=two_clusters())
    free = bench.command()
    assert np.abs(free).max() > 0.1
    last = -0.2 * np.ones(7)
    bench.fix(desired_velocity=last)
    qd = bench.command()
    most = IIWA_7.acceleration_limits * TaskControlOptions().safety.period
    assert (np.abs(qd - last) <= most + 1e-9).all()
    assert np.abs(qd - free).max() > 0.1


def test_a_lost_object_makes_the_arm_brake_not_stop_dead():
    bench = Bench(grasps=two_clusters())
    last = np.full(7, 0.5)
    bench.fix(object_pose=RigidTransform(np.full((4, 4), np.nan)), desired_velocity=last)
    qd = bench.command()
    assert (qd < last).all() and (qd > 0.4).all()


def test_refits_cause_no_jump_in_a_loop_with_the_drive():
    """Every 0.1 s other grasps of the same kind; measured before the drive clips anything."""
    builder = DiagramBuilder()
    controller = builder.AddSystem(RMMTaskController(REACH, period=PERIOD))
    drive = builder.AddSystem(VelocityDrive(0.005))
    pose = builder.AddSystem(ConstantValueSource(AbstractValue.Make(X_WO)))
    twist = builder.AddSystem(ConstantValueSource(AbstractValue.Make(STILL)))
    grasps = builder.AddSystem(ZeroOrderHold(1e3, AbstractValue.Make(GraspSet.empty())))
    builder.ExportInput(grasps.get_input_port(), "sets")
    builder.Connect(grasps.get_output_port(), controller.GetInputPort("grasps"))
    builder.Connect(pose.get_output_port(), controller.GetInputPort("object_pose"))
    builder.Connect(twist.get_output_port(), controller.GetInputPort("object_velocity"))
    builder.Connect(controller.GetOutputPort("commanded_velocity"), drive.GetInputPort("velocity"))
    builder.Connect(
        drive.GetOutputPort("desired_velocity"), controller.GetInputPort("desired_velocity")
    )
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
        assert (np.abs(qd - last) <= IIWA_7.acceleration_limits * 0.005 + 1e-9).all()
        simulator.AdvanceTo((tick + 1) * 0.005)
        desired = state.Eval(drive.GetMyContextFromRoot(context))
        diagram.GetInputPort("position").FixValue(context, desired[:7])
        last, moved = desired[7:].copy(), max(moved, np.abs(qd).max())
    assert moved > 0.3
