"""Langevin sampling against a known mixture on SE(3), and the files of weights."""

import numpy as np
import pytest
import torch

from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.weights_file import WeightsError
from feasigrasp_lab.baselines.diffusion_energy import LENGTH
from feasigrasp_lab.baselines.grasp_diffusion import (
    DiffusedObject,
    GraspDiffusion,
    load_grasp_diffusion,
)

SHARES = np.array([0.6, 0.4])
MIDDLE = np.array([0.1, -0.2, 0.3])


class KnownMixture:
    """The exact energy of two poses with the noise of a time; stands in for the network.

    The gradient of ``-log N`` by a body twist is ``J_r^-T v / variance``, see docs/method.md.
    """

    def __init__(self, X):
        self.X = X  # in units, about the middle

    def gradient(self, cloud, R, p, time, *, train=False):
        Y = se3.make_pose(R[0].double().numpy(), p[0].double().numpy())
        variance = float((0.25 ** float(time[0, 0]) - 1.0) / (2.0 * np.log(0.5)))
        v = np.stack([se3.log(se3.inverse(X) @ Y) for X in self.X])
        log = np.log(SHARES)[:, None] - (v**2).sum(-1) / (2.0 * variance)
        r = np.exp(log - np.logaddexp.reduce(log, axis=0))
        slopes = np.einsum("knji,knj->kni", se3.right_jacobian_inverse(v), v) / variance
        return torch.from_numpy((r[..., None] * slopes).sum(0))[None]


@pytest.fixture(scope="module")
def known():
    X = se3.random_pose(np.random.default_rng(4), 2)
    X[:, :3, 3] *= 0.5
    return DiffusedObject(KnownMixture(X), None, MIDDLE)


@pytest.fixture(scope="module")
def drawn(known):
    return known.sample(200, np.random.default_rng(0))


def test_samples_are_at_the_poses_of_a_known_mixture(known, drawn):
    X = known.network.X.copy()
    X[:, :3, 3] = MIDDLE + LENGTH * X[:, :3, 3]
    v = np.stack([se3.log(se3.inverse(each) @ drawn) for each in X])
    angle, way = (np.linalg.norm(v[..., part], axis=-1) for part in (slice(3), slice(3, 6)))
    near = (angle < 0.02) & (way < 0.003)
    assert near.any(axis=0).mean() > 0.98
    # Three standard errors of 200 draws, and what a finite number of steps does not mix.
    assert near[0].mean() == pytest.approx(SHARES[0], abs=0.15)


def test_the_same_seed_draws_the_same(known, drawn):
    np.testing.assert_array_equal(known.sample(200, np.random.default_rng(0)), drawn)


def test_a_gradient_in_metres_has_the_units_of_metres(known):
    X = se3.make_pose(np.eye(3), MIDDLE + [0.02, 0.0, 0.0])[None]
    found = known.gradient(X, 0.5)
    units = se3.make_pose(np.eye(3), [[0.02 / LENGTH, 0.0, 0.0]])
    parts = (torch.from_numpy(part)[None] for part in (units[:, :3, :3], units[:, :3, 3]))
    expected = known.network.gradient(None, *parts, torch.full((1, 1), 0.5))[0].numpy()
    np.testing.assert_allclose(found[:, :3], expected[:, :3], rtol=1e-5)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:] / LENGTH, rtol=1e-5)


def ball(n=64):
    points = sphere_points(n, 0.03)
    return GraspInput(points, points / 0.03, np.zeros((n, 4)))


def test_weights_come_back_from_their_file(tmp_path):
    made = GraspDiffusion.untrained(1)
    made.save(tmp_path / "weights.npz")
    X = se3.random_pose(np.random.default_rng(0), 3)
    read = GraspDiffusion.load(tmp_path / "weights.npz")
    np.testing.assert_array_equal(read.at(ball()).gradient(X), made.at(ball()).gradient(X))
    assert np.isfinite(load_grasp_diffusion().at(ball()).gradient(X)).all()


def test_other_files_are_refused_with_what_mends_them(tmp_path):
    with pytest.raises(WeightsError, match="feasigrasp train diffusion"):
        GraspDiffusion.load(tmp_path / "missing.npz")
