"""EM for millions of poses against the exact formulas in double precision."""

import numpy as np
import pytest

from feasigrasp.errors import GraspError
from feasigrasp.models.geometry import se3
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.float32_kernels import BLOCK, LOG2_TOLERANCE, log_densities, pack
from feasigrasp_lab.training.large_mixture import (
    LargeFit,
    em_pass,
    fit_large_mixture,
    maximization_step,
)
from feasigrasp_lab.training.pose_blocks import PoseBlocks


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


def blocks(X):
    q = se3.quaternions(X)
    return PoseBlocks.of(q, X[:, :3, 3])


def exact_moments(mixture, X):
    r, v = mixture.responsibilities(X), mixture.tangents(X)
    second = np.einsum("nk,nki,nkj->kij", r, v, v)
    return r.sum(axis=0), np.einsum("nk,nki->ki", r, v), second, mixture.log_density(X).sum()


def single_precision(X):
    """The poses that single precision makes of these: rounding is not what is tested."""
    q = se3.quaternions(X)
    q = q.astype(np.float32).astype(float)
    return se3.make_pose(se3.rotations(q), X[:, :3, 3].astype(np.float32).astype(float))


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


@pytest.mark.parametrize(("n", "k"), [(1, 1), (BLOCK + 3, 6), (5000, 24)])
def test_moments_are_the_unpruned_ones(rng, n, k):
    mixture = random_mixture(rng, k)
    X = single_precision(draw(rng, mixture, n))
    mass, first, second, likelihood = em_pass(blocks(X), mixture)
    expected = exact_moments(mixture, X)
    # What is left out is below the tolerance per pose; the rest is single precision.
    allowed = n * k * 2.0**LOG2_TOLERANCE + 1e-6 * n
    np.testing.assert_allclose(mass, expected[0], atol=allowed)
    np.testing.assert_allclose(first, expected[1], atol=5 * allowed)
    np.testing.assert_allclose(second, expected[2], atol=10 * allowed)
    np.testing.assert_allclose(likelihood, expected[3], rtol=1e-6, atol=3e-6 * n)
    np.testing.assert_allclose(mass.sum(), n, rtol=1e-6)


def test_order_of_the_poses_does_not_matter(rng):
    mixture = random_mixture(rng, 8)
    X = draw(rng, mixture, 3000)
    sorted_first = em_pass(blocks(X), mixture)
    shuffled = em_pass(blocks(X[rng.permutation(len(X))]), mixture)
    np.testing.assert_allclose(sorted_first.mass, shuffled.mass, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(sorted_first.second, shuffled.second, rtol=1e-3, atol=1e-3)


def test_blocks_hold_every_pose_once(rng):
    X = draw(rng, random_mixture(rng, 4), 2 * BLOCK + 10)
    packed = blocks(X)
    flat = packed.blocks.swapaxes(1, 2).reshape(-1, 7)[: packed.n]
    found = flat[np.lexsort(flat[:, 4:].T), 4:]
    expected = X[:, :3, 3].astype(np.float32)
    np.testing.assert_array_equal(found, expected[np.lexsort(expected.T)])


def test_neighbours_share_a_block(rng):
    X = draw(rng, random_mixture(rng, 30, spread=0.8), 200 * BLOCK)
    packed = blocks(X)
    spread = packed.blocks[:, 4:].std(axis=2).mean(axis=0)
    assert (spread < 0.9 * X[:, :3, 3].std(axis=0)).all()


def test_threads_change_nothing(rng):
    mixture = random_mixture(rng, 6)
    poses = blocks(draw(rng, mixture, 20 * BLOCK + 1))
    one, two = em_pass(poses, mixture, 1), em_pass(poses, mixture, 2)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_step_is_the_riemannian_mean_step(rng):
    mixture = random_mixture(rng, 1)
    X = single_precision(draw(rng, mixture, 4000))
    settings = LargeFit(rotation_floor=1e-6, translation_floor=1e-6)
    moved = maximization_step(mixture, em_pass(blocks(X), mixture), settings)
    v = mixture.tangents(X)[:, 0]
    np.testing.assert_allclose(
        moved.means[0], mixture.means[0] @ se3.exp(v.mean(axis=0)), atol=1e-5
    )
    np.testing.assert_allclose(moved.covariances[0], np.cov(v.T, bias=True), atol=1e-5)


def test_fit_recovers_a_known_mixture(rng):
    truth = random_mixture(rng, 4, spread=0.05)
    X = draw(rng, truth, 20_000)
    stages = []
    fit, likelihood = fit_large_mixture(
        blocks(X),
        4,
        rng,
        LargeFit(rotation_floor=1e-3, translation_floor=1e-4, warm_poses=4000, tolerance=1e-6),
        lambda stage, i, value: stages.append((stage, value)),
    )
    assert [stage for stage, _ in stages] == sorted((s for s, _ in stages), reverse=True)
    assert {stage for stage, _ in stages} == {"subset", "all"}
    for stage in ("subset", "all"):
        assert np.diff([value for s, value in stages if s == stage]).min() > -1e-5
    nearest = [
        np.argmin(np.linalg.norm(se3.log(se3.inverse(mean) @ fit.means), axis=1))
        for mean in truth.means
    ]
    assert sorted(nearest) == [0, 1, 2, 3]
    error = se3.log(se3.inverse(truth.means) @ fit.means[nearest])
    assert np.abs(error).max() < 0.02
    np.testing.assert_allclose(fit.weights[nearest], truth.weights, atol=0.02)
    np.testing.assert_allclose(likelihood, fit.log_density(X).mean(), atol=1e-3)


def test_starved_components_are_dropped(rng):
    X = np.repeat(se3.random_pose(rng, 3), 200, axis=0)
    fit, _ = fit_large_mixture(blocks(X), 3, rng)
    far = fit.means[:1].copy()
    far[0, :3, 3] += 50.0
    starved = RiemannianMixture(
        np.append(fit.weights, 0.1),
        np.concatenate([fit.means, far]),
        np.concatenate([fit.covariances, fit.covariances[:1]]),
    )
    assert len(maximization_step(starved, em_pass(blocks(X), starved), LargeFit())) == len(fit)


def test_more_components_than_poses_are_refused(rng):
    with pytest.raises(GraspError, match="3 components for 2 poses"):
        fit_large_mixture(blocks(se3.random_pose(rng, 2)), 3, rng)
