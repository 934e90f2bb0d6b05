from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.errors import ArgumentError, ScenarioError
from feasigrasp.models.control.horizon.knots import Form
from feasigrasp.models.control.horizon.program import ProgramOptions, solve_program
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.control.safety.velocity_limits import drive_step_kernel
from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.continuation import branch_kernel, redundancy_kernel, solve_kernel
from feasigrasp.models.ik.seeded import least_squares_kernel, seed_of_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm import Family
from feasigrasp.models.robot.arm_file import arm_names, load_arm
from feasigrasp.models.robot.capsule_kernels import add_lever, link_poses_kernel
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import (
    arm_condition_kernel,
    forward_kinematics,
    manipulability,
    pose_and_jacobian,
)

ARMS = arm_names()
OTHERS = [name for name in ARMS if load_arm(name).family != Family.SRS]
X_FT = se3.make_pose(se3.so3_exp(np.array([0.3, -0.5, 0.9])), np.array([0.02, -0.03, 0.15]))


def seeded(arm):
    """The same arm, as if it had no closed form."""
    return replace(arm, family=Family.SEEDED)


def tilted():
    """An arm of six joints that no closed form fits: axes that meet nowhere, two of them tilted."""
    axes = [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 0.8, 0.6], [0.6, 0, 0.8]]
    points = [
        [0, 0, 0.3],
        [0, 0.03, 0.3],
        [0, 0, 0.7],
        [0, 0.01, 0.9],
        [0, 0, 1.05],
        [0, 0.01, 1.1],
    ]
    return replace(
        load_arm("ur5e"), axes=np.array(axes, float), points=np.array(points, float),
        X_WF=X_FT + np.diag([0, 0, 0, 0]) + np.outer([0, 0, 1.1, 0], [0, 0, 0, 1]),
        family=Family.SEEDED,
    )  # fmt: skip


def any_arm(name):
    if name.startswith("ur5e, axis"):
        return with_axis_reversed(load_arm("ur5e"), int(name[-1]) - 1)
    return tilted() if name == "tilted" else load_arm(name)


def with_axis_reversed(arm, k):
    """The same arm; joint k counts the other way."""
    sign = np.where(np.arange(arm.joints) == k, -1.0, 1.0)
    lower, upper = np.sort([sign * arm.lower, sign * arm.upper], axis=0)
    return replace(
        arm, axes=sign[:, None] * arm.axes, lower=lower, upper=upper, home=sign * arm.home
    )


#: Of the parallel axes, one may point against the others.
REVERSED = [f"ur5e, axis {k}" for k in (2, 3, 4)]


def configurations(arm, n, seed=0):
    """Inside the limits, and inside one turn."""
    low, high = np.maximum(arm.lower, -np.pi) + 0.05, np.minimum(arm.upper, np.pi) - 0.05
    return np.random.default_rng(seed).uniform(low, high, (n, arm.joints))


@pytest.mark.parametrize("name", [*ARMS, "tilted"])
def test_forward_kinematics_are_a_product_of_turns(name):
    arm = any_arm(name)
    for q in configurations(arm, 20):
        X = np.eye(4)
        for angle, axis, point in zip(q, arm.axes, arm.points, strict=True):
            R = se3.so3_exp(angle * axis)
            X = X @ se3.make_pose(R, point - R @ point)
        X_WT = X @ arm.X_WF @ X_FT
        np.testing.assert_allclose(forward_kinematics(q, X_FT, arm), X_WT, atol=1e-13)


@pytest.mark.parametrize("name", ARMS)
def test_no_arm_approaches_quicker_than_it_can_stop(name):
    arm = load_arm(name)
    options = SafetyOptions.of(arm)
    brakes = options.acceleration_scale * arm.acceleration_limits
    rates = brakes / (options.velocity_scale * arm.velocity_limits)
    assert options.approach_gain == min(3.3, rates.min())


@pytest.mark.parametrize("name", [*ARMS, "tilted"])
def test_jacobian_is_the_derivative(name):
    arm, step = any_arm(name), 1e-6
    for q in configurations(arm, 5):
        X, J = pose_and_jacobian(q, X_FT, arm)
        for j in range(arm.joints):
            ahead, behind = (
                forward_kinematics(q + s * step * np.eye(arm.joints)[j], X_FT, arm) for s in (1, -1)
            )
            turn = se3.so3_log(ahead[:3, :3] @ behind[:3, :3].T) / (2 * step)
            way = (ahead[:3, 3] - behind[:3, 3]) / (2 * step)
            np.testing.assert_allclose(J[:, j], np.r_[turn, way], atol=1e-8)
        measured = np.sqrt(np.linalg.det(J @ J.T))
        assert manipulability(q, arm) == pytest.approx(measured, rel=1e-9)


