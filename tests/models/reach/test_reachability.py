"""Reachability against Drake's model of the whole cell and a dense search over the arm angle."""

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.self_motion import arm_angle, closed_form
from feasigrasp.models.reach.reachability import VERDICTS, Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import model_path
from tests.truths import min_distance, table_distances

HOME = np.array([0, -0.846, 0, -1.582, 0, 1.446, 0])
REACHABILITY = Reachability()


def random_configurations(n, seed=0):
    return IIWA_7.random_positions(np.random.default_rng(seed), n)


def plainly_admissible(q, reachability=REACHABILITY):
    """The three conditions one by one."""
    inside = (np.abs(q) <= IIWA_7.upper - reachability.limit_margin).all()
    above = table_distances(q, reachability.table_height).min()
    return bool(inside and min(min_distance(q), above) >= reachability.clearance)


def hand_poses(n, seed=0, reachability=REACHABILITY):
    """Hand poses of random admissible configurations, and those configurations."""
    Q = np.array([q for q in random_configurations(6 * n, seed) if plainly_admissible(q)])[:n]
    assert len(Q) == n
    return forward_kinematics(Q, reachability.gripper.X_FG), Q


class DrakeCell:
    """Arm, gripper, camera and table of our directives file."""

    def __init__(self):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.002)
        parser = Parser(self.plant)
        parser.package_map().Add("feasigrasp", str(model_path()))
        parser.AddModels(str(model_path("iiwa", "cell.dmd.yaml")))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        self.plant_context = self.plant.GetMyMutableContextFromRoot(self.context)

    def penetrations(self, q):
        """Pairs of geometries in contact at q, and the pose of the grasp frame."""
        self.plant.SetPositions(self.plant_context, self.plant.GetModelInstanceByName("iiwa"), q)
        scene_context = self.scene_graph.GetMyContextFromRoot(self.context)
        query = self.scene_graph.get_query_output_port().Eval(scene_context)
        X_WG = self.plant.GetFrameByName("grasp_frame").CalcPoseInWorld(self.plant_context)
        return query.ComputePointPairPenetration(), X_WG.GetAsMatrix4()


@pytest.fixture(scope="module")
def cell():
    return DrakeCell()


def test_solutions_reach_the_pose_free_of_contact_in_drake(cell):
    X_WG, _ = hand_poses(100)
    found, times = REACHABILITY.nearest(X_WG, HOME)
    assert np.isfinite(times).mean() > 0.95
    for X, q in zip(X_WG[np.isfinite(times)], found[np.isfinite(times)], strict=True):
        contacts, reached = cell.penetrations(q)
        assert not contacts
        np.testing.assert_allclose(reached, X, atol=1e-9)
        assert (np.abs(q) <= IIWA_7.upper - REACHABILITY.limit_margin).all()


def test_the_drake_cell_does_find_contacts(cell):
    """So that the test above can fail: with itself (capsules are larger), and with the table."""
    Q = random_configurations(3000, seed=10)
    apart = np.array([min_distance(q) for q in Q])
    above = np.array([table_distances(q).min() for q in Q])
    # In front of the arm, where there is a table.
    front = forward_kinematics(Q)[:, 0, 3] > 0.2
    for hit in (apart < -0.02, front & (apart > 0.02) & (above < -0.05) & (above > -0.2)):
        assert hit.sum() > 5
        assert np.mean([len(cell.penetrations(q)[0]) > 0 for q in Q[hit]]) > 0.9


@pytest.mark.parametrize("table_height", [0.0, 0.2])
def test_admissible_is_limits_clearance_and_table(table_height):
    reachability = Reachability(table_height=table_height)
    Q = random_configurations(3000, seed=1) * 1.02
    verdicts = reachability.admissible(Q)
    assert 300 < verdicts.sum() < 2700
    np.testing.assert_array_equal(verdicts, [plainly_admissible(q, reachability) for q in Q])


def test_all_solutions_are_admissible_and_agree_with_reachable():
    X_WG, _ = hand_poses(100, seed=2)
    X_WG[90:, :3, 3] *= 3.0  # out of reach
    found, times = REACHABILITY.nearest(X_WG, HOME)
    assert np.isfinite(times[:90]).any()
    assert np.isinf(times[90:]).any()
    for q, time in zip(found, times, strict=True):
        if np.isfinite(time):
            assert plainly_admissible(q)
            assert time == pytest.approx(np.max(np.abs(q - HOME) / IIWA_7.velocity_limits))
        else:
            assert np.isnan(q).all()
    # nearest() also tries the arm angle of q, so it may know one more.
    assert (REACHABILITY.reachable(X_WG) <= np.isfinite(times)).all()


