"""What all controllers promise: the same ports, the same safe behaviour."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity

from feasigrasp.errors import ControlError
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from tests.controller_bench import FAR, NEAR, REACH, STILL, UNKNOWN, Bench, every, ring
from tests.truths import min_distance


@every
def test_ports_are_those_of_the_docstring(make, ports, documented_ports):
    inputs, outputs = ports(make(REACH))
    assert (list(inputs), list(outputs)) == documented_ports(GraspController)


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
        "static_obstacles": None,
        "object_motion": None,
        "phase": 1,
        "gpdf": None,
        "touch": 7,
        "camera_pose": None,
        "search_target": None,
        "tracking": None,
        "plan": None,
    }
    assert outputs == {"commanded_velocity": 7, "chosen_grasp": 16}


@every
def test_a_reachable_grasp_makes_the_arm_move(make):
    qd = Bench(make).command()
    assert np.linalg.norm(qd) > 0.05
    assert np.all(np.abs(qd) < IIWA_7.velocity_limits)


@every
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


@every
@pytest.mark.parametrize(
    "lost",
    [{"object_pose": UNKNOWN}, {"object_velocity": SpatialVelocity(np.full(6, np.nan))}],
    ids=["pose unknown", "twist unknown"],
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


@every
def test_an_object_that_leaves_stops_the_arm_as_soon_as_it_is_not_waited_for_any_more(make):
    bench = Bench(make)
    bench.fix(object_pose=FAR)
    bench.advance(0.7)
    np.testing.assert_array_equal(bench.command(), np.zeros(7))
    bench.fix(object_pose=NEAR)
    bench.advance(0.9)
    assert np.linalg.norm(bench.command()) > 0.05


@every
def test_an_arm_that_touches_itself_is_not_held_there(make):
    """Without grasps the task-space command is to stop; the QP of either may push apart."""
    q = np.array([0.0, 2.0, 0.0, -2.0, 0.0, -2.0, 0.0])
    qd = Bench(make, grasps=GraspSet.empty(), q=q).command()
    assert np.isfinite(qd).all()
    assert min_distance(q + 1e-3 * qd) >= min_distance(q) - 1e-9


@every
@pytest.mark.parametrize("seed", range(3))
def test_commands_are_finite_and_inside_every_bound_in_random_states(make, seed):
    rng = np.random.default_rng(seed)
    grasps, options = ring(), SafetyOptions()
    moved = 0
    for _ in range(12):
        q = rng.uniform(-1, 1, 7) * IIWA_7.upper
        pose = RigidTransform(
            RotationMatrix(RollPitchYaw(rng.uniform(-3, 3, 3))), rng.uniform(-0.7, 0.7, 3)
        )
        velocity = SpatialVelocity(rng.normal(scale=0.5, size=6))
        qd = Bench(make, grasps=grasps, q=q, pose=pose, velocity=velocity).command()
        lower, upper = SafetyFilter(options).problem(q, np.zeros(7))[1][:2, :7]
        assert np.isfinite(qd).all()
        assert np.all((lower - 1e-9 <= qd) & (qd <= upper + 1e-9))
        moved += bool(np.any(qd))
    assert moved > 0


class Counter(GraspController):
    """Remembers how often it was updated."""

    def update(self, memory, inputs):
        return memory + 1

    def velocity(self, memory, inputs):
        return self.enforced(np.full(7, 0.01 * memory), inputs)


def test_a_plan_takes_effect_after_the_planning_time():
    """And the command is computed meanwhile, at any instant, by the plan before it."""

    def planner(reachability):
        dut = Counter(reachability, 0)
        dut.take_time(0.03)
        return dut

    bench = Bench(planner)
    for t, plans in ((0.02, 0), (0.029, 0), (0.031, 1), (0.129, 1), (0.131, 2), (0.331, 4)):
        bench.advance(t)
        np.testing.assert_allclose(bench.command(), 0.01 * plans)


def test_planning_that_takes_longer_than_the_time_between_updates_is_refused():
    with pytest.raises(ControlError, match=r"planning_time is 0.1 s; give less than 0.1 s"):
        Counter(REACH, 0).take_time(0.1)
