"""What both controllers promise: the same ports, the same safe behaviour, the same goal."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantValueSource, LogVectorOutput

from feasigrasp.errors import ControlError
from feasigrasp.models.control.safety.safe_velocity import Safety, SafetyOptions
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.robot.self_collision import min_distance
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.systems.gp_joint_controller import GPJointController
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.rmm_task_controller import RMMTaskController

REACH = Reachability()
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
NEAR = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])
FAR = RigidTransform([3.0, 0.0, 0.5])
UNKNOWN = RigidTransform(np.full((4, 4), np.nan))
STILL = SpatialVelocity.Zero()

both = pytest.mark.parametrize("make", [RMMTaskController, GPJointController])


def ring(n=16):
    """Grasps round the object with many approach directions."""
    poses = [
        RigidTransform(
            RotationMatrix(RollPitchYaw(2 * np.pi * k / n, 0.7 * k, 0.3)), [0, 0, 0.01 * k - 0.08]
        ).GetAsMatrix4()
        for k in range(n)
    ]
    return GraspSet(np.array(poses), np.full(n, 0.04), np.ones(n))


class Bench:
    """A controller with inputs set by hand, after its first update."""

    def __init__(self, make, *, grasps=None, q=HOME, pose=NEAR, velocity=STILL, **kwargs):
        self.dut = make(REACH, **kwargs)
        self.simulator = Simulator(self.dut)
        self.context = self.simulator.get_mutable_context()
        self.fix(
            position=q,
            grasps=ring() if grasps is None else grasps,
            object_pose=pose,
            object_velocity=velocity,
        )
        self.advance(0.001)

    def fix(self, **inputs):
        for name, value in inputs.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def advance(self, t):
        self.simulator.AdvanceTo(t)

    def command(self):
        return self.dut.GetOutputPort("commanded_velocity").Eval(self.context).copy()


@both
def test_ports_are_those_of_the_docstring(make, ports, documented_ports):
    inputs, outputs = ports(make(REACH))
    assert (list(inputs), list(outputs)) == documented_ports(GraspController)


@both
def test_a_mode_that_there_is_not_is_refused(make):
    with pytest.raises(ControlError, match="mode is 'Paper'; choose one of safe, corrected, paper"):
        make(REACH, mode="Paper")


def test_either_controller_can_replace_the_other(ports):
    assert ports(RMMTaskController(REACH)) == ports(GPJointController(REACH))
    inputs, outputs = ports(RMMTaskController(REACH))
    assert inputs == {
        "position": 7,
        "grasps": None,
        "object_pose": None,
        "object_velocity": None,
        "desired_velocity": 7,
        "scene": None,
        "object_motion": None,
        "gpdf": None,
        "touch": 7,
    }
    assert outputs == {"commanded_velocity": 7}


@both
def test_a_reachable_grasp_makes_the_arm_move(make):
    qd = Bench(make).command()
    assert np.linalg.norm(qd) > 0.05
    assert np.all(np.abs(qd) < IIWA_7.velocity_limits)


@both
@pytest.mark.parametrize(
    "inputs",
    [
        {"grasps": GraspSet.empty()},
        {"grasps": GraspSet.empty({"object not seen": 1})},
        {"grasps": GraspSet.empty(), "velocity": SpatialVelocity(np.full(6, 0.3))},
        {"pose": FAR},
        {"pose": UNKNOWN},
        {"velocity": SpatialVelocity(np.full(6, np.nan))},
    ],
    ids=["empty", "not seen", "empty, moving", "out of reach", "pose unknown", "twist unknown"],
)
def test_with_nothing_to_follow_the_command_is_exactly_zero(make, inputs):
    np.testing.assert_array_equal(Bench(make, **inputs).command(), np.zeros(7))


@both
@pytest.mark.parametrize(
    "lost",
    [
        {"object_pose": UNKNOWN},
        {"object_velocity": SpatialVelocity(np.full(6, np.nan))},
        {"object_pose": FAR},
    ],
    ids=["pose unknown", "twist unknown", "out of reach"],
)
def test_an_object_that_is_lost_between_updates_stops_the_arm(make, lost):
    bench = Bench(make)
    assert np.linalg.norm(bench.command()) > 0.05
    bench.fix(**lost)
    np.testing.assert_array_equal(bench.command(), np.zeros(7))
    bench.advance(0.2)
    np.testing.assert_array_equal(bench.command(), np.zeros(7))
    bench.fix(object_pose=NEAR, object_velocity=STILL)
    bench.advance(0.4)
    assert np.linalg.norm(bench.command()) > 0.05


@both
def test_an_arm_that_touches_itself_is_not_held_there(make):
    """Without grasps the task-space command is to stop; the QP of either may push apart."""
    q = np.array([0.0, 2.0, 0.0, -2.0, 0.0, -2.0, 0.0])
    qd = Bench(make, grasps=GraspSet.empty(), q=q).command()
    assert np.isfinite(qd).all()
    assert min_distance(q + 1e-3 * qd) >= min_distance(q) - 1e-9


@both
@pytest.mark.parametrize("seed", range(3))
def test_commands_are_finite_and_inside_every_bound_in_random_states(make, seed):
    rng = np.random.default_rng(seed)
    grasps, options = ring(), SafetyOptions()
    moved = 0
    for _ in range(12):
        q = rng.uniform(-1, 1, 7) * IIWA_7.position_limits
        pose = RigidTransform(
            RotationMatrix(RollPitchYaw(rng.uniform(-3, 3, 3))), rng.uniform(-0.7, 0.7, 3)
        )
        velocity = SpatialVelocity(rng.normal(scale=0.5, size=6))
        qd = Bench(make, grasps=grasps, q=q, pose=pose, velocity=velocity).command()
        lower, upper = Safety(options).problem(q, np.zeros(7))[1][:2, :7]
        assert np.isfinite(qd).all()
        assert np.all((lower - 1e-9 <= qd) & (qd <= upper + 1e-9))
        moved += bool(np.any(qd))
    assert moved > 0


@both
def test_an_unknown_mode_is_refused(make):
    with pytest.raises(ControlError, match="'Paper'; choose one of safe, corrected, paper"):
        make(REACH, mode="Paper")


@both
@pytest.mark.parametrize("free", ["corrected", "paper"])
def test_other_modes_enforce_nothing(make, free):
    """The same state near a limit: the paper's law goes on, the safe one does not."""
    q = HOME.copy()
    q[5] = IIWA_7.position_limits[5] - 0.011
    spin = SpatialVelocity([0.0, -6.0, 0.0], [0.0, 0.0, 0.0])
    commands = {
        mode: Bench(make, q=q, velocity=spin, mode=mode).command() for mode in ("safe", free)
    }
    lower, upper = Safety().problem(q, np.zeros(7))[1][:2, :7]
    assert np.all((lower - 1e-9 <= commands["safe"]) & (commands["safe"] <= upper + 1e-9))
    assert np.isfinite(commands[free]).all()
    assert np.any((commands[free] > upper) | (commands[free] < lower))


