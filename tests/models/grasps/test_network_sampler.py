"""The learned sampler with untrained weights: all that does not depend on what was learnt."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.filter import contact_state, filter_grasps
from feasigrasp.models.grasps.grasp_set import ENOUGH
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.grasps.samplers import make_sampler
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp_lab.networks import TorchGraspNetwork

SAMPLER = NetworkSampler(network=TorchGraspNetwork.untrained(seed=1))


@pytest.fixture(scope="module")
def can(true_shapes):
    cloud, to_camera = true_shapes["can"].views(3, np.random.default_rng(1))
    return fit_gpdf(cloud, viewpoint=to_camera)


def test_candidates_are_frames_on_the_surface(can):
    X_OG, width, prior = SAMPLER.candidates(can)
    assert len(X_OG) == len(width) == len(prior) == SAMPLER.n_contacts * SAMPLER.n_approaches
    R = X_OG[:, :3, :3]
    eye = np.broadcast_to(np.eye(3), R.shape)
    np.testing.assert_allclose(R.transpose(0, 2, 1) @ R, eye, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-6)
    first = X_OG[:, :3, 3] - 0.5 * width[:, None] * R[:, :, 0]
    assert np.abs(can.distance(first)).max() < 0.002
    assert (prior >= 0).all() and (prior <= 1).all()


def test_widths_end_on_the_far_side_where_field_and_network_agree(can):
    """Untrained widths are the chords: nearly all end on the surface."""
    X_OG, width, _ = SAMPLER.candidates(can)
    second = X_OG[:, :3, 3] + 0.5 * width[:, None] * X_OG[:, :3, 0]
    assert np.median(np.abs(can.distance(second))) < 2e-4


def test_grasps_are_filtered_ranked_and_reproducible(can):
    grasps = SAMPLER(can)
    again = SAMPLER(can)
    np.testing.assert_array_equal(again.X_OG, grasps.X_OG)
    assert len(grasps) >= 10, dict(grasps.rejected)
    assert (np.diff(grasps.score) <= 0).all()
    passed = filter_grasps(can, grasps.X_OG, grasps.width, SAMPLER.gripper)
    assert len(passed) == len(grasps)


def test_every_candidate_is_accounted_for(can):
    grasps = SAMPLER(can)
    X_OG, _, _ = SAMPLER.candidates(can)
    assert len(grasps) + sum(grasps.rejected.values()) == len(X_OG)


def test_the_field_tops_up_what_the_network_leaves_open(can):
    """One contact gives a few grasps at most; the others are antipodal pairs of the field."""
    few = NetworkSampler(network=SAMPLER.network, n_contacts=1, top_up=False)
    alone, more = few(can), replace(few, top_up=True)(can)
    assert len(alone) < ENOUGH <= len(more)
    assert (np.diff(more.score) <= 0).all()
    assert (contact_state(can, more)[1] < -0.8).all()
    enough = replace(SAMPLER, top_up=False)(can)
    np.testing.assert_array_equal(SAMPLER(can).X_OG, enough.X_OG)  # no need, no change


def test_counts_are_limits(can):
    few = NetworkSampler(network=SAMPLER.network, n_contacts=10, n_approaches=2, n_grasps=3)
    assert len(few.candidates(can)[0]) == 20
    assert len(few(can)) <= 3
    with pytest.raises(GraspError, match="n_contacts"):
        NetworkSampler(network=SAMPLER.network, n_contacts=0)


def test_samplers_by_name():
    sampler = make_sampler("antipodal", n_candidates=100, n_grasps=5)
    assert (sampler.n_candidates, sampler.n_grasps) == (100, 5)
    with pytest.raises(GraspError, match="network, antipodal"):
        make_sampler("magic")
