"""From one cloud to grasps: every sampler on a ball, and the default one on real clouds."""

import subprocess
import sys

import numpy as np
import pytest

from feasigrasp.errors import GraspError, PointCloudError
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.payload import BEST
from feasigrasp.models.grasps.perceive import perceive
from feasigrasp.models.grasps.samplers import make_sampler, sampler_names

RADIUS = 0.03


def sphere(count=1500):
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return RADIUS * np.column_stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)]
    )


def seen_sphere():
    """A ball 0.4 m before a camera in the origin: the side that faces it."""
    points = sphere()
    return points[points[:, 2] < -0.2 * RADIUS] + [0.0, 0.0, 0.4]


@pytest.mark.parametrize("sampler", sampler_names())
def test_a_ball_is_completed_and_grasped(sampler):
    found = perceive(seen_sphere(), sampler=sampler)
    assert len(found.grasps) > 5
    center = np.array([0.0, 0.0, 0.4])
    size = np.linalg.norm(found.gpdf.completion.points - center, axis=1)
    assert np.median(size) == pytest.approx(RADIUS, abs=0.004)
    lines = np.cross(center - found.grasps.X_OG[:, :3, 3], found.grasps.X_OG[:, :3, 0])
    assert np.median(np.linalg.norm(lines, axis=1)) < 0.01  # the closing line meets the centre
    assert sum(found.grasps.rejected.values()) > 50  # of 100 that the diffusion samples
    assert set(found.grasps.rejected) <= set(Rejection)
    np.testing.assert_array_equal(found.viewpoint, np.zeros(3))


@pytest.mark.parametrize("sampler", sampler_names())
def test_a_cloud_of_all_sides_needs_no_camera(sampler):
    found = perceive(sphere() + [1.0, 2.0, 3.0], viewpoint=None, sampler=sampler)
    assert found.viewpoint is None
    assert len(found.grasps) >= 10
    assert np.ptp(found.grasps.width) < 0.01


def test_the_network_is_the_default_and_a_sampler_of_ones_own_will_do():
    found = perceive(seen_sphere())
    sampled = make_sampler("network")(found.gpdf)
    assert sorted(found.grasps.X_OG.tolist()) == sorted(sampled.X_OG.tolist())

    def mine(gpdf):
        return GraspSet(np.eye(4)[None], [0.04], [gpdf.distance(np.zeros((1, 3)))[0]])

    own = perceive(seen_sphere(), sampler=mine).grasps
    distance = found.gpdf.distance(np.zeros((1, 3)))
    assert own.load.probability()[0] < 0.01  # beside the ball: the best there is all the same
    np.testing.assert_allclose(own.score, distance * BEST)
    with pytest.raises(GraspError, match="sampler is 'magic'; choose one of network, antipodal"):
        perceive(seen_sphere(), sampler="magic")


def test_the_seed_is_that_of_the_antipodal_sampler():
    a, b, c = (perceive(seen_sphere(), sampler="antipodal", seed=n).grasps for n in (0, 0, 1))
    np.testing.assert_array_equal(a.X_OG, b.X_OG)
    assert a.X_OG.shape != c.X_OG.shape or np.abs(a.X_OG - c.X_OG).max() > 1e-3


def test_what_the_pads_cannot_carry_comes_last_or_not_at_all():
    """A ball of 5 cm hangs from any grasp; with lead inside only from those through its middle."""
    light, heavy = (perceive(seen_sphere(), mass=mass, down=(0, 1, 0)) for mass in (0.05, 1.0))
    assert len(heavy.grasps) < len(light.grasps)
    assert heavy.grasps.rejected["too heavy there"] > 0
    assert (np.diff(heavy.grasps.score) <= 0.0).all()


def test_torch_is_loaded_only_when_it_is_needed():
    program = "import sys, feasigrasp.models.grasps.perceive; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], timeout=120).returncode == 0


@pytest.mark.parametrize("name", ["blue_mug", "cheezit", "cylinder", "mustard", "white_bowl"])
def test_real_clouds_are_completed_near_what_was_measured(name, shared_data):
    path = shared_data / "real_clouds" / f"6dofgraspnet_{name}.npz"
    points = np.load(path)["object_xyz"].astype(float)
    found = perceive(points)
    to_field = found.gpdf.refine(points[::20])[0]
    assert np.median(np.abs(to_field)) < 1e-3
    size = np.ptp(points, axis=0).max()
    assert np.ptp(found.gpdf.completion.points, axis=0).max() < 1.6 * size
    assert len(found.grasps) > 0


@pytest.mark.parametrize("far", [1e9, 1e308])
@pytest.mark.filterwarnings("ignore:overflow")
def test_a_viewpoint_beyond_the_earth_is_refused(far):
    with pytest.raises(PointCloudError, match="viewpoint holds 1e.* m, .*give metres"):
        perceive(sphere(), viewpoint=(far, 0.0, 0.0))
