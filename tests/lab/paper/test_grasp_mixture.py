"""Members of a mixture's components against a plain search."""

import copy

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp_lab.paper.grasp_mixture import (
    LENGTH_PER_RADIAN,
    MAX_ROTATION,
    MixtureMemory,
    fit_grasp_mixture,
)
from tests.lab.paper.ascents import tangents


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


def test_fewer_grasps_than_components():
    grasps, _ = clustered_grasps(n=2)
    mixture = fit_grasp_mixture(grasps, 6, np.random.default_rng(0))
    assert 1 <= len(mixture.mixture) <= 2
    assert set(mixture.medoid) <= {0, 1}


def test_a_deep_copy_is_the_mixture_itself(fitted):
    assert copy.deepcopy(fitted[0]) is fitted[0]


@pytest.mark.parametrize("k", [1, 2, 5, 8])
def test_bic_finds_how_many_components_there_are(k):
    grasps, label = clustered_grasps(n=30 * k, k=k, seed=k)
    mixture = fit_grasp_mixture(grasps, 10, np.random.default_rng(0))
    assert len(mixture.mixture) == k
    for cluster in range(k):
        assert len(set(mixture.component[label == cluster])) == 1


def test_there_are_no_more_components_than_allowed():
    grasps, _ = clustered_grasps(n=240, k=8)
    assert len(fit_grasp_mixture(grasps, 3, np.random.default_rng(0)).mixture) <= 3


@pytest.mark.parametrize("n", [1, 2, 3, 12, 40])
@pytest.mark.parametrize("seed", range(3))
def test_a_grasp_and_its_twin_never_share_a_component(n, seed):
    """However few there are: BIC alone would take one wide component for a single pair."""
    grasps = clustered_grasps(n=n, k=1, seed=seed)[0].with_symmetric()
    mixture = fit_grasp_mixture(grasps, 10, np.random.default_rng(seed))
    assert not np.any(mixture.component[:n] == mixture.component[n:])
    angles = np.linalg.norm(tangents(mixture.mixture, grasps.X_OG)[..., :3], axis=-1)
    assert angles.min(axis=1).max() <= MAX_ROTATION + 1e-9


def test_targets_are_grasps_where_means_are_none():
    """Grasps along the two legs of an L: their mean is in between."""
    along = np.linspace(0.0, 0.05, 20)
    p_OG = np.zeros((40, 3))
    p_OG[:20, 0], p_OG[20:, 1] = along, along
    legs = GraspSet(se3.make_pose(np.eye(3), p_OG), np.full(40, 0.05), np.ones(40))
    mixture = fit_grasp_mixture(legs, 1, np.random.default_rng(0))
    gap = np.linalg.norm(mixture.mixture.means[0, :3, 3] - p_OG, axis=1)
    assert gap.min() > 0.01
    assert {X.tobytes() for X in mixture.targets.means} <= {X.tobytes() for X in legs.X_OG}


def test_the_medoid_is_the_most_plausible_member(fitted):
    mixture, grasps, _ = fitted
    for k, medoid in enumerate(mixture.medoid):
        own = np.flatnonzero(mixture.component == k)
        likely = mixture.mixture.component_log_densities(grasps.X_OG)[:, k]
        assert medoid == own[np.argmax(likely[own])]
    # A poor score outweighs a small gain in density.
    score = np.ones(len(grasps))
    score[mixture.medoid] = 0.01
    worse = GraspSet(grasps.X_OG, grasps.width, score)
    others = fit_grasp_mixture(worse, 3, np.random.default_rng(1))
    assert not set(others.medoid) & set(mixture.medoid)


def test_refitting_to_the_same_grasps_changes_next_to_nothing(fitted):
    mixture, grasps, _ = fitted
    again = fit_grasp_mixture(grasps, 3, np.random.default_rng(5), mixture)
    np.testing.assert_array_equal(again.identity, mixture.identity)
    np.testing.assert_allclose(again.mixture.means, mixture.mixture.means, atol=1e-3)
    np.testing.assert_array_equal(again.medoid, mixture.medoid)


