"""The sampler of the baseline on a ball, whose chords are known."""

import numpy as np
import pytest

from feasigrasp.errors import GraspError
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.network.surface_input import grasp_input
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp_lab.baselines.diffusion_sampler import DiffusionSampler
from feasigrasp_lab.baselines.grasp_diffusion import GraspDiffusion

RADIUS = 0.03


@pytest.fixture(scope="module")
def ball():
    return fit_gpdf(sphere_points(256, RADIUS))


@pytest.fixture(scope="module")
def sampler():
    return DiffusionSampler(n_samples=24)


def test_contacts_are_where_the_closing_line_meets_the_surface(ball, sampler):
    """Hands 8 mm beside the middle along x, and 15 mm up: half chords of 26 mm."""
    hands = se3.make_pose(np.eye(3), [[0.008, 0.015, 0.0], [0.0, 0.0, 0.0]])
    grasps = sampler.judged(ball, hands)
    chord = 2.0 * np.sqrt(RADIUS**2 - 0.015**2)
    best = int(np.argmin(np.abs(grasps.X_OG[:, 1, 3])))
    assert grasps.width[best] == pytest.approx(2.0 * RADIUS, abs=1e-3)
    for X_OG, width in zip(grasps.X_OG, grasps.width, strict=True):
        across = chord if X_OG[1, 3] > 0.01 else 2.0 * RADIUS
        assert width == pytest.approx(across, abs=1.5e-3)
        np.testing.assert_allclose(X_OG[:3, 3], [0.0, X_OG[1, 3], 0.0], atol=1e-3)


def test_hands_that_hold_nothing_are_counted(ball, sampler):
    far = se3.make_pose(np.eye(3), [[0.0, 0.2, 0.0], [0.02, 0.0, 0.0]])
    grasps = sampler.judged(ball, far)  # beside the object; with a pad inside it
    assert len(grasps) == 0
    assert grasps.rejected["nothing between the pads"] == 2


def test_samples_of_the_packaged_energy_hold_a_ball(ball, sampler):
    """Closing lines of hands that hold it pass within 20 degrees of both normals."""
    surface = grasp_input(ball, sampler.n_points)
    X_OG = sampler.diffusion.at(surface).sample(24, np.random.default_rng(0))
    assert X_OG.shape == (24, 4, 4)
    x, p = X_OG[:, :3, 0], X_OG[:, :3, 3]
    beside = np.linalg.norm(p - np.einsum("ni,ni->n", p, x)[:, None] * x, axis=1)
    assert (beside < RADIUS * np.sin(np.deg2rad(20.0))).mean() > 0.5
    grasps = sampler(ball)
    assert 0 < len(grasps) <= 24
    np.testing.assert_array_equal(sampler(ball).X_OG, grasps.X_OG)


def test_an_untrained_energy_holds_nothing(ball):
    drawn = DiffusionSampler(diffusion=GraspDiffusion.untrained(), n_samples=24)
    assert len(drawn(ball)) < 6


def test_counts_are_checked():
    with pytest.raises(GraspError, match="n_samples = 0"):
        DiffusionSampler(n_samples=0)
