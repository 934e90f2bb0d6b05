"""A second hand: everything that depends on the hand follows its description."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp_lab.networks import TorchGraspNetwork


@pytest.fixture(scope="module")
def wide_box():
    """A box of 70 x 96 x 150 mm: too wide for the default hand one way, not for the WSG 50."""
    rng = np.random.default_rng(0)
    faces = rng.uniform(-0.5, 0.5, (3000, 3))
    faces[np.arange(3000), np.arange(3000) % 3] = rng.choice([-0.5, 0.5], 3000)
    return fit_gpdf(faces * [0.070, 0.096, 0.150], max_points=512)


def test_the_hand_is_as_long_as_its_parts():
    assert np.isclose(WSG_50.tool_offset, WSG_50.palm_size[2] - WSG_50.heel)
    assert np.isclose(WSG_50.tip - WSG_50.heel, 0.082)
    points = WSG_50.surface_points(WSG_50.max_opening)
    assert np.isclose(np.abs(points[:, 0]).max(), 0.073)  # the body is wider than the open fingers


def test_the_wider_hand_takes_the_wide_side(wide_box):
    narrow = AntipodalSampler(ParallelGripper())(wide_box)
    # Of all that it finds: the best are those of the narrow side.
    wide = AntipodalSampler(WSG_50, least_score=0.0, n_grasps=400)(wide_box)
    assert len(narrow) > 0 and np.abs(narrow.width - 0.070).max() < 0.006
    assert np.abs(wide.width - 0.096).min() < 0.004
    assert wide.width.max() <= WSG_50.max_opening


@pytest.mark.parametrize("hand", [ParallelGripper(), WSG_50], ids=["default", "WSG 50"])
def test_the_network_needs_no_training_for_another_hand(wide_box, hand):
    """Whatever the network proposes, what is left fits the hand and is clear of the box."""
    sampler = NetworkSampler(hand, TorchGraspNetwork.untrained(), n_contacts=200)
    grasps = sampler(wide_box)
    assert len(grasps) > 0, dict(grasps.rejected)
    half = np.array([0.035, 0.048, 0.075])
    points = hand.surface_points(hand.max_opening)
    for X in grasps.X_OG:
        placed = points @ X[:3, :3].T + X[:3, 3]
        assert (np.abs(placed) - half).max(axis=1).min() > -1e-3
    assert grasps.width.max() <= hand.max_opening


@pytest.mark.parametrize("hand", [ParallelGripper(), WSG_50], ids=["default", "WSG 50"])
def test_no_part_of_the_hand_is_far_from_a_point_of_its_skin(hand):
    """Random points on the boxes, the faces of the pads among them."""
    rng = np.random.default_rng(3)
    skin = cKDTree(hand.skin_points())
    length = hand.tip - hand.heel
    finger = np.array([hand.finger_thickness, hand.finger_width, length])
    x = (hand.max_opening + hand.finger_thickness) / 2
    palm = np.array(hand.palm_size)
    for center, size, spacing in (
        ([x, 0.0, hand.tip - length / 2], finger, 0.01),
        ([-x, 0.0, hand.tip - length / 2], finger, 0.01),
        ([0.0, 0.0, hand.heel - palm[2] / 2], palm, 0.015),
        (hand.camera_center, np.array(hand.camera_box), 0.015),
    ):
        faces = rng.uniform(-0.5, 0.5, (500, 3))
        faces[np.arange(500), np.arange(500) % 3] = rng.choice([-0.5, 0.5], 500)
        apart = skin.query(faces * size + np.array(center))[0]
        assert apart.max() <= np.sqrt(0.5) * spacing
    inner = skin.data[np.isclose(np.abs(skin.data[:, 0]), hand.max_opening / 2)]
    assert len(inner) > 40  # the pads' own faces, which touch first
