"""The value type that carries grasps through the diagram."""

import copy
import dataclasses

import numpy as np
import pytest

from feasigrasp.errors import GraspError
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet


@pytest.fixture
def grasps():
    rng = np.random.default_rng(0)
    X_OG = se3.random_pose(rng, 5)
    return GraspSet(X_OG, rng.uniform(0.01, 0.08, 5), rng.random(5), {"narrow": 3})


def test_content_is_read_only_and_its_own(grasps):
    for name in ("X_OG", "width", "score"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(grasps, name)[0] = 0.0
    with pytest.raises(TypeError):
        grasps.rejected["narrow"] = 4
    with pytest.raises(dataclasses.FrozenInstanceError):
        grasps.width = np.zeros(5)

    width, counts = np.full(1, 0.04), {"wide": 1}
    one = GraspSet(np.eye(4)[None], width, np.ones(1), counts)
    width[0], counts["wide"] = 0.0, 7
    assert one.width[0] == 0.04 and one.rejected == {"wide": 1}


def test_a_deep_copy_is_the_set_itself(grasps):
    assert copy.deepcopy(grasps) is grasps
    assert copy.deepcopy([grasps])[0] is grasps


def test_one_pose_without_a_batch_axis():
    assert GraspSet(np.eye(4), 0.05, 1.0).X_OG.shape == (1, 4, 4)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("part", ["X_OG", "width", "score"])
def test_what_is_not_finite_is_refused(grasps, part, bad):
    parts = {name: getattr(grasps, name).copy() for name in ("X_OG", "width", "score")}
    parts[part].flat[-1] = bad
    with pytest.raises(GraspError, match="NaN or infinity"):
        GraspSet(**parts)


@pytest.mark.parametrize(
    "pose",
    [np.zeros((4, 4)), np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([2.0, 1.0, 1.0, 1.0])],
    ids=["zeros", "left-handed", "scaled"],
)
def test_what_is_no_pose_is_refused(grasps, pose):
    X_OG = np.array(grasps.X_OG)
    X_OG[3] = pose
    with pytest.raises(GraspError, match=r"X_OG \[3\] is no rotation or pose"):
        GraspSet(X_OG, grasps.width, grasps.score)
    transposed = np.swapaxes(grasps.X_OG, 1, 2) + np.eye(4, k=-3)  # a translation in the last row
    with pytest.raises(GraspError, match="last row"):
        GraspSet(transposed, grasps.width, grasps.score)


def test_lengths_must_agree(grasps):
    with pytest.raises(GraspError, match=r"width has shape \(4,\); .* n = 5 as in X_OG"):
        GraspSet(grasps.X_OG, grasps.width[:4], grasps.score)


def test_select_counts_what_it_drops(grasps):
    mask = np.array([True, False, True, False, False])
    chosen = grasps.select(mask, "in the way")
    assert len(chosen) == 2
    np.testing.assert_array_equal(chosen.X_OG, grasps.X_OG[mask])
    np.testing.assert_array_equal(chosen.width, grasps.width[mask])
    np.testing.assert_array_equal(chosen.score, grasps.score[mask])
    assert chosen.rejected == {"narrow": 3, "in the way": 3}
    assert chosen.select(np.array([1]), "narrow").rejected == {"narrow": 4, "in the way": 3}
    assert grasps.rejected == {"narrow": 3}


def test_select_by_indices_keeps_their_order_and_may_not_count(grasps):
    chosen = grasps.select(np.array([3, 0]))
    np.testing.assert_array_equal(chosen.score, grasps.score[[3, 0]])
    assert chosen.rejected == {"narrow": 3}
    assert grasps.select(np.arange(5), "nothing").rejected == {"narrow": 3}


def test_ids_go_with_their_grasps(grasps):
    assert (grasps.id == UNKNOWN).all() and grasps.id.dtype == np.int64
    named = dataclasses.replace(grasps, id=np.arange(10, 15))
    np.testing.assert_array_equal(named.select(np.array([3, 1])).id, [13, 11])
    np.testing.assert_array_equal(named.with_symmetric().id, np.tile(np.arange(10, 15), 2))
    np.testing.assert_array_equal(named.counted({"more": 2}).id, named.id)
    with pytest.raises(ValueError, match="read-only"):
        named.id[0] = 0
    with pytest.raises(GraspError, match="3 numbers in id"):
        dataclasses.replace(grasps, id=np.arange(3))


def test_counts_add_up(grasps):
    assert grasps.counted({"narrow": 2, "far": 1, "none": 0}).rejected == {"narrow": 5, "far": 1}


def test_nothing_left(grasps):
    none = grasps.select(np.zeros(5, dtype=bool), "all")
    assert len(none) == 0 and none.X_OG.shape == (0, 4, 4)
    assert none.rejected == {"narrow": 3, "all": 5}
    assert len(GraspSet.empty()) == 0
    assert GraspSet.empty({"all": 2}).rejected == {"all": 2}
    assert len(GraspSet.empty().with_symmetric()) == 0


def test_twins_swap_the_fingers(grasps):
    both = grasps.with_symmetric()
    n = len(grasps)
    assert len(both) == 2 * n and both.rejected == grasps.rejected
    np.testing.assert_array_equal(both.X_OG[:n], grasps.X_OG)
    half_turn = se3.exp([0, 0, np.pi, 0, 0, 0])
    np.testing.assert_allclose(both.X_OG[n:], grasps.X_OG @ half_turn, atol=1e-15)
    finger = np.array([0.04, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(both.X_OG[n:] @ (-finger * [1, 1, 1, -1]), grasps.X_OG @ finger)
    np.testing.assert_array_equal(both.width[n:], grasps.width)
    np.testing.assert_array_equal(both.score[n:], grasps.score)
