"""Ascent of a mixture that has to leave the places where the pulls of components cancel."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.grasp_mixture import LENGTH_PER_RADIAN
from tests.lab.paper.ascents import ascent_direction, responsibilities, tangents

TIGHT = np.diag([0.05**2] * 3 + [0.005**2] * 3)
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


def mixture_of(means, covariance=TIGHT):
    n = len(means)
    return RiemannianMixture(np.full(n, 1.0 / n), means, np.tile(covariance, (n, 1, 1)))


def length(v):
    scaled = np.asarray(v) * np.array([1, 1, 1, *[1 / LENGTH_PER_RADIAN] * 3])
    return np.linalg.norm(scaled, axis=-1)


def direction(mixture, X):
    """The preconditioned direction, from the definition."""
    return -np.einsum("...k,...ki->...i", responsibilities(mixture, X), tangents(mixture, X))


def climb(mixture, X, steps=400, gain=0.05):
    for _ in range(steps):
        X = X @ se3.exp(gain * ascent_direction(mixture, X))
    return X


def distance_to_a_mean(mixture, X):
    return length(tangents(mixture, X)).min()


def symmetric_pair(rng, offset):
    """A pose, and a mixture of two components on opposite sides of it."""
    X = se3.random_pose(rng, 1)[0]
    return X, mixture_of(X @ se3.exp(np.stack([offset, -offset])))


@pytest.mark.parametrize("seed", range(12))
def test_it_leaves_the_middle_of_two_components(seed):
    """There the preconditioned direction vanishes."""
    rng = np.random.default_rng(seed)
    offset = rng.normal(size=6) * [0.5, 0.5, 0.5, 0.05, 0.05, 0.05]
    X, mixture = symmetric_pair(rng, offset)
    assert length(direction(mixture, X)) < 1e-9
    u = ascent_direction(mixture, X)
    assert length(u) > 0.5 * length(offset)
    assert mixture.log_density(X @ se3.exp(0.05 * u)) > mixture.log_density(X)
    assert distance_to_a_mean(mixture, climb(mixture, X)) < 1e-3


@pytest.mark.parametrize("seed", range(6))
def test_it_leaves_the_middle_whatever_the_covariances(seed):
    """The six axes alone would not do: the way uphill is between them."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(6, 6)) * np.array([1, 1, 1, 0.1, 0.1, 0.1])[:, None]
    covariance = 0.01 * factor @ factor.T + 0.01 * TIGHT
    offset = rng.normal(size=6) * [0.5, 0.5, 0.5, 0.05, 0.05, 0.05]
    X = se3.random_pose(rng, 1)[0]
    mixture = mixture_of(X @ se3.exp(np.stack([offset, -offset])), covariance)
    u = ascent_direction(mixture, X)
    assert length(u) > 0.1 * length(offset)
    assert mixture.log_density(X @ se3.exp(0.05 * u)) > mixture.log_density(X)


def test_between_a_grasp_and_its_twin_it_turns_to_one_of_them():
    """The hand is turned by 90 degrees from both."""
    grasp = se3.random_pose(np.random.default_rng(2), 1)[0]
    mixture = mixture_of(np.stack([grasp, grasp @ FLIP]))
    X = grasp @ se3.exp([0, 0, np.pi / 2, 0, 0, 0])
    assert length(direction(mixture, X)) < 1e-9
    assert distance_to_a_mean(mixture, climb(mixture, X)) < 1e-3


@pytest.mark.parametrize("error", [0.0, 1e-12, -1e-12, 1e-6, -1e-6])
@pytest.mark.parametrize("axis", range(3))
def test_opposite_to_the_only_grasp_it_turns_one_way_round(axis, error):
    """At 180 degrees both ways are as long; it must not hesitate between them."""
    turn = np.zeros(6)
    turn[axis] = np.pi + error
    mean = se3.random_pose(np.random.default_rng(axis), 1)
    mixture = mixture_of(mean)
    X = mean[0] @ se3.exp(turn)
    u = ascent_direction(mixture, X)
    assert np.linalg.norm(u[:3]) == pytest.approx(np.pi, abs=1e-5)
    assert abs(u[axis]) == pytest.approx(np.pi, abs=1e-5)
    assert distance_to_a_mean(mixture, climb(mixture, X)) < 1e-3


def test_a_ring_of_components_is_left_from_its_centre():
    angles = 2 * np.pi * np.arange(8) / 8
    offsets = np.zeros((8, 6))
    offsets[:, 3], offsets[:, 4] = 0.1 * np.cos(angles), 0.1 * np.sin(angles)
    mixture = mixture_of(se3.exp(offsets))
    assert length(direction(mixture, np.eye(4))) < 1e-9
    assert distance_to_a_mean(mixture, climb(mixture, np.eye(4))) < 1e-3


def test_it_stays_at_a_maximum():
    rng = np.random.default_rng(4)
    mixture = mixture_of(se3.random_pose(rng, 5))
    assert length(ascent_direction(mixture, mixture.means)).max() < 1e-9
    # Two components so close that there is one maximum, in their middle.
    close = 0.2 * np.array([0.05, 0, 0, 0, 0, 0])
    X, blurred = symmetric_pair(rng, close)
    assert length(ascent_direction(blurred, X)) < 1e-9


def test_elsewhere_it_is_the_preconditioned_direction():
    rng = np.random.default_rng(5)
    mixture, X = mixture_of(se3.random_pose(rng, 6)), se3.random_pose(rng, 200)
    pull = (responsibilities(mixture, X) * length(tangents(mixture, X))).sum(axis=1)
    agree = length(direction(mixture, X)) > 0.2 * pull
    assert agree.mean() > 0.9
    np.testing.assert_allclose(
        ascent_direction(mixture, X[agree]), direction(mixture, X[agree]), atol=1e-14
    )


def test_one_step_reaches_a_single_mean():
    rng = np.random.default_rng(9)
    mixture, X = mixture_of(se3.random_pose(rng, 1)), se3.random_pose(rng, 10)
    np.testing.assert_allclose(
        X @ se3.exp(ascent_direction(mixture, X)), np.tile(mixture.means, (10, 1, 1)), atol=1e-13
    )


def test_random_starts_end_at_a_mean():
    rng = np.random.default_rng(6)
    mixture = mixture_of(se3.random_pose(rng, 8))
    X = climb(mixture, se3.random_pose(rng, 100), steps=600)
    assert length(tangents(mixture, X)).min(axis=1).max() < 1e-3


def test_it_moves_with_the_components():
    rng = np.random.default_rng(7)
    X, mixture = symmetric_pair(rng, np.array([0.3, 0.1, -0.2, 0.02, 0.05, 0.0]))
    X_PO = se3.random_pose(rng, 1)[0]
    X = X @ se3.exp(np.array([[0.001] * 6, [0.1] * 6]))
    moved = RiemannianMixture(mixture.weights, X_PO @ mixture.means, mixture.covariances)
    np.testing.assert_allclose(
        ascent_direction(moved, X_PO @ X),
        ascent_direction(mixture, X),
        atol=1e-9,
    )


def test_a_pose_that_is_not_finite_gives_no_number():
    mixture = mixture_of(se3.random_pose(np.random.default_rng(8), 3))
    assert np.isnan(ascent_direction(mixture, np.full((4, 4), np.nan))).all()
