"""What the benchmark of the controllers times is what it says, and right."""

import numpy as np
import pytest
import torch

from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp_lab.bench import control as bench_control
from feasigrasp_lab.bench.control import V_WO, joint_probe, safe_probe, task_probe
from feasigrasp_lab.peers import ArrayArm, ArrayJointStep, ArrayTaskStep, se3_log
from feasigrasp_lab.results.timing import Timing, timing_row

REACHABILITY = Reachability()
X_FG = REACHABILITY.gripper.X_FG


@pytest.mark.parametrize("xp", [np, torch])
def test_array_kinematics_are_ours(xp):
    q = IIWA_7.random_positions(np.random.default_rng(0), 5)
    R, p, J = (np.asarray(x) for x in ArrayArm(xp, X_FG).hand(xp.asarray(q)))
    for i in range(5):
        X, expected = pose_and_jacobian(q[i], X_FG)
        np.testing.assert_allclose(R[i], X[:3, :3], atol=1e-12)
        np.testing.assert_allclose(p[i], X[:3, 3], atol=1e-12)
        np.testing.assert_allclose(J[i], expected, atol=1e-12)


def test_array_logarithm_is_ours():
    X = se3.random_pose(np.random.default_rng(1), 20)
    X[0, :3, :3] = np.eye(3)
    np.testing.assert_allclose(se3_log(np, X[:, :3, :3], X[:, :3, 3]), se3.log(X), atol=1e-9)


@pytest.mark.parametrize("K", [1, 4])
def test_the_peers_of_the_task_step_give_our_command(K):
    probe = task_probe(REACHABILITY, K, seed=0)
    mixture = probe.controller.memory(probe.context).mixture
    assert len(mixture.mixture) == K
    commands = [probe.step().copy() for _ in range(3)]
    assert np.linalg.norm(commands[0] - commands[1]) > 1e-3  # the inputs do change
    for xp in (np, torch):
        step = ArrayTaskStep(xp, mixture.targets, X_FG)
        for command, (q, pose) in zip(commands, probe.inputs, strict=False):
            np.testing.assert_allclose(step(q, pose.GetAsMatrix4(), V_WO), command, atol=1e-8)


def test_the_joint_controller_follows_as_many_solutions_as_asked():
    probe = joint_probe(REACHABILITY, 10, seed=0)
    assert len(probe.controller.memory(probe.context)) == 10
    first, second = probe.step().copy(), probe.step().copy()
    assert np.isfinite(first).all() and np.linalg.norm(first - second) > 1e-4


@pytest.mark.parametrize("xp", [np, torch])
def test_the_peer_of_the_joint_step_solves_and_descends(xp):
    rng = np.random.default_rng(2)
    q = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
    goals = forward_kinematics(q + rng.normal(0.0, 0.15, (6, 7)), X_FG)
    step = ArrayJointStep(xp, goals, X_FG, iterations=30)
    nodes = np.asarray(step.solve(xp.asarray(q), xp.asarray(np.eye(4))))
    np.testing.assert_allclose(forward_kinematics(nodes, X_FG), goals, atol=1e-4)
    command = np.asarray(step(q, np.eye(4)))
    gaps = np.linalg.norm(nodes - q, axis=1)
    towards = (nodes - q)[np.argmin(gaps)]
    assert command @ towards > 0.0


@pytest.mark.parametrize("space", ControlSpace)
def test_every_update_that_is_timed_plans(space):
    """Without an update in it, a step of the simulator takes microseconds."""
    probe = safe_probe(REACHABILITY, space, seed=0)
    before, start = probe.controller.memory(probe.context), probe.context.get_time()
    assert len(before.near.X_OG) > 0
    period = probe.controller.period
    times = probe.update_ms(period, 12)
    assert times.shape == (12,) and times.min() > 0.2
    updates = (probe.context.get_time() - start) / period
    assert updates == pytest.approx(12 + 15)  # the first ones warm up
    assert probe.controller.memory(probe.context) is not before


def test_frequencies_turn_the_interval_round():
    row = timing_row("bench.task_hz.1", "default", Timing(0.01, 0.008, 0.02, 7))
    assert (row.value, row.low, row.high) == pytest.approx((100.0, 50.0, 125.0))
    assert (row.unit, row.n) == ("Hz", 7)


def test_a_draw_that_never_fits_is_told(monkeypatch):
    monkeypatch.setattr(bench_control, "_DRAWS", 0)
    with pytest.raises(RuntimeError, match="gave no mixture of 3 components"):
        task_probe(REACHABILITY, 3, seed=0)
