"""Fitting Riemannian mixtures: EM, the number of components, weights, bad input."""

import math

import numpy as np
import pytest

from feasigrasp.errors import GraspError
from feasigrasp.models.geometry import se3
from feasigrasp_lab.mixtures import em as riemannian_em
from feasigrasp_lab.mixtures import fit as riemannian_fit
from feasigrasp_lab.mixtures.fit import fit_best_mixture, fit_riemannian_mixture
from feasigrasp_lab.mixtures.mixture import bic
from tests.lab.paper.ascents import tangents


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def test_fit_recovers_a_known_mixture(rng, clusters):
    X, _, means = clusters(rng, 4000, 4, rotation=0.2, translation=0.02)
    fit = fit_riemannian_mixture(X, 4, rng, rotation_floor=1e-3, translation_floor=1e-4)
    order = np.argsort(fit.means[:, 0, 3])
    error = se3.log(se3.inverse(means) @ fit.means[order])
    assert np.abs(error[:, :3]).max() < 0.03
    assert np.abs(error[:, 3:]).max() < 0.003
    np.testing.assert_allclose(fit.weights, 0.25, atol=1e-3)
    truth = np.diag([0.2**2] * 3 + [0.02**2] * 3)
    scale = np.sqrt(np.outer(np.diag(truth), np.diag(truth)))
    assert np.abs((fit.covariances - truth) / scale).max() < 0.15


def test_single_component_is_the_riemannian_mean_and_covariance(rng):
    X = se3.random_pose(rng, 1)[0] @ se3.exp(0.4 * rng.standard_normal((200, 6)))
    fit = fit_riemannian_mixture(X, 1, rng, tolerance=1e-14)
    xi = se3.log(se3.inverse(fit.means[0]) @ X)
    np.testing.assert_allclose(xi.mean(axis=0), 0, atol=1e-5)
    floor = np.diag([0.05**2] * 3 + [0.005**2] * 3)
    np.testing.assert_allclose(fit.covariances[0], xi.T @ xi / len(X) + floor, atol=1e-5)


def test_fit_of_moved_poses_is_the_moved_fit(rng, clusters):
    X, _, _ = clusters(rng, 90, 5, rotation=0.4)
    T = se3.random_pose(rng, 1)[0]
    fit = fit_riemannian_mixture(X, 5, np.random.default_rng(3))
    moved = fit_riemannian_mixture(T @ X, 5, np.random.default_rng(3))
    np.testing.assert_allclose(moved.means, T @ fit.means, atol=1e-9)
    np.testing.assert_allclose(moved.covariances, fit.covariances, atol=1e-9)
    np.testing.assert_allclose(moved.weights, fit.weights, atol=1e-9)


def test_fit_is_deterministic(rng, clusters):
    X, _, _ = clusters(rng, 50, 3)
    first = fit_riemannian_mixture(X, 3, np.random.default_rng(5))
    second = fit_riemannian_mixture(X, 3, np.random.default_rng(5))
    np.testing.assert_array_equal(first.means, second.means)
    np.testing.assert_array_equal(first.covariances, second.covariances)


def test_log_likelihood_rises_with_every_step(rng, monkeypatch, clusters, numpy_log_density):
    histories = []

    def recorded(*arguments):
        result = riemannian_em.expectation_maximization(*arguments)
        histories.append(result[3])
        return result

    monkeypatch.setattr(riemannian_fit, "expectation_maximization", recorded)
    X, _, _ = clusters(rng, 500, 5, rotation=0.2, translation=0.05)
    # Floors far below the spread: a floor is not part of the likelihood that EM maximises.
    options = {"rotation_floor": 1e-5, "translation_floor": 1e-6, "tolerance": 1e-6}
    fit = fit_riemannian_mixture(X, 5, rng, **options)
    (history,) = histories
    assert len(history) > 3
    assert np.diff(history).min() > -1e-3
    # The last entry belongs to the mixture that is returned.
    np.testing.assert_allclose(numpy_log_density(fit, X).sum(), history[-1], rtol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 127, 128, 129])
def test_any_number_of_poses(rng, n):
    X = se3.random_pose(rng, n)
    fit = fit_riemannian_mixture(X, 4, rng)
    assert 1 <= len(fit) <= min(4, n)
    np.testing.assert_allclose(fit.weights.sum(), 1.0)
    assert np.isfinite(fit.log_density(X)).all()


