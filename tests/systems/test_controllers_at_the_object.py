"""Either controller leads the hand to a grasp, round the object and without pushing it."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantValueSource, LogVectorOutput

from feasigrasp.models.arrays import Frozen
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp.systems.ports import declare_output, to_value
from tests.controller_bench import HOME, NEAR, REACH, STILL, UNKNOWN, Bench, every, ring
from tests.truths import min_distance


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
    predictor = builder.AddSystem(KnownMotion(motion))
    builder.Connect(predictor.get_output_port(), controller.GetInputPort("object_motion"))
    field = builder.AddSystem(ConstantValueSource(to_value(gpdf)))
    builder.Connect(field.get_output_port(), controller.GetInputPort("gpdf"))
    builder.Connect(controller.GetOutputPort("commanded_velocity"), arm.get_input_port())
    logger = LogVectorOutput(arm.get_output_port(), builder, 0.05)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    log = logger.FindLog(simulator.get_context())
    return log.sample_times(), log.data().T


class Predictor(Frozen):
    """Predicts by the true path."""

    known = True

    def __init__(self, motion, time):
        self.motion, self.time = motion, time

    def predict(self, ahead, v_WO=None):
        return np.array([self.motion.pose(self.time + t) for t in np.ravel(ahead)])


class KnownMotion(LeafSystem):
    """The object's motion at each time, as a tracker that has seen enough of it gives it."""

    def __init__(self, motion):
        super().__init__()
        declare_output(self, "motion", lambda context: Predictor(motion, context.get_time()))


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


@every
@pytest.mark.parametrize(("speed", "spin"), [(0.0, 0.0), (0.08, 0.2)], ids=["still", "moving"])
def test_the_hand_gets_to_a_grasp_and_stays_there(make, speed, spin):
    motion = line(speed, spin)
    both_ways = ring().with_symmetric()
    reachable = REACH.reachable(motion.pose(0.0) @ both_ways.X_OG)
    grasps = both_ways.select(reachable)
    times, q = closed_loop(make, motion, 4.6, grasps)
    there = (times > 2.0) & (times < 4.3)  # then a joint limit comes near that of the moving one
    for t, q_t in zip(times[there], q[there], strict=True):
        X_WG = motion.pose(t) @ grasps.X_OG
        X_GH = np.linalg.inv(X_WG) @ forward_kinematics(q_t, REACH.gripper.X_FG)
        position = np.linalg.norm(X_GH[:, :3, 3], axis=1)
        cosine = (np.trace(X_GH[:, :3, :3], axis1=1, axis2=2) - 1) / 2
        angle = np.arccos(np.clip(cosine, -1, 1))
        assert np.any((position < 0.002) & (angle < 0.02)), (t, position.min(), angle.min())
    assert np.all(np.abs(q) < IIWA_7.upper)
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
    """Where a ball is that is this far from the hand, and a grasp of it on its other side.

    The grasp is deeper than the hand: on the way back from it, it would hit the ball.
    """
    X_WG = forward_kinematics(BESIDE, REACH.gripper.X_FG)
    away = np.linspace(0.0, 0.25, 501)[::-1]
    places = X_WG[:3, 3] + away[:, None] * np.array(direction, dtype=float)
    near = [p for p in places if gaps(BESIDE, p).min() < gap]
    X_OG = X_WG.copy()
    X_OG[:3, 3] = 0.12 * np.array(direction) + 0.08 * X_OG[:3, 2]
    return near[0], GraspSet(X_OG[None], np.full(1, 0.04), np.ones(1))


def slack(q, qd, p_WO, V_WO):
    """By how much every point of the hand near the ball approaches it more slowly than it may."""
    step, options = 1e-6, SafetyOptions()
    gap = gaps(q, p_WO)
    rate = (gaps(q + step * qd, p_WO + step * V_WO[3:]) - gap) / step
    left = gap - options.object_clearance
    allowed = np.minimum(options.object_gain * left, options.slow + options.approach_gain * left)
    return (rate + allowed)[gap < 0.045]


aside = pytest.mark.parametrize("direction", [[0, 1, 0], [0, -1, 0]], ids=["left", "right"])


@every
@aside
@pytest.mark.parametrize("coming", [0.0, 0.1], ids=["still", "coming"])
def test_the_open_hand_does_not_push_the_ball_that_is_in_its_way(make, ball, direction, coming):
    p_WO, grasps = in_the_way(direction)
    V_WO = np.concatenate([np.zeros(3), -coming * np.array(direction)])
    seen = {"grasps": grasps, "pose": RigidTransform(p_WO), "velocity": SpatialVelocity(V_WO)}
    bench = Bench(make, q=BESIDE, **seen)
    bench.advance(0.2)  # until the plan is to move
    free = bench.command()
    assert slack(BESIDE, free, p_WO, V_WO).min() < -0.2
    bench.fix(gpdf=Value[object](ball))
    safe = bench.command()
    assert np.isfinite(safe).all()
    assert np.linalg.norm(safe) > 0.1
    assert slack(BESIDE, safe, p_WO, V_WO).min() > -0.01
    bench.fix(gpdf=to_value(None))  # e.g. from the moment the hand closes
    np.testing.assert_array_equal(bench.command(), free)


@every
def test_a_field_of_an_object_that_is_lost_stops_the_arm_too(make, ball):
    p_WO, grasps = in_the_way([0, 1, 0])
    bench = Bench(make, q=BESIDE, grasps=grasps, pose=RigidTransform(p_WO))
    bench.fix(gpdf=Value[object](ball))
    bench.advance(0.2)
    assert np.linalg.norm(bench.command()) > 0.1
    for name, lost in (
        ("object_pose", UNKNOWN),
        ("object_velocity", SpatialVelocity(np.full(6, np.nan))),
    ):
        bench.fix(object_pose=RigidTransform(p_WO), object_velocity=STILL)
        bench.fix(**{name: lost})
        np.testing.assert_array_equal(bench.command(), np.zeros(7))


@every
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


@pytest.mark.parametrize("make", [RMMTaskController, GPJointController])
def test_a_hand_that_has_a_ball_between_its_fingers_the_wrong_way_round_steps_back(make):
    ball = fit_gpdf(sphere_points(400, 0.025), length_scale=0.1)
    X_WG = forward_kinematics(BESIDE, REACH.gripper.X_FG)
    flipped = X_WG.copy()
    flipped[:3, :3] = X_WG[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    flipped[:3, 3] = 0.0
    motion = replace(line(0.0, 0.0), center=X_WG[:3, 3], R_WO=np.eye(3))
    grasps = GraspSet(flipped[None], np.full(1, 0.05), np.ones(1))
    _, q = closed_loop(make, motion, 8.0, grasps, q=BESIDE, gpdf=ball)
    hand = [forward_kinematics(each, REACH.gripper.X_FG) for each in q]
    away = [np.linalg.norm(X[:3, 3] - X_WG[:3, 3]) for X in hand]
    assert max(away) > 0.05
    assert hand[-1][:3, 0] @ flipped[:3, 0] > 0.99 and away[-1] < 0.005