@pytest.mark.parametrize("name", [*ARMS, *REVERSED])
def test_branch_and_redundancy_give_a_configuration_back(name):
    arm = any_arm(name)
    for q in configurations(arm, 500):
        X_WF, found = forward_kinematics(q, None, arm), q + 0.1
        branch = branch_kernel(arm.chain, q)
        assert solve_kernel(arm.chain, X_WF, branch, redundancy_kernel(arm.chain, q), found)
        np.testing.assert_allclose(found, q, atol=1e-6)


@pytest.mark.parametrize("name", [*OTHERS, *REVERSED])
def test_every_branch_reaches_its_pose_in_a_configuration_of_its_own(name):
    arm, count = any_arm(name), 0
    for q in configurations(arm, 300, seed=1):
        X_WF, r = forward_kinematics(q, None, arm), redundancy_kernel(arm.chain, q)
        found = []
        for branch in range(8):
            one = q.copy()
            if solve_kernel(arm.chain, X_WF, branch, r, one):
                one = np.arctan2(np.sin(one), np.cos(one))  # nearest to q, it may be a turn off
                np.testing.assert_allclose(forward_kinematics(one, None, arm), X_WF, atol=1e-7)
                assert all(np.abs(one - other).max() > 1e-6 for other in found)
                found.append(one)
        count += len(found)
    assert count > 2 * 300


@pytest.mark.parametrize("name", OTHERS)
def test_poses_that_are_reached_are_found_in_reach(name):
    # Without bodies: some redundancy between the samples may be the only one for a pose.
    arm = replace(load_arm(name), pairs=())
    reach = Reachability(arm=arm, limit_margin=0.0, table_clearance=-5.0)
    X_WG = forward_kinematics(configurations(arm, 400, seed=2), reach.gripper.X_FG, arm)
    assert np.mean(reach.reachable(X_WG)) > 0.99
    q, times = reach.nearest(X_WG[:50], arm.home)
    some = np.isfinite(times)
    assert some.mean() > 0.99
    X_found = forward_kinematics(q[some], reach.gripper.X_FG, arm)
    np.testing.assert_allclose(X_found, X_WG[:50][some], atol=1e-7)


@pytest.mark.parametrize("name", [*ARMS, "tilted"])
def test_least_squares_find_what_is_reached(name):
    arm = replace(seeded(any_arm(name)), pairs=())
    reach = Reachability(arm=arm, limit_margin=0.0, table_clearance=-5.0)
    X_WG = forward_kinematics(configurations(arm, 600, seed=2), reach.gripper.X_FG, arm)
    assert np.mean(reach.reachable(X_WG)) > 0.985
    far = X_WG.copy()
    far[:, :3, 3] += [0.0, 0.0, 3.0]
    assert not reach.reachable(far).any()
    q, times = reach.nearest(X_WG[:60], arm.home)
    some = np.isfinite(times)
    assert some.mean() > 0.95
    X_found = forward_kinematics(q[some], reach.gripper.X_FG, arm)
    np.testing.assert_allclose(X_found, X_WG[:60][some], atol=1e-7)


@pytest.mark.parametrize("name", ["panda", "tilted"])
def test_a_seed_gives_a_configuration_back_and_is_kept_along_a_path(name):
    arm, back, kept = seeded(any_arm(name)), [], []
    for q in configurations(arm, 100, seed=4):
        branch, r = seed_of_kernel(arm.chain, q), redundancy_kernel(arm.chain, q)
        X_WF, found = forward_kinematics(q, None, arm), np.full(arm.joints, 0.3)
        solved = solve_kernel(arm.chain, X_WF, branch, r, found)
        back.append(solved and np.abs(np.sin(0.5 * (found - q))).max() < 1e-3)
        moved, there = X_WF.copy(), q.copy()
        moved[:3, 3] += 0.002
        if solve_kernel(arm.chain, moved, branch, r, there):
            kept.append(np.abs(there - q).max() < 0.3)
            np.testing.assert_allclose(forward_kinematics(there, None, arm), moved, atol=1e-7)
    assert np.mean(back) > 0.85
    assert len(kept) > 70 and np.mean(kept) > 0.9