@both
@pytest.mark.parametrize(
    "lost",
    [{"pose": UNKNOWN}, {"velocity": SpatialVelocity(np.full(6, np.nan))}],
    ids=["pose unknown", "twist unknown"],
)
def test_paper_mode_stops_too_when_the_object_is_unknown(make, lost):
    np.testing.assert_array_equal(Bench(make, mode="paper", **lost).command(), np.zeros(7))


class MovingObject(LeafSystem):
    def __init__(self, motion):
        super().__init__()
        self._motion = motion
        self.DeclareAbstractOutputPort("pose", Value[RigidTransform], self._calc_pose)
        self.DeclareAbstractOutputPort("velocity", Value[SpatialVelocity], self._calc_velocity)

    def _calc_pose(self, context, output):
        output.set_value(RigidTransform(self._motion.pose(context.get_time())))

    def _calc_velocity(self, context, output):
        output.set_value(SpatialVelocity(self._motion.velocity(context.get_time())))


class PerfectArm(LeafSystem):
    """An arm that does what it is told, at control rate."""

    def __init__(self, q):
        super().__init__()
        self._velocity = self.DeclareVectorInputPort("velocity", 7)
        self.DeclareStateOutputPort("position", self.DeclareDiscreteState(q))
        self.DeclarePeriodicDiscreteUpdateEvent(0.005, 0.0, self._update)

    def _update(self, context, discrete_state):
        q = context.get_discrete_state_vector().value()
        discrete_state.get_mutable_vector().SetFromVector(q + 0.005 * self._velocity.Eval(context))


