"""The reachable space as a value: density, threshold, file."""

import copy

import numpy as np
import pytest

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.training.fit_reachability import sample_reachable_poses


@pytest.fixture(scope="module")
def shipped() -> ReachableSpace:
    return ReachableSpace.load_named()


def small_space() -> ReachableSpace:
    mixture = RiemannianMixture([1.0], np.eye(4)[None], 0.01 * np.eye(6)[None])
    return ReachableSpace(mixture, float(mixture.log_density(np.eye(4))) - 0.5, {"seed": 3})


def test_shipped_space_accepts_what_the_arm_reaches(shipped):
    X, _ = sample_reachable_poses(20_000, np.random.default_rng(8))
    assert shipped.contains(X).mean() > 0.95


def test_shipped_space_refuses_what_is_out_of_reach(shipped):
    X = se3.random_pose(np.random.default_rng(8), 200)
    X[:, :3, 3] = [1.5, 0.0, 0.5]
    assert not shipped.contains(X).any()


def test_upright_arm_is_a_matter_of_the_flange_frame(shipped):
    q = np.deg2rad([[0, 30, 0, -70, 0, 80, 0]])
    assert shipped.contains(forward_kinematics(q)).all()


def test_threshold_divides(shipped):
    space = small_space()
    near = se3.exp([[0.0, 0, 0, 0.09, 0, 0], [0.0, 0, 0, 0.11, 0, 0]])
    np.testing.assert_array_equal(space.contains(near), [True, False])


def test_a_pose_that_is_not_finite_is_not_contained():
    X = np.eye(4)[None].copy()
    X[0, 0, 3] = np.nan
    assert not small_space().contains(X).any()


def test_file_keeps_everything(tmp_path):
    space = small_space()
    space.save(tmp_path / "deep" / "space.npz")
    again = ReachableSpace.load(tmp_path / "deep" / "space.npz")
    np.testing.assert_array_equal(again.mixture.means, space.mixture.means)
    np.testing.assert_array_equal(again.mixture.covariances, space.mixture.covariances)
    assert again.threshold == space.threshold
    assert again.metadata == {"seed": 3}
    assert copy.deepcopy(again) is again


def test_missing_file_says_how_to_make_one(tmp_path):
    with pytest.raises(ReachabilityError, match="no such file; make one with"):
        ReachableSpace.load(tmp_path / "none.npz")


def test_malformed_files_are_named(tmp_path):
    text = tmp_path / "text.npz"
    text.write_text("hello")
    cut = tmp_path / "cut.npz"
    small_space().save(cut)
    cut.write_bytes(cut.read_bytes()[:-60])
    other = tmp_path / "other.npz"
    np.savez(other, weights=np.ones(1))
    wrong = tmp_path / "wrong.npz"
    np.savez(
        wrong,
        weights=np.ones(2),
        means=np.eye(4),
        covariances=np.eye(6),
        threshold=0.0,
        metadata="{}",
    )
    for path in (text, cut, other, wrong):
        with pytest.raises(ReachabilityError, match=f"{path.name} is no reachable space"):
            ReachableSpace.load(path)


def test_threshold_must_be_a_number():
    with pytest.raises(ReachabilityError, match="threshold = nan"):
        ReachableSpace(small_space().mixture, float("nan"))
