"""The hand's target: a step up the weighted density of grasps, and at last a grasp."""

import numpy as np
import pytest

from feasigrasp.models.control.task.target import (
    LENGTH_PER_RADIAN,
    SHARPNESS,
    neighbours,
    target_kernel,
)
from feasigrasp.models.geometry import se3
from feasigrasp.models.mixtures.mixture import RiemannianMixture

RNG = np.random.default_rng(0)
X_OG = se3.random_pose(RNG, 1)[0]
NEAR = RNG.uniform(-1.0, 1.0, (6, 6)) * ([0.1] * 3 + [0.015] * 3)
NEAR[0] = 0.0
AROUND = X_OG @ np.array([se3.exp(v) for v in NEAR])
WEIGHTS = RNG.uniform(0.2, 2.0, 6)


def hand_at(distance, back=0.0):
    """Beside the chosen grasp, and behind it."""
    return X_OG @ se3.exp([0.0, 0.0, 0.0, 0.8 * distance, 0.6 * distance, -back])


def step(weights, distance):
    """From the chosen grasp to the target."""
    return se3.log(se3.inverse(X_OG) @ target_kernel(X_OG, NEAR, weights, hand_at(distance)))


def length(v):
    return np.linalg.norm(v * ([LENGTH_PER_RADIAN] * 3 + [1.0] * 3))


@pytest.mark.parametrize("distance", [0.06, 0.12, 0.3])
def test_the_step_is_the_bandwidth_times_the_gradient_of_the_log_density(distance):
    """By central differences of the density of the weighted grasps, on the whole group."""
    covariance = (SHARPNESS * distance) ** 2 * np.diag([LENGTH_PER_RADIAN**-2] * 3 + [1.0] * 3)
    density = RiemannianMixture(WEIGHTS, AROUND, np.tile(covariance, (len(WEIGHTS), 1, 1)))
    eps = 1e-6 * np.eye(6)
    ahead, behind = (density.log_density(X_OG @ [se3.exp(s * e) for e in eps]) for s in (1, -1))
    expected = covariance @ (ahead - behind) / 2e-6
    assert length(expected) > 1e-4
    assert length(step(WEIGHTS, distance) - expected) < 0.03 * length(expected)
    np.testing.assert_allclose(
        density.log_density_gradient(X_OG), (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-4
    )


def test_one_sharp_weight_is_the_grasp_itself():
    sharp = np.where(np.arange(6) == 0, 1.0, 0.0)
    for weights, steps in ((sharp, NEAR), (np.ones(1), NEAR[:1]), (np.ones(0), NEAR[:0])):
        target = target_kernel(X_OG, steps, weights, hand_at(0.3))
        np.testing.assert_allclose(target, X_OG, atol=1e-12)


def test_far_away_the_target_is_the_weighted_mean_and_near_the_grasp():
    far = step(WEIGHTS, 100.0)
    np.testing.assert_allclose(far, WEIGHTS @ NEAR / WEIGHTS.sum(), atol=1e-6)
    lengths = [length(step(WEIGHTS, d)) for d in (0.3, 0.1, 0.05, 0.01)]
    assert np.all(np.diff(lengths) < 0.0) and lengths[-1] < 1e-3 * length(far)
    # Lined up, wherever on the way in.
    for back in (0.0, 0.1):
        target = target_kernel(X_OG, NEAR, WEIGHTS, hand_at(0.0, back))
        np.testing.assert_allclose(target, X_OG, atol=1e-12)


def test_more_grasps_on_one_side_draw_the_hand_there():
    """The density decides, not the number of sides."""
    steps = np.zeros((5, 6))
    steps[:, 3] = 0.0, 0.011, 0.013, 0.015, -0.013
    target = target_kernel(X_OG, steps, np.ones(5), hand_at(0.2))
    assert (se3.inverse(X_OG) @ target)[0, 3] > 0.003


def test_the_target_changes_continuously_with_weights_and_with_the_hand():
    fine = np.linspace(0.0, 3.0, 3001)
    swept = np.array([step(np.append(WEIGHTS[:5], w), 0.15) for w in fine])
    moved = np.array([step(WEIGHTS, d) for d in np.linspace(0.001, 0.3, 3001)])
    for path in (swept, moved):
        assert length(path[-1] - path[0]) > 1e-3
        jumps = [length(v) for v in np.diff(path, axis=0)]
        assert max(jumps) < 0.005 * sum(jumps)


def test_neighbours_are_those_within_the_radius_itself_first():
    radius = 0.02
    found, steps = neighbours(AROUND, 2, radius)
    distances = [length(se3.log(se3.inverse(AROUND[2]) @ X)) for X in AROUND]
    assert found[0] == 2 and 1 < len(found) < len(AROUND)
    assert set(found) == set(np.flatnonzero(np.array(distances) <= radius))
    np.testing.assert_allclose(AROUND[2] @ se3.exp(steps), AROUND[found], atol=1e-12)
    assert list(neighbours(AROUND, 2, 0.0)[0]) == [2]
