"""On average the noise of a known mixture is its score; what is not quite right is seen."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp_lab.measures.diffusion_score import (
    known_components,
    log_density,
    relative_error,
    score,
    score_error,
)
from feasigrasp_lab.training.diffusion_batches import with_noise

COUNT = 60_000


@pytest.mark.parametrize("deviation", [0.2, 0.7])
def test_what_least_squares_would_learn_is_the_score(deviation):
    assert score_error(deviation, COUNT, seed=1) < 0.05


def test_noise_without_its_jacobian_is_not():
    """Where it is large; and single poses do not tell, since the components overlap."""
    rng, deviation = np.random.default_rng(1), 0.7
    components = known_components()
    clean = components[rng.integers(3, size=COUNT)]
    X, gradient = with_noise(clean, np.full(COUNT, deviation), rng)
    truth = score(components, X, deviation)
    flat = -se3.log(se3.inverse(clean) @ X) / deviation**2
    assert relative_error(flat, truth) > 0.05
    assert np.linalg.norm(gradient + truth) > 0.2 * np.linalg.norm(truth)


def test_near_a_pose_the_log_density_is_a_parabola():
    """With the curvature of the noise, less a third by the volume of the group about each axis."""
    X = se3.make_pose(np.eye(3), np.zeros((1, 3)))
    deviation, step = 0.1, 1e-3
    for i in range(6):
        moved = se3.exp(step * np.eye(6)[i])[None]
        near = se3.exp(0.01 * step * np.eye(6)[i])[None]
        fall = log_density(X, near, deviation) - log_density(X, moved, deviation)
        curvature = 1.0 / deviation**2 - (1.0 / 3.0 if i < 3 else 0.0)
        assert fall[0] == pytest.approx(0.5 * curvature * step**2 * (1.0 - 1e-4), rel=2e-3)