def closed_loop(make, motion, duration, grasps, *, q=HOME, gpdf=None):
    """Joint positions every 0.05 s, shape (n, 7), of a controller that follows an object."""
    builder = DiagramBuilder()
    controller = builder.AddSystem(make(REACH))
    arm = builder.AddSystem(PerfectArm(q))
    target = builder.AddSystem(MovingObject(motion))
    source = builder.AddSystem(ConstantValueSource(AbstractValue.Make(grasps)))
    builder.Connect(arm.get_output_port(), controller.GetInputPort("position"))
    builder.Connect(source.get_output_port(), controller.GetInputPort("grasps"))
    builder.Connect(target.GetOutputPort("pose"), controller.GetInputPort("object_pose"))
    builder.Connect(target.GetOutputPort("velocity"), controller.GetInputPort("object_velocity"))
    field = builder.AddSystem(ConstantValueSource(Value[object](gpdf)))
    builder.Connect(field.get_output_port(), controller.GetInputPort("gpdf"))
    builder.Connect(controller.get_output_port(), arm.get_input_port())
    logger = LogVectorOutput(arm.get_output_port(), builder, 0.05)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    log = logger.FindLog(simulator.get_context())
    return log.sample_times(), log.data().T


def line(speed, spin):
    """Along y through x = 0.5, with about ``speed`` [m/s] at the start."""
    return HarmonicMotion(
        center=np.array([0.5, 0.0, 0.5]),
        amplitude=np.array([0.0, speed / 0.6, 0.0]),
        harmonic=np.ones(3),
        offset_deg=np.zeros(3),
        rate=0.6,
        start_phase=0.0,
        spin_axis=np.array([0.0, 0.0, 1.0]),
        spin=spin,
        R_WO=NEAR.rotation().matrix(),
    )


@both
@pytest.mark.parametrize(("speed", "spin"), [(0.0, 0.0), (0.08, 0.2)], ids=["still", "moving"])
def test_the_hand_gets_to_a_grasp_and_stays_there(make, speed, spin):
    motion = line(speed, spin)
    both_ways = ring().with_twins()
    reachable = REACH.reachable(motion.pose(0.0) @ both_ways.X_OG)
    grasps = both_ways.select(reachable)
    times, q = closed_loop(make, motion, 4.0, grasps)
    for t, q_t in zip(times[times > 3.5], q[times > 3.5], strict=True):
        X_WG = motion.pose(t) @ grasps.X_OG
        X_GH = np.linalg.inv(X_WG) @ forward_kinematics(q_t, REACH.gripper.X_FG)
        position = np.linalg.norm(X_GH[:, :3, 3], axis=1)
        cosine = (np.trace(X_GH[:, :3, :3], axis1=1, axis2=2) - 1) / 2
        angle = np.arccos(np.clip(cosine, -1, 1))
        assert np.any((position < 0.004) & (angle < 0.05)), (t, position.min(), angle.min())
    assert np.all(np.abs(q) < IIWA_7.position_limits)
    assert min(min_distance(q_t) for q_t in q) > 0.0


#: The hand points down, its fingers apart along y, 0.16 m above the table.
BESIDE = np.array([0.0, 0.55, 0.0, -1.6, 0.0, 0.99, 0.0])
BALL = 0.04  # radius


@pytest.fixture(scope="module")
def ball():
    """The field of a ball."""
    return fit_gpdf(sphere_points(400, BALL), length_scale=0.1)


def gaps(q, p_WO):
    """True distances (k,) of the points of the open hand from the ball."""
    X_WG = forward_kinematics(q, REACH.gripper.X_FG)
    hand = REACH.gripper.surface_points(REACH.gripper.max_opening)
    return np.linalg.norm(hand @ X_WG[:3, :3].T + X_WG[:3, 3] - p_WO, axis=1) - BALL


