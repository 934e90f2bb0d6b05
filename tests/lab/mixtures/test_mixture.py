"""Riemannian mixtures against plain NumPy, finite differences and known truths."""

import copy

import numpy as np
import pytest
from scipy.special import logsumexp

from feasigrasp.errors import GraspError
from feasigrasp.models.geometry import se3
from feasigrasp_lab.mixtures.mixture import RiemannianMixture, evaluate_kernel, posterior_kernel
from tests.lab.paper.ascents import ascent_direction, responsibilities


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def random_mixture(rng: np.random.Generator, n: int, spread: float = 0.3) -> RiemannianMixture:
    factors = spread * np.tril(rng.standard_normal((n, 6, 6))) + 0.3 * spread * np.eye(6)
    covariances = factors @ factors.swapaxes(1, 2) + 0.01 * np.eye(6)
    return RiemannianMixture(rng.uniform(0.2, 1, n), se3.random_pose(rng, n), covariances)


@pytest.mark.parametrize("k", [1, 4])
def test_density_is_the_formula(rng, k, numpy_log_density):
    mixture, X = random_mixture(rng, k), se3.random_pose(rng, 40)
    np.testing.assert_allclose(mixture.log_density(X), numpy_log_density(mixture, X), rtol=1e-10)
    joint = mixture.component_log_densities(X) + np.log(mixture.weights)
    np.testing.assert_allclose(logsumexp(joint, axis=1), mixture.log_density(X), rtol=1e-12)