def test_poses_of_admissible_configurations_are_reachable():
    X_WG, _ = hand_poses(300, seed=3)
    assert REACHABILITY.reachable(X_WG).mean() > 0.97


def test_the_present_configuration_is_the_nearest_to_its_own_pose():
    """It is found by its own arm angle, which is not one of the grid's."""
    X_WG, Q = hand_poses(100, seed=4)
    for X, q in zip(X_WG, Q, strict=True):
        found, times = REACHABILITY.nearest(X, q)
        assert times[0] < 1e-8
        np.testing.assert_allclose(found[0], q, atol=1e-8)


def test_nearest_follows_a_pose_that_moves_a_little():
    X_WG, Q = hand_poses(50, seed=5)
    step = se3.exp([0.002, -0.001, 0.001, 5e-4, 5e-4, -5e-4])
    moved = 0
    for X, q in zip(X_WG, Q, strict=True):
        moved += REACHABILITY.nearest(X @ step, q)[1][0] < 0.05
    assert moved >= 45  # the others are close to a singularity or a limit


def test_nearest_is_close_to_the_best_of_a_dense_search():
    """Over 720 arm angles: never better than it, and worse by no more than the grid is coarse."""
    X_WG, _ = hand_poses(30, seed=6)
    found, times = REACHABILITY.nearest(X_WG, HOME)
    psis = np.append(np.linspace(-np.pi, np.pi, 720, endpoint=False), arm_angle(HOME))
    excess = []
    for X, time in zip(X_WG, times, strict=True):
        X_WF = X @ se3.inverse(REACHABILITY.gripper.X_FG)
        candidates = np.concatenate([closed_form(X_WF, psi) for psi in psis])
        travel = np.max(np.abs(candidates - HOME) / IIWA_7.velocity_limits, axis=1)
        order = np.argsort(travel)
        dense = next((travel[k] for k in order if plainly_admissible(candidates[k])), np.inf)
        assert dense <= time + 0.02
        excess.append(time - dense if np.isfinite(dense) else 0.0)
    assert np.median(excess) < 0.25 and np.isfinite(excess).mean() > 0.9


def test_more_arm_angles_are_never_worse():
    X_WG, _ = hand_poses(50, seed=7)
    coarse = Reachability(n_arm_angles=8)
    fine = Reachability(n_arm_angles=32)
    assert (fine.nearest(X_WG, HOME)[1] <= coarse.nearest(X_WG, HOME)[1] + 1e-9).all()
    assert (coarse.reachable(X_WG) <= fine.reachable(X_WG)).all()


@pytest.fixture(scope="module")
def random_poses():
    """In a box about the arm: a third can be reached."""
    rng = np.random.default_rng(11)
    X_WG = se3.random_pose(rng, 400)
    X_WG[:, :3, 3] = rng.uniform([-0.9, -0.9, 0.0], [0.9, 0.9, 1.25], (400, 3))
    return X_WG


def test_verdicts_are_those_of_a_dense_search(random_poses):
    """All eight branches at 90 arm angles, the three conditions one by one."""
    verdicts = REACHABILITY.verdicts(random_poses)
    psis = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    X_WF = random_poses @ se3.inverse(REACHABILITY.gripper.X_FG)
    wrong = 0
    for X, code in zip(X_WF, verdicts, strict=True):
        verdict = VERDICTS[code]
        candidates = np.concatenate([closed_form(X, psi) for psi in psis])
        if verdict == "wrist out of reach":
            assert np.isnan(candidates).all()
            continue
        inside = (np.abs(candidates) <= IIWA_7.upper - REACHABILITY.limit_margin).all(axis=1)
        found = REACHABILITY.admissible(candidates).any()
        if verdict == "reachable":
            wrong += not found  # a window that is narrower than the scan's step
        else:
            assert not found
        if verdict == "joint limits":
            assert not inside.any()
        if verdict == "table" and inside.any():
            heights = [table_distances(q).min() for q in candidates[inside]]
            free = [min_distance(q) >= REACHABILITY.clearance for q in candidates[inside]]
            low = np.array(heights) < REACHABILITY.clearance
            assert low.all() or (any(free) and low[free].all())
        if verdict == "self-collision":
            free = [min_distance(q) >= REACHABILITY.clearance for q in candidates[inside]]
            assert not any(free)
    assert wrong <= 1
    assert {VERDICTS[code] for code in verdicts} == set(VERDICTS[:5])