def in_the_way(direction, gap=0.004):
    """Where a ball is that is this far from the hand, and a grasp of it on its other side."""
    X_WG = forward_kinematics(BESIDE, REACH.gripper.X_FG)
    away = np.linspace(0.0, 0.25, 501)[::-1]
    places = X_WG[:3, 3] + away[:, None] * np.array(direction, dtype=float)
    near = [p for p in places if gaps(BESIDE, p).min() < gap]
    X_OG = X_WG.copy()
    X_OG[:3, 3] = 0.12 * np.array(direction)
    return near[0], GraspSet(X_OG[None], np.full(1, 0.04), np.ones(1))


def slack(q, qd, p_WO, V_WO):
    """By how much every point of the hand near the ball approaches it more slowly than it may."""
    step, options = 1e-6, SafetyOptions()
    gap = gaps(q, p_WO)
    rate = (gaps(q + step * qd, p_WO + step * V_WO[3:]) - gap) / step
    allowed = options.approach_gain * (gap - options.object_clearance)
    return (rate + allowed)[gap < 0.045]


aside = pytest.mark.parametrize("direction", [[0, 1, 0], [0, -1, 0]], ids=["left", "right"])


@both
@aside
@pytest.mark.parametrize("coming", [0.0, 0.1], ids=["still", "coming"])
def test_the_open_hand_does_not_push_the_ball_that_is_in_its_way(make, ball, direction, coming):
    p_WO, grasps = in_the_way(direction)
    V_WO = np.concatenate([np.zeros(3), -coming * np.array(direction)])
    seen = {"grasps": grasps, "pose": RigidTransform(p_WO), "velocity": SpatialVelocity(V_WO)}
    bench = Bench(make, q=BESIDE, **seen)
    free = bench.command()
    assert slack(BESIDE, free, p_WO, V_WO).min() < -0.2
    bench.fix(gpdf=Value[object](ball))
    safe = bench.command()
    assert np.isfinite(safe).all()
    assert np.linalg.norm(safe) > 0.1
    assert slack(BESIDE, safe, p_WO, V_WO).min() > -0.01
    bench.fix(gpdf=Value[object](None))  # e.g. from the moment the hand closes
    np.testing.assert_array_equal(bench.command(), free)


@both
def test_paper_mode_looks_at_no_field(make, ball):
    p_WO, grasps = in_the_way([0, 1, 0])
    bench = Bench(make, q=BESIDE, grasps=grasps, pose=RigidTransform(p_WO), mode="paper")
    qd = bench.command()
    bench.fix(gpdf=Value[object](ball))
    np.testing.assert_array_equal(bench.command(), qd)


@both
def test_a_field_of_an_object_that_is_lost_stops_the_arm_too(make, ball):
    p_WO, grasps = in_the_way([0, 1, 0])
    bench = Bench(make, q=BESIDE, grasps=grasps, pose=RigidTransform(p_WO))
    bench.fix(gpdf=Value[object](ball))
    assert np.linalg.norm(bench.command()) > 0.1
    for name, lost in (
        ("object_pose", UNKNOWN),
        ("object_velocity", SpatialVelocity(np.full(6, np.nan))),
    ):
        bench.fix(object_pose=RigidTransform(p_WO), object_velocity=STILL)
        bench.fix(**{name: lost})
        np.testing.assert_array_equal(bench.command(), np.zeros(7))


@both
@aside
def test_the_open_hand_goes_round_the_ball_to_its_grasp(make, ball, direction):
    p_WO, grasps = in_the_way(direction)
    still = HarmonicMotion(**(vars(line(0.0, 0.0)) | {"center": p_WO, "R_WO": np.eye(3)}))
    nearest = []
    for gpdf in (None, ball):
        _, q = closed_loop(make, still, 4.0, grasps, q=BESIDE, gpdf=gpdf)
        nearest.append(min(gaps(q_t, p_WO).min() for q_t in q))
        p_OH = forward_kinematics(q[-1], REACH.gripper.X_FG)[:3, 3] - p_WO
        np.testing.assert_allclose(p_OH, grasps.X_OG[0, :3, 3], atol=1e-3)
    assert nearest[0] < -0.02  # the direct way is through the ball
    assert nearest[1] > 0.0