@pytest.mark.parametrize("n", [2, 300])
def test_density_of_a_batch_is_that_of_its_poses(rng, n):
    mixture, X = random_mixture(rng, 5), se3.random_pose(rng, n)
    X[n // 2, 0, 3] = np.nan
    one_by_one = [float(mixture.log_density(pose)) for pose in X]
    np.testing.assert_allclose(mixture.log_density(X), one_by_one, rtol=1e-12)
    assert np.isnan(mixture.log_density(X)).sum() == 1


def test_a_batch_far_from_every_component_has_finite_densities(rng):
    X = se3.random_pose(rng, 70)
    X[:, 0, 3] += 1e4
    mixture = random_mixture(rng, 3)
    off = RiemannianMixture([0, 1, 1], mixture.means, mixture.covariances)
    assert (off.log_density(X) < -1e6).all()
    assert np.isfinite(off.log_density(X)).all()


@pytest.mark.parametrize("k", [1, 2, 5])
def test_gradient_against_finite_differences(rng, k):
    h = 1e-6
    for _ in range(20):
        mixture = random_mixture(rng, k)
        # Away from the cut locus (a rotation by pi from a mean), where Log jumps.
        X = mixture.means[0] @ se3.exp(rng.uniform(-0.8, 0.8, 6))
        steps = h * np.eye(6)
        plus, minus = X @ se3.exp(steps), X @ se3.exp(-steps)
        numeric = (mixture.log_density(plus) - mixture.log_density(minus)) / (2 * h)
        gradient = ascent_direction(mixture, X, gradient=True)
        assert np.linalg.norm(gradient - numeric) < 1e-6 * max(1.0, np.linalg.norm(numeric))


@pytest.mark.parametrize("offset", [3.0, 3.1, 3.14, 3.1415])
def test_gradient_next_to_a_half_turn(rng, offset):
    """Close to the cut locus the closed form holds as well; the steps stay on this side of it."""
    h = 1e-6
    for _ in range(10):
        axis = rng.normal(size=3)
        axis *= offset / np.linalg.norm(axis)
        mean = se3.random_pose(rng, 1)
        mixture = RiemannianMixture([1.0], mean, random_mixture(rng, 1).covariances)
        X = mean[0] @ se3.exp(np.concatenate([axis, rng.uniform(-0.5, 0.5, 3)]))
        plus, minus = X @ se3.exp(h * np.eye(6)), X @ se3.exp(-h * np.eye(6))
        numeric = (mixture.log_density(plus) - mixture.log_density(minus)) / (2 * h)
        gradient = ascent_direction(mixture, X, gradient=True)
        assert np.linalg.norm(gradient - numeric) < 1e-5 * np.linalg.norm(numeric)


@pytest.mark.parametrize("distance", [0.3, 3.0, 30.0])
def test_gradient_far_from_narrow_components(rng, distance):
    """Where the density itself underflows."""
    covariance = np.diag([0.05**2] * 3 + [0.005**2] * 3)
    mixture = RiemannianMixture(np.ones(4), se3.random_pose(rng, 4), np.tile(covariance, (4, 1, 1)))
    for _ in range(10):
        towards = rng.normal(size=3)
        towards *= distance / np.linalg.norm(towards)
        X = mixture.means[0] @ se3.exp(np.concatenate([rng.uniform(-1, 1, 3), towards]))
        h = 1e-6
        plus, minus = X @ se3.exp(h * np.eye(6)), X @ se3.exp(-h * np.eye(6))
        numeric = (mixture.log_density(plus) - mixture.log_density(minus)) / (2 * h)
        gradient = ascent_direction(mixture, X, gradient=True)
        assert np.linalg.norm(gradient - numeric) < 1e-5 * np.linalg.norm(numeric)


def test_far_poses_have_finite_density_and_direction(rng):
    mixture = RiemannianMixture(
        [1, 1], se3.random_pose(rng, 2), np.tile(1e-6 * np.eye(6), (2, 1, 1))
    )
    X = se3.make_pose(np.eye(3), [100.0, 0, 0])
    assert mixture.log_density(X) < -1e9
    assert np.isfinite(ascent_direction(mixture, X, gradient=True)).all()


def test_kernels_are_what_the_methods_use(rng):
    mixture, X = random_mixture(rng, 3), se3.random_pose(rng, 1)[0]
    tangents, log_density, r = np.empty((3, 6)), np.empty(3), np.empty(3)
    evaluate_kernel(X, mixture.parameters, tangents, log_density)
    total = posterior_kernel(mixture.parameters.log_weights, log_density, r)
    xi = se3.log(np.linalg.inv(mixture.means) @ X)
    np.testing.assert_allclose(tangents, xi, atol=1e-12)
    np.testing.assert_allclose(r, responsibilities(mixture, X), atol=1e-14)
    np.testing.assert_array_equal(log_density, mixture.component_log_densities(X))
    assert total == mixture.log_density(X)


def test_moving_mixture_and_pose_together_changes_nothing(rng):
    mixture, X = random_mixture(rng, 4), se3.random_pose(rng, 20)
    T = se3.random_pose(rng, 1)[0]
    moved = RiemannianMixture(mixture.weights, T @ mixture.means, mixture.covariances)
    np.testing.assert_allclose(moved.log_density(T @ X), mixture.log_density(X), rtol=1e-10)
    np.testing.assert_array_equal(moved.covariances, mixture.covariances)


def test_zero_weight_switches_a_component_off(rng):
    mixture = random_mixture(rng, 3)
    off = RiemannianMixture([0, 2, 6], mixture.means, mixture.covariances)
    X = mixture.means[0]
    np.testing.assert_allclose(off.weights, [0, 0.25, 0.75])
    assert responsibilities(off, X)[0] == 0.0
    rest = RiemannianMixture([1, 3], mixture.means[1:], mixture.covariances[1:])
    np.testing.assert_allclose(
        *(ascent_direction(each, X, gradient=True) for each in (off, rest)), rtol=1e-12
    )


def test_mixture_is_immutable_and_copies_to_itself(rng):
    mixture = random_mixture(rng, 2)
    assert copy.deepcopy(mixture) is mixture
    for array in (mixture.weights, mixture.means, mixture.covariances, *mixture.parameters):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.mark.parametrize(
    ("weights", "covariances", "message"),
    [
        ([1.0], np.eye(6)[None], "means has shape .*K = 1 as in weights"),
        ([0.0, 0.0], np.tile(np.eye(6), (2, 1, 1)), "not all 0"),
        ([1.0, -1.0], np.tile(np.eye(6), (2, 1, 1)), "not negative"),
        ([1.0, 1.0], np.zeros((2, 6, 6)), "positive definite"),
        ([1.0, 1.0], np.full((2, 6, 6), np.nan), "NaN"),
    ],
)
def test_bad_parameters_are_named(weights, covariances, message):
    with pytest.raises(GraspError, match=message):
        RiemannianMixture(weights, np.tile(np.eye(4), (2, 1, 1)), covariances)


def test_a_pose_that_is_not_finite_gives_no_number(rng):
    X = np.full((4, 4), np.nan)
    mixture = random_mixture(rng, 2)
    assert np.isnan(ascent_direction(mixture, X, gradient=True)).all()
    assert np.isnan(mixture.log_density(X))


def test_wrong_pose_shape_is_named(rng):
    with pytest.raises(GraspError, match="give numbers of shape"):
        random_mixture(rng, 2).log_density(np.zeros((3, 4)))
