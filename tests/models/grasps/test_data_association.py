"""Grasps keep their identity and their place from one field to the next."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.non_maximum_suppression import (
    HYSTERESIS,
    SAME_ANGLE,
    SAME_POSITION,
    GraspHistory,
    associate_grasps,
    grasp_distance,
    recheck_grasps,
)
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import fit_gpdf

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
GRIPPER = ParallelGripper()


def a_set(X_OG, score=None):
    n = len(X_OG)
    return GraspSet(X_OG, np.full(n, 0.05), np.full(n, 0.8) if score is None else score)


def apart(n, seed=0):
    """Poses that are no copies of each other."""
    X = se3.random_pose(np.random.default_rng(seed), n)
    X[:, :3, 3] = 0.1 * np.arange(n)[:, None]
    return X


def nudged(X_OG, seed, size=0.2):
    """Poses moved by less than what makes a copy."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(-1, 1, (len(X_OG), 6)) * np.repeat([SAME_ANGLE, SAME_POSITION], 3)
    return X_OG @ se3.exp(size * noise)


@pytest.fixture
def everything_passes():
    return lambda gpdf, grasps: grasps


@pytest.fixture(scope="module")
def field(sphere_cloud):
    return fit_gpdf(sphere_cloud(radius=0.03))


def test_distance_is_a_metric_up_to_flips():
    X = apart(6)
    first, second = a_set(X), a_set(nudged(X, 1))
    d = grasp_distance(first, second)
    np.testing.assert_allclose(d, grasp_distance(second, first).T, atol=1e-7)
    np.testing.assert_allclose(np.diag(grasp_distance(first, first)), 0.0, atol=1e-6)
    flipped = a_set(second.X_OG @ FLIP)
    np.testing.assert_allclose(grasp_distance(first, flipped), d, atol=1e-7)
    turned = a_set(X @ se3.exp([0.1, 0, 0, 0, 0.004, 0]))
    expected = np.hypot(0.1 / SAME_ANGLE, 0.4)
    np.testing.assert_allclose(np.diag(grasp_distance(first, turned)), expected, atol=1e-3)


def test_shuffled_flipped_and_nudged_grasps_are_found_again():
    X, rng = apart(20), np.random.default_rng(3)
    order = rng.permutation(20)
    moved = nudged(X, 4)[order]
    moved[::2] = moved[::2] @ FLIP
    i, j = associate_grasps(a_set(X), a_set(moved))
    assert len(i) == 20
    np.testing.assert_array_equal(order[j], i)


def test_what_is_too_far_apart_is_not_matched():
    X = apart(5)
    far = X @ se3.exp([0, 0, 0, 0, 1.1 * SAME_POSITION, 0])
    turned = X @ se3.exp([1.1 * SAME_ANGLE, 0, 0, 0, 0, 0])
    for other in (far, turned, X[:0]):
        assert len(associate_grasps(a_set(X), a_set(other))[0]) == 0


def test_one_old_grasp_gives_its_number_to_one_new_one_only():
    X = apart(1)
    two = np.concatenate([nudged(X, 1), nudged(X, 2)])
    assert len(associate_grasps(a_set(X), a_set(two))[0]) == 1


def test_survivors_stay_as_they_were(everything_passes, field):
    X = apart(8)
    before = GraspHistory().followed_by(field, a_set(X), everything_passes)
    np.testing.assert_array_equal(np.sort(before.grasps.id), np.arange(8))
    after = before.followed_by(field, a_set(nudged(X, 1)), everything_passes)
    order = np.argsort(before.grasps.id), np.argsort(after.grasps.id)
    np.testing.assert_array_equal(after.grasps.X_OG[order[1]], before.grasps.X_OG[order[0]])
    assert after.next_id == 8


@pytest.mark.parametrize(("factor", "stays"), [(0.95, True), (1.05, False)])
def test_only_a_clearly_better_grasp_takes_the_place_of_an_old_one(
    factor, stays, everything_passes, field
):
    X = apart(3)
    before = GraspHistory().followed_by(field, a_set(X, np.full(3, 0.7)), everything_passes)
    found = a_set(nudged(X, 1), np.full(3, 0.7 * HYSTERESIS * factor))
    after = before.followed_by(field, found, everything_passes).grasps
    expected = X if stays else found.X_OG
    order = np.argsort(after.id)
    numbers = before.grasps.id[np.argsort(before.grasps.id)]
    np.testing.assert_array_equal(after.id[order], numbers)  # the number stays either way
    place = before.grasps.id.argsort()
    np.testing.assert_array_equal(after.X_OG[order], expected[place])
    np.testing.assert_allclose(after.score, found.score)  # by what is known now


def test_lost_grasps_go_and_their_numbers_are_not_used_again(everything_passes, field):
    first, second = apart(4), apart(4, seed=9) @ se3.exp([0, 0, 0, 0, 0, 2.0])
    before = GraspHistory().followed_by(field, a_set(first), everything_passes)
    after = before.followed_by(field, a_set(second), lambda gpdf, grasps: GraspSet.empty())
    np.testing.assert_array_equal(np.sort(after.grasps.id), [4, 5, 6, 7])
    nothing = after.followed_by(field, GraspSet.empty({"why": 3}), lambda gpdf, g: GraspSet.empty())
    assert len(nothing.grasps) == 0 and nothing.next_id == 8
    assert nothing.grasps.rejected["why"] == 3


def test_without_a_check_numbers_persist_and_poses_are_the_new_ones(field):
    X = apart(5)
    before = GraspHistory().followed_by(field, a_set(X))
    moved = nudged(X, 2)
    after = before.followed_by(field, a_set(moved)).grasps
    assert set(after.id) == set(before.grasps.id)
    np.testing.assert_array_equal(after.X_OG, moved)


def test_on_growing_clouds_most_grasps_stay(sphere_cloud):
    """A ball seen again with other noise: the set does not flicker."""
    sampler, rng = AntipodalSampler(), np.random.default_rng(0)
    cloud = sphere_cloud(radius=0.03)

    def noisy():
        return fit_gpdf(cloud + rng.normal(scale=5e-4, size=cloud.shape))

    def recheck(gpdf, grasps):
        return recheck_grasps(gpdf, grasps, GRIPPER)

    history, sets = GraspHistory(), []
    for _ in range(3):
        gpdf = noisy()
        history = history.followed_by(gpdf, sampler(gpdf), recheck)
        sets.append(history.grasps)
    for old, new in zip(sets, sets[1:], strict=False):
        poses = {X.tobytes() for X in old.X_OG}
        assert np.mean([X.tobytes() in poses for X in new.X_OG]) > 0.5
        assert np.isin(new.id, old.id).mean() > 0.6
        assert (np.diff(new.score) <= 0).all()
        assert len(np.unique(new.id)) == len(new)


def test_a_recheck_drops_what_collides_now(sphere_cloud):
    small, large = (fit_gpdf(sphere_cloud(radius=r)) for r in (0.02, 0.045))
    grasps = AntipodalSampler()(small)
    numbered = GraspSet(grasps.X_OG, grasps.width, grasps.score, {}, 7 + np.arange(len(grasps)))
    again = recheck_grasps(small, numbered, GRIPPER)
    assert set(again.id) == set(numbered.id)
    for i, X in zip(again.id, again.X_OG, strict=True):
        np.testing.assert_array_equal(X, grasps.X_OG[i - 7])
    assert len(recheck_grasps(large, numbered, GRIPPER)) == 0