def test_one_pose_is_its_own_mean_with_the_floor(rng):
    X = se3.random_pose(rng, 1)
    fit = fit_riemannian_mixture(X, 3, rng)
    np.testing.assert_allclose(fit.means, X, atol=1e-14)
    np.testing.assert_allclose(fit.covariances[0], np.diag([2.5e-3] * 3 + [2.5e-5] * 3), atol=1e-15)


def test_duplicates_do_not_make_components(rng):
    X = np.repeat(se3.random_pose(rng, 3), [5, 1, 14], axis=0)
    fit = fit_riemannian_mixture(X, 10, rng)
    assert len(fit) == 3
    np.testing.assert_allclose(sorted(fit.weights), [0.05, 0.25, 0.7], atol=1e-6)


def test_ring_of_grasps_is_rank_deficient_and_fits(rng):
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    X = se3.exp(np.stack([*np.zeros((2, 60)), angle, *np.zeros((3, 60))], axis=1))
    X = X @ se3.make_pose(np.eye(3), [0.05, 0, 0])
    for k in (1, 6):
        fit = fit_riemannian_mixture(X, k, rng)
        assert np.isfinite(fit.log_density(X)).all()
        assert np.linalg.eigvalsh(fit.covariances).min() > 0.9 * 0.005**2


def test_starving_components_are_dropped(rng, clusters):
    X, _, _ = clusters(rng, 12, 2, rotation=1e-3, translation=1e-4)
    fit = fit_riemannian_mixture(X, 12, rng)
    assert (fit.weights * 12 >= 1 - 1e-5).all()
    assert len(fit) < 12


def test_bic_finds_the_number_of_clusters(rng, clusters, numpy_log_density):
    X, _, _ = clusters(rng, 400, 3)
    fit = fit_best_mixture(X, rng, 6)
    assert len(fit) == 3
    expected = (28 * 3 - 1) * math.log(400) - 2 * numpy_log_density(fit, X).sum()
    likelihood = float(fit.log_density(X).sum())
    np.testing.assert_allclose(bic(3, 400, likelihood), expected, rtol=1e-10)


def test_bic_goes_on_from_a_similar_mixture(rng, clusters):
    """One component more, one less, or as many: whatever the poses ask for."""
    X, label, _ = clusters(rng, 400, 4)
    three = fit_best_mixture(X[label != 3], rng, 8)
    assert len(three) == 3
    four = fit_best_mixture(X, rng, 8, start=three)
    assert len(four) == 4
    assert len(fit_best_mixture(X[label != 0], rng, 8, start=four)) == 3
    again = fit_best_mixture(X, rng, 8, start=four)
    np.testing.assert_allclose(again.means, four.means, atol=1e-3)
    assert len(fit_best_mixture(X, rng, 2, start=four)) <= 2


def test_a_pair_of_opposite_poses_gets_two_components_on_request(rng):
    """BIC alone prefers one wide component, with its mean a quarter turn from both."""
    X = se3.random_pose(rng, 1)[0] @ se3.exp(np.array([[0.0] * 6, [0, 0, np.pi - 1e-3, 0, 0, 0]]))
    one = fit_best_mixture(X, rng)
    assert len(one) == 1
    assert np.linalg.norm(tangents(one, X)[..., :3], axis=-1).min() > 1.5
    two = fit_best_mixture(X, rng, max_rotation=np.deg2rad(75))
    assert len(two) == 2
    np.testing.assert_allclose(np.sort(two.weights), [0.5, 0.5])


@pytest.mark.parametrize(
    ("poses", "options", "message"),
    [
        (np.zeros((0, 4, 4)), {}, "n >= 1"),
        (np.eye(4), {}, r"shape \(n, 4, 4\)"),
        (np.full((2, 4, 4), np.nan), {}, "NaN"),
        (2.0 * np.eye(4)[None], {}, "X .* is no rotation"),
        (np.diag([1.0, 1.0, -1.0, 1.0])[None], {}, "X .* is no rotation"),
        (np.eye(4)[None], {"n_components": 0}, "n_components"),
        (np.eye(4)[None], {"rotation_floor": 0.0}, "rotation_floor"),
    ],
)
def test_bad_input_to_a_fit_is_named(rng, poses, options, message):
    with pytest.raises(GraspError, match=message):
        fit_riemannian_mixture(poses, **{"n_components": 2, "rng": rng, **options})
