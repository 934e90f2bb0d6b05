"""Members of a mixture's components against a plain search."""

import copy

import numpy as np
import pytest

from feasigrasp.models import se3
from feasigrasp.models.grasp_mixture import LENGTH_PER_RADIAN, fit_grasp_mixture
from feasigrasp.models.grasps import GraspSet


def clustered_grasps(n=60, k=3, seed=0):
    """Grasps around k poses that are far apart, and the label of each."""
    rng = np.random.default_rng(seed)
    means = se3.exp(np.array([[0, 0, 2 * np.pi * i / k, 0.3 * i, 0, 0] for i in range(k)]))
    label = np.arange(n) % k
    noise = rng.normal(size=(n, 6)) * [0.1, 0.1, 0.1, 0.01, 0.01, 0.01]
    return GraspSet(means[label] @ se3.exp(noise), np.full(n, 0.05), np.ones(n)), label


@pytest.fixture(scope="module")
def fitted():
    grasps, label = clustered_grasps()
    return fit_grasp_mixture(grasps, 3, np.random.default_rng(1)), grasps, label


def distance(X_OG, X_OH):
    position = np.linalg.norm(X_OG[:3, 3] - X_OH[:3, 3])
    angle = np.linalg.norm(se3.so3_log(X_OG[:3, :3].T @ X_OH[:3, :3]))
    return position + LENGTH_PER_RADIAN * angle


def test_components_are_the_clusters(fitted):
    mixture, _, label = fitted
    assert len(mixture.mixture) == 3
    for cluster in range(3):
        assert len(set(mixture.component[label == cluster])) == 1
    assert len(set(mixture.component)) == 3


def test_the_component_of_a_grasp_is_the_most_responsible(fitted):
    mixture, grasps, _ = fitted
    weighted = mixture.mixture.component_log_densities(grasps.X_OG)
    np.testing.assert_array_equal(mixture.component, np.argmax(weighted, axis=1))


def test_the_closest_member_of_each_component(fitted):
    mixture, grasps, _ = fitted
    for X_OH in se3.random_pose(np.random.default_rng(2), 20):
        components, members = mixture.closest_members(X_OH)
        np.testing.assert_array_equal(components, [0, 1, 2])
        for component, member in zip(components, members, strict=True):
            own = np.flatnonzero(mixture.component == component)
            distances = [distance(grasps.X_OG[i], X_OH) for i in own]
            assert member == own[np.argmin(distances)]


def test_at_a_grasp_that_grasp_is_the_member(fitted):
    mixture, grasps, _ = fitted
    for k in range(0, len(grasps), 7):
        components, members = mixture.closest_members(grasps.X_OG[k])
        assert members[components == mixture.component[k]] == k


def test_the_member_stays_when_others_go(fitted):
    """The target of the hand does not jump when the mixture is fitted to a few grasps less."""
    mixture, grasps, label = fitted
    X_OH = grasps.X_OG[6] @ se3.exp([0.02, 0, 0, 0, 0.003, 0])
    k = mixture.component[6]
    target = grasps.X_OG[mixture.closest_members(X_OH)[1][k]]
    keep = np.ones(len(grasps), dtype=bool)
    keep[np.flatnonzero(label != label[6])[::2]] = False
    fewer = grasps.select(keep)
    refitted = fit_grasp_mixture(fewer, 3, np.random.default_rng(9))
    targets = fewer.X_OG[refitted.closest_members(X_OH)[1]]
    assert np.abs(targets - target).max(axis=(1, 2)).min() == 0.0


def test_components_without_members_are_left_out(fitted):
    mixture, grasps, _ = fitted
    emptied = copy.copy(mixture)
    object.__setattr__(emptied, "component", np.where(mixture.component == 1, 0, mixture.component))
    components, members = emptied.closest_members(grasps.X_OG[0])
    np.testing.assert_array_equal(components, [0, 2])
    assert len(members) == 2


def test_fewer_grasps_than_components():
    grasps, _ = clustered_grasps(n=2)
    mixture = fit_grasp_mixture(grasps, 6, np.random.default_rng(0))
    assert 1 <= len(mixture.mixture) <= 2
    components, members = mixture.closest_members(np.eye(4))
    assert set(members) <= {0, 1} and len(components) == len(members)


def test_a_deep_copy_is_the_mixture_itself(fitted):
    assert copy.deepcopy(fitted[0]) is fitted[0]
