"""Log densities in single precision against the exact formulas in double precision."""

import numpy as np
import pytest

from feasigrasp.errors import GraspError
from feasigrasp.models.geometry import se3
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.float32_kernels import BLOCK, log_densities, pack


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


def random_mixture(rng, n, spread=0.3):
    scale = np.diag([1.0] * 3 + [0.3] * 3)
    factors = spread * np.tril(rng.standard_normal((n, 6, 6))) + 0.3 * spread * np.eye(6)
    covariances = scale @ (factors @ factors.swapaxes(1, 2) + 0.02 * np.eye(6)) @ scale
    means = se3.random_pose(rng, n)
    means[:, :3, 3] = rng.uniform(-0.5, 0.5, (n, 3))
    return RiemannianMixture(rng.uniform(0.2, 1, n), means, covariances)


def draw(rng, mixture, n):
    k = rng.choice(len(mixture), n, p=mixture.weights)
    L = np.linalg.cholesky(mixture.covariances)[k]
    return mixture.means[k] @ se3.exp(np.einsum("nij,nj->ni", L, rng.standard_normal((n, 6))))


@pytest.mark.parametrize("n", [1, 7, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 5])
def test_log_density_of_any_number_of_poses(rng, n):
    mixture = random_mixture(rng, 5)
    X = draw(rng, mixture, n)
    np.testing.assert_allclose(
        log_densities(X, pack(mixture)), mixture.log_density(X), atol=3e-5, rtol=1e-6
    )


def test_log_density_at_all_rotation_angles(rng):
    """The polynomials: from the mean itself to half a turn away from it."""
    mixture = random_mixture(rng, 1, spread=1.0)
    axis = rng.standard_normal((400, 3))
    angle = np.concatenate([[0.0, 1e-4], rng.uniform(0.0, np.pi - 1e-3, 398)])
    w = angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    X = mixture.means[0] @ se3.make_pose(se3.so3_exp(w), rng.uniform(-0.3, 0.3, (400, 3)))
    exact = mixture.log_density(X)
    np.testing.assert_allclose(log_densities(X, pack(mixture)), exact, rtol=3e-5, atol=3e-5)


def test_far_poses_have_finite_log_density_and_broken_ones_none(rng):
    mixture, X = random_mixture(rng, 3), se3.random_pose(rng, 4)
    X[0, 0, 3], X[1, 0, 3], X[2, 0, 0] = 1e3, np.nan, np.inf
    values = log_densities(X, pack(mixture))
    assert values[0] < -1e6
    assert np.isfinite(values[0])
    assert np.isnan(values[1:3]).all()
    np.testing.assert_allclose(values[3], mixture.log_density(X[3]), rtol=1e-5)


def test_zero_weight_switches_a_component_off(rng):
    mixture = random_mixture(rng, 3)
    off = RiemannianMixture([0, 1, 1], mixture.means, mixture.covariances)
    X = draw(rng, mixture, 50)
    np.testing.assert_allclose(
        log_densities(X, pack(off)), off.log_density(X), rtol=1e-5, atol=1e-4
    )


def test_wrong_shape_is_named(rng):
    with pytest.raises(GraspError, match=r"shape \(n, 4, 4\)"):
        log_densities(np.eye(4), pack(random_mixture(rng, 1)))
