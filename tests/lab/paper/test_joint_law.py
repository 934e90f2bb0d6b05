"""The paper's joint-space law, which enforces nothing, and the solutions that it follows."""

import numpy as np
import pytest

from feasigrasp.errors import ScenarioError
from feasigrasp.models.control.horizon.distance import NOISE_VARIANCE
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.continuation import flange_pose_kernel, solve_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp_lab.paper.joint_law import GAINS, PaperJointControl
from feasigrasp_lab.paper.options import PaperOptions
from feasigrasp_lab.paper.predicted_reachability import judge_grasps
from feasigrasp_lab.paper.solutions import Solutions

HOME = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
REACHABILITY = Reachability()
X_FG = REACHABILITY.gripper.X_FG
PERIOD = 0.05
STILL = np.zeros(6)
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
PRINTED = PaperOptions(
    law="gradient",
    gain=1.0,
    feed_forward=False,
    length_scale=0.3,
    n_solutions=100,
    source="flow",
    resample=True,
)


def solutions_of(grasps, options, X_WO=X_WO):
    control = PaperJointControl(REACHABILITY, options, PERIOD)
    return control, control.update(Solutions.empty(), 0.0, grasps, X_WO, STILL, HOME)


def in_reach(grasps):
    return judge_grasps(grasps, X_WO, STILL, REACHABILITY, n_best=200).grasps


@pytest.mark.parametrize("options", [PaperOptions(), PRINTED], ids=["corrected", "printed"])
def test_all_solutions_are_worth_the_same(ring_of_grasps, options):
    _, solutions = solutions_of(in_reach(ring_of_grasps), options)
    assert len(solutions) > 0
    np.testing.assert_array_equal(solutions.cost, 0.0)


@pytest.mark.parametrize("options", [PaperOptions(), PRINTED], ids=["corrected", "printed"])
def test_without_grasps_in_reach_the_arm_stops(ring_of_grasps, options):
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    for grasps, X in ((ring_of_grasps, far), (GraspSet.empty(), X_WO)):
        control, solutions = solutions_of(grasps, options, X)
        assert len(solutions) == 0
        qd = control.velocity(HOME, solutions, 0.0, X, np.full(6, 0.2))
        np.testing.assert_array_equal(qd, 0.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"law": "newton"},
        {"gain": -1.0},
        {"length_scale": -0.1},
        {"n_solutions": 0},
        {"resample": True},
    ],
    ids=lambda w: next(iter(w)),
)
def test_options_that_mean_nothing_are_refused(wrong):
    with pytest.raises(ScenarioError):
        PaperOptions(**wrong)


def field(solutions, X, length_scale):
    """Configurations of all solutions, and the paper's d(q) of them, in plain array code."""
    X_WF, X_GF = np.empty((4, 4)), np.linalg.inv(X_FG)
    nodes = np.empty((len(solutions), 7))
    for k, node in enumerate(nodes):
        flange_pose_kernel(X, solutions.X_OG[k], 0.0, X_GF, X_WF)
        assert solve_kernel(IIWA_7.chain, X_WF, solutions.branch[k], solutions.arm_angle[k], node)
    limits = IIWA_7.upper - IIWA_7.position_margin
    nodes = nodes[(np.abs(nodes) <= limits).all(axis=1)]

    def kernel(a, b):
        return np.exp(-np.linalg.norm(a[:, None] - b[None], axis=2) / length_scale)

    K = kernel(nodes, nodes) + NOISE_VARIANCE * np.eye(len(nodes))
    alpha = np.linalg.solve(K, np.ones(len(nodes)))
    return nodes, lambda q: -length_scale * np.log(kernel(q[None], nodes) @ alpha)[0]


def test_the_printed_law_is_the_distance_times_its_gradient(ring_of_grasps):
    """By finite differences of the field, at poses where it falls fast and where it is negative."""
    control, solutions = solutions_of(in_reach(ring_of_grasps), PRINTED)
    nodes, d = field(solutions, X_WO, 0.3)
    rng, h = np.random.default_rng(2), 1e-6
    signs = set()
    for q in (HOME, nodes[0] + 0.02, nodes.mean(axis=0), *(HOME + rng.normal(0, 0.5, (5, 7)))):
        gradient = np.array([(d(q + e) - d(q - e)) / (2 * h) for e in h * np.eye(7)])
        qd = control.velocity(q, solutions, 0.0, X_WO, np.full(6, 0.3))
        np.testing.assert_allclose(qd, -d(q) * gradient, atol=1e-4)
        signs.add(np.sign(d(q)))
    assert 1.0 in signs


def test_solutions_are_drawn_anew_from_the_same_seed(ring_of_grasps):
    """A little later they are about the same, and none of those before is kept."""
    grasps = in_reach(ring_of_grasps)
    control, first = solutions_of(grasps, PRINTED)
    assert 50 < len(first) <= 100
    assert first.length_scale[0] == 0.3
    moved = X_WO.copy()
    moved[1, 3] += 0.002
    again = control.update(first, PERIOD, grasps, moved, STILL, HOME)
    _, fresh = solutions_of(grasps, PRINTED, moved)
    np.testing.assert_array_equal(again.arm_angle, fresh.arm_angle)
    before, after = field(first, X_WO, 0.3)[0], field(again, moved, 0.3)[0]
    nearest = np.linalg.norm(after[:, None] - before[None], axis=2).min(axis=1)
    assert np.median(nearest) < 0.1
    gone = control.update(first, PERIOD, GraspSet.empty(), X_WO, STILL, HOME)
    assert len(gone) == 0


def test_one_solution_is_approached_at_the_rate_and_moves_with_the_object(ring_of_grasps):
    """With one solution d is the Euclidean distance: qd = k (q_1 - q), plus what keeps q_1 on."""
    control, one = solutions_of(in_reach(ring_of_grasps), PaperOptions(n_solutions=1))
    assert len(one) == 1
    q_1, V_WO = field(one, X_WO, 0.2)[0][0], np.array([0.1, -0.2, 0.1, 0.05, 0.02, -0.03])
    qd = control.velocity(HOME, one, 0.0, X_WO, STILL)
    np.testing.assert_allclose(qd, GAINS[0] * (q_1 - HOME), atol=1e-4)
    carried = control.velocity(HOME, one, 0.0, X_WO, V_WO) - qd
    X_WH, J = pose_and_jacobian(q_1, X_FG)
    lever = X_WH[:3, 3] - X_WO[:3, 3]
    expected = np.r_[V_WO[:3], V_WO[3:] + np.cross(V_WO[:3], lever)]
    np.testing.assert_allclose(J @ carried, expected, atol=1e-4)


@pytest.mark.parametrize("part", ["pose", "twist"])
def test_an_object_that_is_nowhere_stops_the_arm_and_its_solutions_are_kept(ring_of_grasps, part):
    grasps = in_reach(ring_of_grasps)
    control, solutions = solutions_of(grasps, PaperOptions())
    X, V = X_WO.copy(), STILL.copy()
    (X if part == "pose" else V)[1] = np.nan
    np.testing.assert_array_equal(control.velocity(HOME, solutions, 0.01, X, V), 0.0)
    assert control.update(solutions, PERIOD, grasps, X, V, HOME) is solutions