@pytest.mark.parametrize("seed", range(5))
def test_components_keep_their_identity_as_grasps_come_and_go(seed):
    """A component is found again by where it is, whichever of its grasps are left."""
    rng = np.random.default_rng(seed)
    grasps, label = clustered_grasps(n=120, k=4, seed=seed)
    mixture = fit_grasp_mixture(grasps, 10, rng)
    number = {c: mixture.identity[mixture.component[label == c][0]] for c in range(4)}
    for gone in (0, 2, None):
        keep = (rng.random(120) < 0.7) & (label != gone)
        mixture = fit_grasp_mixture(grasps.select(keep), 10, rng, mixture)
        assert len(mixture.mixture) == len(set(label[keep]))
        for c in set(label[keep]) - {0, 2}:
            assert mixture.identity[mixture.component[label[keep] == c][0]] == number[c]


def test_a_component_that_is_new_gets_a_new_identity():
    grasps, label = clustered_grasps(n=90, k=3)
    rng = np.random.default_rng(0)
    two = fit_grasp_mixture(grasps.select(label != 2), 10, rng)
    three = fit_grasp_mixture(grasps, 10, rng, two)
    assert len(three.mixture) == 3
    assert set(two.identity) < set(three.identity)
    assert len(set(three.identity)) == 3


def test_a_wholly_different_set_is_fitted_from_scratch():
    """No component of the mixture before lies anywhere near."""
    rng = np.random.default_rng(0)
    before = fit_grasp_mixture(clustered_grasps(n=30, k=1)[0], 10, rng)
    grasps, _ = clustered_grasps(n=200, k=5, seed=3)
    far = GraspSet(
        se3.exp([1.0, 2.0, 0.5, 1.0, 1.0, 1.0]) @ grasps.X_OG, grasps.width, grasps.score
    )
    assert len(fit_grasp_mixture(far, 10, rng, before).mixture) == 5


def test_the_medoid_stays_while_it_is_about_as_plausible():
    """Without one grasp far out the mean moves a little, and another member is the likeliest."""
    rng, kept, moved = np.random.default_rng(0), 0, 0
    for seed in range(20):
        grasps, _ = clustered_grasps(n=12, k=1, seed=seed)
        mixture = fit_grasp_mixture(grasps, 1, rng)
        keep = np.arange(12) != (mixture.medoid[0] + 1) % 12
        fewer = grasps.select(keep)
        cold, warm = fit_grasp_mixture(fewer, 1, rng), fit_grasp_mixture(fewer, 1, rng, mixture)
        X_OM = grasps.X_OG[mixture.medoid[0]]
        kept += np.array_equal(fewer.X_OG[warm.medoid[0]], X_OM)
        moved += not np.array_equal(fewer.X_OG[cold.medoid[0]], X_OM)
    assert kept > 20 - moved
    assert kept >= 18


def test_it_moves_with_the_object(fitted):
    mixture, grasps, _ = fitted
    X_PO = se3.random_pose(np.random.default_rng(8), 1)[0]
    refitted = fit_grasp_mixture(
        GraspSet(X_PO @ grasps.X_OG, grasps.width, grasps.score), 3, np.random.default_rng(1)
    )
    np.testing.assert_allclose(refitted.mixture.means, X_PO @ mixture.mixture.means, atol=1e-6)


def test_grasps_that_come_back_find_their_components_again():
    """The same set is not fitted again; after none at all the last mixture is gone on from."""
    grasps, label = clustered_grasps()
    memory = MixtureMemory().with_grasps(grasps, 3, 0)
    assert memory.with_grasps(grasps, 3, 0).mixture is memory.mixture
    gone = memory.with_grasps(GraspSet.empty(), 3, 0)
    assert gone.mixture is None
    order = np.random.default_rng(0).permutation(len(grasps))
    back = gone.with_grasps(grasps.select(order), 3, 0)
    before, after = memory.mixture, back.mixture
    for cluster in range(3):
        was = before.identity[before.component[label == cluster][0]]
        assert after.identity[after.component[label[order] == cluster][0]] == was