def test_narrow_windows_between_limits_are_not_missed():
    """Poses whose configuration is a hair inside two limits, so that a grid would miss them."""
    rng = np.random.default_rng(12)
    Q = random_configurations(4000, seed=12) * 0.9
    for q in Q:
        joints = rng.choice(7, 3, replace=False)
        q[joints] = np.sign(q[joints]) * (IIWA_7.upper[joints] - 0.05 - 1e-4)
    Q = Q[REACHABILITY.admissible(Q)]
    X_WG = forward_kinematics(Q, REACHABILITY.gripper.X_FG)
    psis = np.linspace(-np.pi, np.pi, 12, endpoint=False)
    missed, found, times = 0, *REACHABILITY.nearest(X_WG, HOME)
    reachable = REACHABILITY.reachable(X_WG)
    for X, hit in zip(X_WG, reachable, strict=True):
        X_WF = X @ se3.inverse(REACHABILITY.gripper.X_FG)
        grid = np.concatenate([closed_form(X_WF, psi) for psi in psis])
        if not REACHABILITY.admissible(grid).any():
            missed += hit
    assert missed > 5 and reachable.mean() > 0.99
    # HOME's own arm angle is one more: what is nearest is also reachable, and nothing is lost.
    np.testing.assert_array_equal(np.isfinite(times), reachable)
    np.testing.assert_allclose(
        forward_kinematics(found[reachable], REACHABILITY.gripper.X_FG), X_WG[reachable], atol=1e-9
    )


def test_poses_out_of_reach():
    X = np.tile(forward_kinematics(HOME, REACHABILITY.gripper.X_FG), (3, 1, 1))
    X[0, :3, 3] = [2.0, 0.0, 0.5]  # too far
    X[1, :3, 3] = [0.5, 0.0, -0.05]  # below the table
    found, times = REACHABILITY.nearest(X, HOME)
    assert np.isinf(times[:2]).all() and np.isnan(found[:2]).all()
    assert times[2] < 1e-8
    np.testing.assert_array_equal(REACHABILITY.reachable(X[:2]), False)


def test_a_pose_with_nan_is_out_of_reach():
    X = np.full((1, 4, 4), np.nan)
    found, times = REACHABILITY.nearest(X, HOME)
    assert np.isinf(times).all() and np.isnan(found).all()
    assert not REACHABILITY.reachable(X).any()


def test_a_higher_table_forbids_low_poses():
    X_WG, _ = hand_poses(300, seed=8)
    raised = Reachability(table_height=0.2)
    low = X_WG[:, 2, 3] < 0.2
    assert low.sum() > 5 and not raised.reachable(X_WG[low]).any()
    found, times = raised.nearest(X_WG, HOME)
    assert np.isfinite(times).sum() > 100
    for q in found[np.isfinite(times)]:
        assert table_distances(q, 0.2).min() >= raised.clearance


def test_the_flip_of_a_grasp_is_another_pose():
    """Half a turn about the approach direction: joint 7 turns by pi where its limits allow."""
    X_WG, _ = hand_poses(100, seed=9)
    flipped = X_WG @ np.diag([-1.0, -1.0, 1.0, 1.0])
    found, times = REACHABILITY.nearest(X_WG, HOME)
    flipped_times = REACHABILITY.nearest(flipped, HOME)[1]
    checked = 0
    for q, X, time in zip(found, flipped, flipped_times, strict=True):
        turned = q - np.pi * np.sign(q[6]) * np.eye(7)[6]
        if np.isfinite(q).all() and plainly_admissible(turned):
            X_WG_turned = forward_kinematics(turned, REACHABILITY.gripper.X_FG)
            np.testing.assert_allclose(X_WG_turned, X, atol=1e-9)
            assert time <= np.max(np.abs(turned - HOME) / IIWA_7.velocity_limits) + 1e-9
            checked += 1
    assert checked > 60


def test_one_pose_and_no_pose():
    X = forward_kinematics(HOME, REACHABILITY.gripper.X_FG)
    assert REACHABILITY.reachable(X).shape == (1,)
    found, times = REACHABILITY.nearest(np.zeros((0, 4, 4)), HOME)
    assert found.shape == (0, 7) and times.shape == (0,)
