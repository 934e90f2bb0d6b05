"""The joint-space distance field against dense linear algebra and finite differences."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.special import logsumexp

from feasigrasp.models.control.horizon.distance import (
    NOISE_VARIANCE,
    distances_kernel,
    evaluate_kernel,
    fit_kernel,
    length_scale_kernel,
)
from feasigrasp.models.robot.iiwa import IIWA_7


class JointField(NamedTuple):
    """What the kernels fit and evaluate."""

    q: np.ndarray
    cost: np.ndarray
    beta: np.ndarray
    length_scale: float

    def evaluate(self, q):
        """Distance, its gradient (7,), and how much each solution counts (n,)."""
        gradient, weights = np.empty(7), np.empty(len(self.q))
        d, _ = evaluate_kernel(q, *self, gradient, weights)
        return d, gradient, weights

    def way_left(self, q):
        return evaluate_kernel(q, *self, np.empty(7), np.empty(len(self.q)))[1]


def distances(q):
    r = np.empty((len(q), len(q)))
    distances_kernel(q, r)
    return r


def spacing_length_scale(q):
    return length_scale_kernel(distances(np.ascontiguousarray(q)))


def fit_joint_field(q, length_scale=None, cost=None):
    r, lowest, beta = distances(q), np.empty(len(q)), np.empty(len(q))
    scale = spacing_length_scale(q) if length_scale is None else length_scale
    fit_kernel(r, np.zeros(len(q)) if cost is None else cost, scale, NOISE_VARIANCE, lowest, beta)
    return JointField(q, lowest, beta, scale)


def random_solutions(n, seed=0, spread=1.0):
    return np.random.default_rng(seed).uniform(-spread, spread, (n, 7))


def dense_occupancy(solutions, q, scale, noise=1e-6):
    """o(q) = k (K + s2 I)^-1 1, written out."""
    K = np.exp(-np.linalg.norm(solutions[:, None] - solutions[None], axis=2) / scale)
    k = np.exp(-np.linalg.norm(solutions - q, axis=1) / scale)
    return k @ np.linalg.inv(K + noise * np.eye(len(solutions))) @ np.ones(len(solutions))


@pytest.mark.parametrize("scale", [0.05, 0.2, 1.0])
def test_distance_is_the_papers_formula(scale):
    solutions = random_solutions(25)
    field = fit_joint_field(solutions, scale)
    for q in random_solutions(20, seed=1, spread=1.5):
        o = dense_occupancy(solutions, q, scale)
        assert field.evaluate(q)[0] == pytest.approx(-scale * np.log(o), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("scale", [0.03, 0.1, 0.2, 1.0])
def test_gradient_by_finite_differences(scale):
    field, step = fit_joint_field(random_solutions(25), scale), 1e-6
    for q in random_solutions(20, seed=2, spread=2.0):
        gradient = field.evaluate(q)[1]
        ahead = [field.evaluate(q + step * e)[0] for e in np.eye(7)]
        behind = [field.evaluate(q - step * e)[0] for e in np.eye(7)]
        np.testing.assert_allclose(gradient, np.subtract(ahead, behind) / (2 * step), atol=1e-6)


@pytest.mark.parametrize("scale", [0.03, 0.2, 3.0])
def test_one_solution_gives_the_euclidean_distance(scale):
    solution = random_solutions(1)
    field = fit_joint_field(solution, scale)
    for q in random_solutions(20, seed=3, spread=2.0):
        d, gradient, weights = field.evaluate(q)
        offset = q - solution[0]
        assert d == pytest.approx(np.linalg.norm(offset), abs=1e-5 * scale)
        np.testing.assert_allclose(gradient, offset / np.linalg.norm(offset), atol=1e-12)
        np.testing.assert_array_equal(weights, [1.0])


def test_distance_vanishes_at_every_solution():
    solutions = random_solutions(30)
    field = fit_joint_field(solutions)
    for k, q in enumerate(solutions):
        d, gradient, weights = field.evaluate(q)
        assert abs(d) < 1e-5 and np.isfinite(gradient).all()
        assert np.argmax(weights) == k


def test_far_away_nothing_underflows():
    """At 30 rad with l = 0.03 the occupancy is exp(-1000), which is 0 in float64."""
    solutions = random_solutions(20)
    field = fit_joint_field(solutions, 0.03)
    direction = np.ones(7) / np.sqrt(7)
    for far in (3.0, 30.0, 300.0):
        q = far * direction
        r = np.linalg.norm(q - solutions, axis=1)
        expected = -0.03 * logsumexp(-r / 0.03, b=field.beta)
        d, gradient, weights = field.evaluate(q)
        assert d == pytest.approx(expected, rel=1e-12)
        assert np.linalg.norm(gradient) == pytest.approx(1.0, abs=0.05)
        assert weights.sum() == pytest.approx(1.0)


def test_weights_are_a_share_of_each_solution():
    field = fit_joint_field(random_solutions(30))
    for q in random_solutions(20, seed=4, spread=3.0):
        weights = field.evaluate(q)[2]
        assert (weights >= 0).all() and weights.sum() == pytest.approx(1.0)
        r = np.linalg.norm(field.q - q, axis=1)
        np.testing.assert_array_equal(np.argsort(-weights, kind="stable")[0], np.argmin(r))
        sharpness = 4.0 / field.length_scale
        assert weights[1] / weights[0] == pytest.approx(np.exp((r[0] - r[1]) * sharpness), rel=1e-9)


def test_a_field_whose_occupancy_is_not_positive_still_leads_to_solutions():
    """Negative weights, as rounding may leave for all but coinciding solutions."""
    solutions = random_solutions(2)
    field = JointField(solutions, np.zeros(2), np.array([1.0, -2.0]), 0.1)
    q = solutions[1] + 0.01
    d, gradient, weights = field.evaluate(q)
    assert d == pytest.approx(np.linalg.norm(q - solutions[1]))
    assert gradient @ (q - solutions[1]) > 0 and np.isfinite(weights).all()


def test_the_field_has_the_cost_of_every_solution_that_is_worth_going_to():
    """Elsewhere, and far from all, it is the least of distance and cost."""
    solutions, cost = random_solutions(30), np.random.default_rng(8).uniform(0.0, 0.8, 30)
    field = fit_joint_field(solutions, 0.1, cost)
    r = np.linalg.norm(solutions[:, None] - solutions, axis=2)
    worth = np.min(r + cost, axis=1)
    assert (worth == cost).sum() > 20
    for k, q in enumerate(solutions):
        d, _, weights = field.evaluate(q)
        assert d == pytest.approx(worth[k], abs=1e-3 if worth[k] == cost[k] else 0.1)
        if worth[k] == cost[k]:
            assert field.way_left(q) == pytest.approx(0.0, abs=1e-3)
            assert weights[k] == pytest.approx(1.0, abs=1e-2)
    q = 40.0 * np.ones(7)
    expected = np.min(np.linalg.norm(q - solutions, axis=1) + cost)
    assert field.evaluate(q)[0] == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("scale", [0.03, 0.1, 0.2])
def test_gradient_with_costs_by_finite_differences(scale):
    cost = np.random.default_rng(7).uniform(0.0, 3.0, 25)
    field, step = fit_joint_field(random_solutions(25), scale, cost), 1e-6
    for q in random_solutions(20, seed=9, spread=2.0):
        ahead = [field.evaluate(q + step * e)[0] for e in np.eye(7)]
        behind = [field.evaluate(q - step * e)[0] for e in np.eye(7)]
        expected = np.subtract(ahead, behind) / (2 * step)
        np.testing.assert_allclose(field.evaluate(q)[1], expected, atol=1e-6)


def test_adding_the_same_cost_to_all_changes_nothing_but_the_value():
    solutions = random_solutions(20)
    plain, dear = fit_joint_field(solutions, 0.1), fit_joint_field(solutions, 0.1, np.full(20, 3.0))
    for q in random_solutions(10, seed=10, spread=2.0):
        assert dear.evaluate(q)[0] == pytest.approx(plain.evaluate(q)[0] + 3.0, abs=1e-9)
        assert dear.way_left(q) == pytest.approx(plain.way_left(q), abs=1e-9)
        np.testing.assert_allclose(dear.evaluate(q)[1], plain.evaluate(q)[1], atol=1e-9)


def test_a_solution_that_is_never_worth_going_to_changes_nothing():
    """So that solutions may come and go at such a cost, even next to one that counts."""
    rng = np.random.default_rng(11)
    solutions, cost = random_solutions(20), rng.uniform(0.0, 0.5, 20)
    intruder = solutions[3] + 0.05
    more = np.vstack([solutions, intruder])
    for dear in (5.0, 50.0):
        with_it = fit_joint_field(more, 0.1, np.append(cost, dear))
        without = fit_joint_field(solutions, 0.1, cost)
        for q in np.vstack([random_solutions(10, seed=12), intruder + rng.normal(size=7) * 0.02]):
            np.testing.assert_allclose(with_it.evaluate(q)[0], without.evaluate(q)[0], atol=2e-3)
            np.testing.assert_allclose(with_it.evaluate(q)[1], without.evaluate(q)[1], atol=2e-2)


def test_length_scale_follows_the_spacing():
    line = np.zeros((5, 7))
    line[:, 0] = np.arange(5) * 0.25
    assert spacing_length_scale(line) == pytest.approx(0.4 * 0.25)
    assert fit_joint_field(line).length_scale == pytest.approx(0.4 * 0.25)
    assert spacing_length_scale(0.1 * line) == 0.03
    assert spacing_length_scale(10 * line) == 0.2
    uneven = line.copy()
    uneven[:, 0] = [0.0, 0.1, 0.3, 0.6, 3.0]  # nearest neighbours at 0.1 0.1 0.2 0.3 2.4
    assert spacing_length_scale(uneven) == pytest.approx(0.4 * 0.2)
    assert spacing_length_scale(line[:1]) == 0.2
    assert spacing_length_scale(np.tile(line[:1], (4, 1))) == 0.03


def descended(field, q, steps=1000, dt=0.02, gain=5.0, speed=2.0):
    """qd = -k d grad d, at a limited speed."""
    for _ in range(steps):
        d, gradient, _ = field.evaluate(q)
        qd = -gain * d * gradient
        q = q + dt * qd / max(1.0, np.linalg.norm(qd) / speed)
    return q


def test_no_equilibria_between_the_branches_of_two_grasps():
    """A square of solutions, where the pulls of all four cancel in the middle.

    The middle of k pairs of directions is unstable for l < r / (k - 1), r the distance to all.
    """
    corners = np.array(np.meshgrid(*[[-0.25, 0.25]] * 2)).reshape(2, -1).T
    solutions = np.hstack([corners, np.zeros((4, 5))])
    start = 1e-3 * np.array([1.0, -2.0, 3.0, 0.5, -0.5, 0.2, 0.1])
    end = descended(fit_joint_field(solutions), start)
    assert np.linalg.norm(solutions - end, axis=1).min() < 1e-3
    # With the length scale that the paper's authors use it stays in the middle, at none of them.
    stuck = descended(fit_joint_field(solutions, 1.0), start)
    assert np.linalg.norm(solutions - stuck, axis=1).min() > 0.1


def test_costs_decide_where_to_go_and_leave_no_false_end(ik_like_solutions):
    """From every start the descent ends at a solution, and at none that is not worth it."""
    rng = np.random.default_rng(13)
    cost = rng.uniform(0.0, 3.0, len(ik_like_solutions))
    field = fit_joint_field(ik_like_solutions, None, cost)
    worth_it = field.cost == cost
    assert 3 < worth_it.sum() < len(cost)
    for q in rng.uniform(-1, 1, (12, 7)) * IIWA_7.upper:
        end = descended_without_costs(field, q)
        r = np.linalg.norm(ik_like_solutions - end, axis=1)
        assert r.min() < 2e-3 and worth_it[r.argmin()]


def descended_without_costs(field, q, steps=1000, dt=0.02, gain=5.0, speed=2.0):
    for _ in range(steps):
        qd = -gain * max(field.way_left(q), 0.0) * field.evaluate(q)[1]
        q = q + dt * qd / max(1.0, np.linalg.norm(qd) / speed)
    return q


def distance_left(field, n_starts=12, seed=5):
    starts = np.random.default_rng(seed).uniform(-1, 1, (n_starts, 7)) * IIWA_7.upper
    ends = np.array([descended(field, q) for q in starts])
    return np.linalg.norm(ends[:, None] - field.q[None], axis=2).min(axis=1)


@pytest.fixture(scope="module")
def ik_like_solutions():
    """Clusters like those of neighbouring grasps, one per branch of the inverse kinematics."""
    rng = np.random.default_rng(6)
    centers = rng.uniform(-0.8, 0.8, (6, 7)) * IIWA_7.upper
    return np.repeat(centers, 5, axis=0) + rng.normal(scale=0.1, size=(30, 7))


@pytest.mark.parametrize("scale", [0.05, 0.1, None], ids=["0.05", "0.1", "by spacing"])
def test_all_starts_converge_with_a_short_length_scale(ik_like_solutions, scale):
    assert distance_left(fit_joint_field(ik_like_solutions, scale)).max() < 1e-3


def test_a_length_scale_beyond_the_spacing_blends_solutions(ik_like_solutions):
    """Which is why it follows the spacing: with l = 1 the arm stalls between solutions."""
    assert np.median(distance_left(fit_joint_field(ik_like_solutions, 1.0), n_starts=10)) > 0.05
