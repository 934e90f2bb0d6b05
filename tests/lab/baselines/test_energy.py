"""The energy of grasp diffusion: gradient by finite differences, and what motions do to it."""

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp_lab.baselines.diffusion_energy import standard_deviation
from feasigrasp_lab.baselines.grasp_diffusion import GraspDiffusion

STEP = 1e-6


@pytest.fixture(scope="module")
def network():
    return GraspDiffusion.untrained(3).network.double()


@pytest.fixture(scope="module")
def cloud():
    """An ellipsoid in units, points and outward normals."""
    ball, sides = sphere_points(96, 1.0), np.array([0.5, 0.3, 0.2])
    normals = ball / sides
    return ball * sides, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def tensor(array):
    return torch.from_numpy(np.ascontiguousarray(array))[None]


def energies(network, cloud, X, time=0.3):
    encoded = network.encode(*map(tensor, cloud))
    times = torch.full((1, len(X)), time, dtype=torch.float64)
    return network(encoded, tensor(X[:, :3, :3]), tensor(X[:, :3, 3]), times)[0].numpy()


def gradients(network, cloud, X, time=0.3):
    encoded = network.encode(*map(tensor, cloud))
    times = torch.full((1, len(X)), time, dtype=torch.float64)
    return network.gradient(encoded, tensor(X[:, :3, :3]), tensor(X[:, :3, 3]), times)[0].numpy()


def poses(n=5, seed=0):
    X = se3.random_pose(np.random.default_rng(seed), n)
    X[:, :3, 3] *= 0.6
    return X


def test_the_gradient_is_that_of_the_energy_by_body_twists(network, cloud):
    X = poses()
    found = gradients(network, cloud, X)
    for i in range(6):
        step = se3.exp(STEP * np.eye(6)[i])
        slope = energies(network, cloud, X @ step) - energies(network, cloud, X @ se3.inverse(step))
        np.testing.assert_allclose(found[:, i], slope / (2 * STEP), rtol=1e-5, atol=1e-7)


def test_moving_object_and_hand_together_changes_nothing(network, cloud):
    X, motion = poses(), se3.random_pose(np.random.default_rng(9), 1)[0]
    motion[:3, 3] = 0.0  # clouds are given relative to their mean
    order = np.random.default_rng(1).permutation(len(cloud[0]))
    moved = tuple(part[order] @ motion[:3, :3].T for part in cloud)
    before, after = energies(network, cloud, X), energies(network, moved, motion @ X)
    np.testing.assert_allclose(after, before, rtol=1e-10)
    assert before.std() > 1e-3
    turns = gradients(network, cloud, X), gradients(network, moved, motion @ X)
    np.testing.assert_allclose(*turns, rtol=1e-8, atol=1e-10)


def test_moving_the_hand_alone_changes_it(network, cloud):
    X = poses()
    turned = X @ se3.exp([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    assert np.abs(energies(network, cloud, turned) - energies(network, cloud, X)).min() > 1e-4


@pytest.mark.parametrize("time", [1e-3, 0.2, 1.0])
def test_noise_has_the_variance_that_was_added_up_to_its_time(time):
    """d(variance)/dt = 0.5^(2 t)."""
    variance, _ = quad(lambda t: 0.25**t, 0.0, time)
    found = standard_deviation(torch.tensor(time, dtype=torch.float64))
    assert float(found) ** 2 == pytest.approx(variance)