def test_least_squares_leave_a_pose_that_is_half_a_turn_off():
    arm, solved = seeded(load_arm("panda")), 0
    for q in configurations(arm, 50, seed=5):
        X_WF, found = forward_kinematics(q, None, arm) @ np.diag([-1.0, -1.0, 1.0, 1.0]), q.copy()
        if least_squares_kernel(arm.chain, X_WF, 7, found):
            np.testing.assert_allclose(forward_kinematics(found, None, arm), X_WF, atol=1e-7)
            solved += 1
    assert solved > 5


def test_link_1_is_kept_off_the_table_unless_it_turns_about_the_vertical():
    upright, leaning = load_arm("ur5e"), tilted()
    leaning = replace(leaning, axes=np.roll(leaning.axes, 1, axis=0) * 1.0)
    assert not leaning.upright and upright.upright
    for arm, first in ((upright, 2), (leaning, 1)):
        model = capsule_model(None, arm)
        assert model.link[model.movers].min() == first


def test_safety_options_of_an_arm_have_its_share_and_margin():
    own = replace(load_arm("iiwa7"), acceleration_share=0.5, position_margin=0.1)
    options = SafetyOptions.of(own)
    assert (options.acceleration_scale, options.position_margin) == (0.5, 0.1)
    brakes = 0.5 * own.acceleration_limits / (0.9 * own.velocity_limits)
    assert options.approach_gain <= brakes.min() + 1e-12


def test_levers_of_tilted_joints_are_differences_of_places():
    arm, step, point = tilted(), 1e-6, np.array([0.1, -0.2, 0.15])
    R, p, gradient = np.empty((7, 3, 3)), np.empty((7, 3)), np.zeros(6)
    for q in configurations(arm, 5):
        for direction in np.eye(3):
            link_poses_kernel(arm.chain, q, R, p)
            add_lever(arm.chain, R[6] @ point + p[6], direction, 0, 6, R, p, gradient)
            for j in range(6):
                places = []
                for sign in (1, -1):
                    link_poses_kernel(arm.chain, q + sign * step * np.eye(6)[j], R, p)
                    places.append(R[6] @ point + p[6])
                change = direction @ (places[0] - places[1]) / (2 * step)
                assert gradient[j] == pytest.approx(change, abs=1e-8)


@pytest.mark.parametrize("name", ARMS)
def test_home_is_admissible_and_the_hand_looks_forward_and_down(name):
    arm = load_arm(name)
    assert Reachability(arm=arm).admissible(arm.home[None]).all()
    X_WG = forward_kinematics(arm.home, ParallelGripper().X_FG, arm)
    assert X_WG[0, 3] > 0.1 and X_WG[2, 3] > 0.4
    assert X_WG[0, 2] > 0.7 and X_WG[2, 2] < -0.4
    assert X_WG[2, 1] > 0.4  # the camera is above the hand


def shifted(arm, turns):
    """The same arm, each of whose joints has its zero some quarter turns farther on."""
    delta = 0.5 * np.pi * np.array(turns)
    points, axes, X = arm.points.copy(), arm.axes.copy(), np.eye(4)
    for j, angle in enumerate(delta):
        points[j], axes[j] = X[:3, :3] @ points[j] + X[:3, 3], np.round(X[:3, :3] @ axes[j])
        R = np.round(se3.so3_exp(angle * axes[j]))
        X = se3.make_pose(R, points[j] - R @ points[j]) @ X
    rotations, X = [np.eye(3)], np.eye(4)
    for angle, axis in zip(delta, arm.axes, strict=True):
        X = X @ se3.make_pose(np.round(se3.so3_exp(angle * axis)), np.zeros(3))
        rotations.append(X[:3, :3])

    def moved(capsule):
        # Frames of links are along the base's at the new zero.
        R = rotations[min(capsule.body, arm.joints)]
        ends = (tuple((R @ np.array(end)).tolist()) for end in (capsule.a, capsule.b))
        return capsule._replace(**dict(zip("ab", ends, strict=True)))

    X_WF = forward_kinematics(delta, None, arm)
    return delta, replace(
        arm,
        points=points,
        axes=axes,
        X_WF=se3.make_pose(np.array(X_WF[:3, :3]), X_WF[:3, 3]),
        lower=arm.lower - delta,
        upper=arm.upper - delta,
        home=arm.home - delta,
        capsules=tuple(map(moved, arm.capsules)),
    )


