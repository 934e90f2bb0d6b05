"""Sampled grasps judged on the true mesh, which the sampler never sees."""

import numpy as np
import pytest
import trimesh

from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.filter import COSINE_STEPS
from feasigrasp.models.grasps.grasp_set import contacts
from feasigrasp.models.grasps.hand_clearance import MARGIN
from feasigrasp.models.shape.gpdf import fit_gpdf

SAMPLER = AntipodalSampler()


def boxes_of(gripper):
    """The open hand as boxes (low, high) in the grasp frame, without any margin."""
    half, outer = gripper.max_opening / 2, gripper.max_opening / 2 + gripper.finger_thickness
    side = gripper.finger_width / 2
    px, py, pz = gripper.palm_size
    camera, size = np.array(gripper.camera_center), np.array(gripper.camera_box)
    return [
        ([half, -side, gripper.heel], [outer, side, gripper.tip]),
        ([-outer, -side, gripper.heel], [-half, side, gripper.tip]),
        ([-px / 2, -py / 2, gripper.heel - pz], [px / 2, py / 2, gripper.heel]),
        (camera - size / 2, camera + size / 2),
    ]


def collision_free(truth, grasps, gripper):
    """No point of the true surface lies in the hand, and no box of the hand lies in the object."""
    surface, _ = trimesh.sample.sample_surface_even(truth.mesh, 8000, seed=0)
    free = np.ones(len(grasps), dtype=bool)
    for i, X in enumerate(grasps.X_OG):
        seen_from_hand = (surface - X[:3, 3]) @ X[:3, :3]
        for low, high in boxes_of(gripper):
            within = ((seen_from_hand > low) & (seen_from_hand < high)).all(axis=1).any()
            middle = X[:3, :3] @ ((np.asarray(low) + high) / 2) + X[:3, 3]
            free[i] &= not within and truth.signed_distance(middle[None])[0] > 0
    return free


def in_friction_cone(truth, grasps, gripper, degrees=20.0):
    """Both pads, closing from fully open, meet the true surface within the cone of its normal."""
    good = np.ones(len(grasps), dtype=bool)
    for side in (1, -1):
        closing = side * grasps.X_OG[:, :3, 0]
        start = grasps.X_OG[:, :3, 3] - gripper.max_opening / 2 * closing
        length, normal = truth.cast(start, closing)
        cosine = -np.einsum("ni,ni->n", normal, closing)
        good &= (length < gripper.max_opening) & (cosine > np.cos(np.deg2rad(degrees)))
    return good


@pytest.mark.parametrize("views", [2, 3])
@pytest.mark.parametrize("name", ["box", "can", "bottle"])
def test_most_grasps_are_true_grasps(true_shapes, name, views):
    truth = true_shapes[name]
    cloud, to_camera = truth.views(views, np.random.default_rng(0))
    grasps = SAMPLER(fit_gpdf(cloud, viewpoint=to_camera))
    assert len(grasps) >= 10, dict(grasps.rejected)
    free = collision_free(truth, grasps, SAMPLER.gripper)
    cone = in_friction_cone(truth, grasps, SAMPLER.gripper)
    assert (free & cone).mean() >= 0.8, (free.mean(), cone.mean())


@pytest.fixture(scope="module")
def can(true_shapes):
    truth = true_shapes["can"]
    cloud, to_camera = truth.views(3, np.random.default_rng(1))
    field = fit_gpdf(cloud, viewpoint=to_camera)
    return truth, field, SAMPLER(field)


def test_frames_follow_the_convention(can):
    truth, field, grasps = can
    R = grasps.X_OG[:, :3, :3]
    np.testing.assert_allclose(
        R.transpose(0, 2, 1) @ R, np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(np.cross(R[:, :, 2], R[:, :, 0]), R[:, :, 1], atol=1e-9)
    first, second = contacts(grasps)
    assert np.abs(truth.signed_distance(np.concatenate([first, second]))).mean() < 0.002
    # x = b points from the first contact into the object, against its outward normal.
    assert np.einsum("ni,ni->n", field.normals(first), R[:, :, 0]).max() <= max(COSINE_STEPS)
    assert grasps.width.max() <= SAMPLER.gripper.max_opening - 2 * MARGIN
    assert abs(np.median(grasps.width) - 0.066) < 0.004, "the can's diameter"


def test_grasps_are_ranked_different_and_reproducible(can):
    _, field, grasps = can
    again = AntipodalSampler()(field)
    np.testing.assert_array_equal(again.X_OG, grasps.X_OG)
    assert dict(again.rejected) == dict(grasps.rejected)
    assert (np.diff(grasps.score) <= 0).all()
    positions, R = grasps.X_OG[:, :3, 3], grasps.X_OG[:, :3, :3]
    flipped = R @ np.diag([-1.0, -1.0, 1.0])
    for i in range(len(grasps) - 1):
        apart = np.linalg.norm(positions[i + 1 :] - positions[i], axis=1)
        trace = np.maximum(
            np.einsum("nij,ij->n", R[i + 1 :], R[i]), np.einsum("nij,ij->n", flipped[i + 1 :], R[i])
        )
        angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
        assert ((apart > 0.005) | (angle > np.deg2rad(10))).all()


def test_every_candidate_is_accounted_for(can):
    _, field, grasps = can
    X_OG, _, no_exit = SAMPLER.candidates(field)
    assert len(grasps) + sum(grasps.rejected.values()) == len(X_OG) + no_exit
    assert set(grasps.rejected) <= {
        "too wide", "off the surface", "nothing between the pads", "not antipodal",
        "gripper collides", "near copy", "uncertain",
    }  # fmt: skip


def test_a_thing_wider_than_the_hand_gives_no_grasps_and_says_why():
    rng = np.random.default_rng(2)
    u = rng.normal(size=(2000, 3))
    ball = fit_gpdf(0.08 * u / np.linalg.norm(u, axis=1, keepdims=True))
    grasps = SAMPLER(ball)
    assert len(grasps) == 0
    assert grasps.rejected["too wide"] > 300


def test_counts_are_limits(can):
    _, field, _ = can
    few = AntipodalSampler(n_candidates=100, n_grasps=5, n_approaches=4)
    assert len(few.candidates(field)[0]) == 100
    assert 1 <= len(few(field)) <= 5
    with pytest.raises(GraspError, match="n_grasps"):
        AntipodalSampler(n_grasps=0)


@pytest.mark.parametrize("name", ["blue_mug", "cylinder", "mustard", "white_bowl"])
def test_real_captures_give_grasps(shared_data, name):
    cloud = np.load(shared_data / "real_clouds" / f"6dofgraspnet_{name}.npz")["object_xyz"]
    grasps = SAMPLER(fit_gpdf(cloud, viewpoint=np.zeros(3)))
    assert len(grasps) > 0, dict(grasps.rejected)