@pytest.mark.parametrize("name", OTHERS)
def test_an_arm_with_shifted_joint_zeros_moves_alike(name):
    arm = load_arm(name)
    turns = [1, 1, -1, 1, -1, 1, 1][: arm.joints]
    delta, other = shifted(arm, turns)
    rng, n = np.random.default_rng(3), arm.joints
    gain = min(3.3, arm.braking_rate(0.9, 0.94))
    pairs = [(each, SafetyOptions(arm=each, approach_gain=gain)) for each in (arm, other)]
    filters = [SafetyFilter(options) for _, options in pairs]
    reach = [Reachability(arm=each, clearance=0.0) for each, _ in pairs]
    for q in (*arm.random_positions(rng, 15), 0.98 * arm.upper, 0.98 * arm.lower):
        q = np.clip(q, delta - 6.2, delta + 6.2)  # what counts as radians
        wish, last = rng.normal(size=n), 0.1 * rng.normal(size=n)
        both = (q, q - delta)
        cases = [*zip(both, pairs, strict=True)]
        poses = [forward_kinematics(at, X_FT, each) for at, (each, _) in cases]
        np.testing.assert_allclose(*poses, atol=1e-12)
        conditions = [arm_condition_kernel(each.chain, at, wish) for at, (each, _) in cases]
        np.testing.assert_allclose(*conditions, atol=1e-9)
        safe = [
            each.velocity(at, wish, qd_last=last) for at, each in zip(both, filters, strict=True)
        ]
        np.testing.assert_allclose(*safe, atol=1e-6)
        sent = []
        for at, (each, _) in cases:
            q_next, v_next = np.empty(n), np.empty(n)
            drive_step_kernel(each.chain, at, last, 5 * wish, at, (0.005, 0.1, 1.0), q_next, v_next)
            sent.append(v_next)
        np.testing.assert_allclose(*sent, atol=1e-9)
        plans = []
        for at, (_, options) in cases:
            program = ProgramOptions(safety=options)
            m = len(program.steps)
            form = Form(
                np.tile(500.0 * np.eye(n), (m, 1, 1)), np.tile(9 * wish, (m, 1)), np.zeros((m, n))
            )
            plans.append(solve_program(at, np.zeros((m + 1, n)), form, program))
        np.testing.assert_allclose(*plans, atol=1e-6)
        admissible = [r.admissible(at[None])[0] for at, r in zip(both, reach, strict=True)]
        assert admissible[0] == admissible[1]


@pytest.mark.parametrize("n", [6, 7])
def test_plans_keep_the_limits_of_random_arms(n):
    rng, base = np.random.default_rng(n), load_arm("panda" if n == 7 else "ur5e")
    for _ in range(10):
        low = rng.uniform(-6.0, 1.0, n)
        arm = replace(base, lower=low, upper=low + rng.uniform(1.0, 5.0, n), family=base.family)
        options = ProgramOptions(safety=SafetyOptions(arm=arm))
        m, safety = len(options.steps), options.safety
        q = rng.uniform(arm.lower + 0.1, arm.upper - 0.1)
        form = Form(
            np.tile(500.0 * np.eye(n), (m, 1, 1)), rng.normal(size=(m, n)) * 1e4, np.zeros((m, n))
        )
        v = solve_program(q, np.zeros((m + 1, n)), form, options)
        assert (np.abs(v) <= options.most_v + 1e-6).all()
        change = np.abs(np.diff(v, axis=0)) / options.h[:, None]
        assert (change <= options.most_a + 1e-4).all()
        room = np.minimum(arm.upper - q, q - arm.lower) - safety.position_margin
        first = q + 0.5 * options.h[0] * (v[0] + v[1])
        assert (first < arm.upper).all() and (first > arm.lower).all() and (room > 0).all()


def test_an_s_r_s_arm_with_other_limits_to_either_side_is_refused():
    arm = load_arm("iiwa7")
    with pytest.raises(ArgumentError, match="limits of iiwa7? are not symmetric; give shoulder"):
        replace(arm, lower=arm.lower + 0.1)


def test_what_is_no_arm_is_refused():
    with pytest.raises(ScenarioError, match="do you mean panda"):
        load_arm("pandas")
    arm = load_arm("panda")
    with pytest.raises(ArgumentError, match="give unit vectors"):
        replace(arm, axes=arm.axes * 0.9)
    with pytest.raises(ArgumentError, match="miss each other by 6.67 mm"):
        replace(arm, points=arm.points + [[0, 0, 0], [0.01, 0, 0], *[[0, 0, 0]] * 5])
