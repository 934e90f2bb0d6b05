"""The post-filter on a ball and a box, where right and wrong grasps are known by construction."""

import numpy as np
import pytest

from feasigrasp.errors import GraspError
from feasigrasp.models.gpdf import fit_gpdf
from feasigrasp.models.grasp_filter import contact_cosine, contacts, filter_grasps
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.gripper import ParallelGripper

GRIPPER = ParallelGripper()


@pytest.fixture(scope="module")
def ball(sphere_cloud):
    return fit_gpdf(sphere_cloud(radius=0.03))


def grasp(x=(1, 0, 0), z=(0, 0, 1), at=(0, 0, 0)):
    """A grasp frame with closing direction x, approach z (made perpendicular) and origin."""
    x = np.array(x, dtype=float) / np.linalg.norm(x)
    z = np.array(z, dtype=float) - np.dot(x, z) * x
    z /= np.linalg.norm(z)
    X = np.eye(4)
    X[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    X[:3, 3] = at
    return X


def test_a_grasp_through_the_centre_passes(ball):
    kept = filter_grasps(ball, grasp()[None], [0.06], GRIPPER)
    assert len(kept) == 1 and not kept.rejected
    assert 0.9 < kept.score[0] <= 1.0
    np.testing.assert_array_equal(kept.X_OG[0], grasp())


REASONS = {
    "too wide": (grasp(), 0.084),
    "off the surface": (grasp(), 0.045),
    # A chord 24 mm from the centre of a 30 mm ball: both normals are 53 degrees off the line.
    "not antipodal": (grasp(at=(0, 0.024, 0)), 0.036),
    # Between two points outside, beside the ball.
    "nothing between the pads": (grasp(at=(0, 0.0325, 0)), 0.002),
}


@pytest.mark.parametrize("reason", REASONS)
def test_each_reason_is_counted(ball, reason):
    X_OG, width = REASONS[reason]
    kept = filter_grasps(ball, [X_OG, grasp()], [width, 0.06], GRIPPER)
    assert dict(kept.rejected) == {reason: 1}
    assert len(kept) == 1


def test_palm_and_fingers_must_stay_outside(ball):
    """Hands whose palm or fingers come too close to a ball of 30 mm radius between the pads."""
    for hand, passes in (
        (ParallelGripper(heel=-0.040), True),
        (ParallelGripper(heel=-0.020), False),  # palm inside the ball
        (ParallelGripper(heel=-0.0315), False),  # 1.5 mm away: less than the margin
        (ParallelGripper(max_opening=0.064), False),  # pads 2 mm away on either side
    ):
        kept = filter_grasps(ball, grasp()[None], [0.06], hand)
        assert bool(len(kept)) == passes, hand
        if not passes:
            assert set(kept.rejected) <= {"gripper collides", "too wide"}


def test_the_camera_counts_as_part_of_the_hand(ball):
    hand = ParallelGripper(camera_center=(0.0, 0.0, -0.035))
    assert dict(filter_grasps(ball, grasp()[None], [0.06], hand).rejected) == {
        "gripper collides": 1
    }


def test_limits_are_relaxed_only_while_too_few_pass(ball):
    tilts = [0.0, 0.006, 0.012]  # chords off the centre: normals 0, 12 and 24 degrees off the line
    X_OG = [grasp(at=(0, y, 0)) for y in tilts]
    width = [2 * np.sqrt(0.03**2 - y**2) for y in tilts]
    cosine = contact_cosine(ball, GraspSet(np.array(X_OG), np.array(width), np.zeros(3)))
    expected = [-np.cos(2 * np.arcsin(y / 0.03)) for y in tilts]
    np.testing.assert_allclose(cosine, expected, atol=0.03)
    for enough, left in ((1, 1), (2, 2), (3, 3)):
        kept = filter_grasps(
            ball, X_OG, width, GRIPPER, enough=enough, cosine_steps=(-0.95, -0.85, -0.6)
        )
        assert len(kept) == left
        assert kept.rejected.get("not antipodal", 0) == 3 - left


def test_a_shorter_lever_arm_scores_higher():
    rng = np.random.default_rng(0)
    faces = rng.uniform(-0.5, 0.5, (1500, 3))
    faces[np.arange(1500), np.arange(1500) % 3] = rng.choice([-0.5, 0.5], 1500)
    bar = fit_gpdf(faces * [0.03, 0.04, 0.24])
    heights = [0.0, 0.05, 0.09]
    X_OG = np.array([grasp(z=(0, 1, 0), at=(0, 0, h)) for h in heights])
    kept = filter_grasps(bar, X_OG, np.full(3, 0.03), GRIPPER, enough=3)
    np.testing.assert_allclose(kept.X_OG[:, 2, 3], heights)
    assert (np.diff(kept.score) < -0.02).all()
    assert (kept.score >= 0).all() and (kept.score <= 1).all()


def test_contacts_are_a_width_apart_along_x():
    X_OG = np.array([grasp((0, 1, 0), (1, 0, 0), (0.1, 0.2, 0.3))])
    first, second = contacts(GraspSet(X_OG, np.array([0.04]), np.zeros(1)))
    np.testing.assert_allclose(first, [[0.1, 0.18, 0.3]])
    np.testing.assert_allclose(second, [[0.1, 0.22, 0.3]])


def test_no_candidates_give_no_grasps(ball):
    assert len(filter_grasps(ball, np.zeros((0, 4, 4)), [], GRIPPER)) == 0


def test_mismatched_and_broken_candidates_are_refused(ball):
    with pytest.raises(GraspError, match="widths"):
        filter_grasps(ball, grasp()[None], [0.06, 0.06], GRIPPER)
    with pytest.raises(GraspError, match="NaN"):
        filter_grasps(ball, grasp()[None], [np.nan], GRIPPER)


def test_gripper_points_lie_on_the_outside_of_the_hand():
    points = GRIPPER.surface_points(GRIPPER.max_opening)
    half = GRIPPER.max_opening / 2
    at_fingers = points[points[:, 2] > GRIPPER.heel]
    assert (np.abs(at_fingers[:, 0]) > half).all(), "nothing between the pads"
    assert np.isclose(points[:, 2].max(), GRIPPER.tip)
    assert np.isclose(np.abs(points[:, 0]).max(), half + GRIPPER.finger_thickness)
    assert points[:, 2].min() >= -GRIPPER.tool_offset
    closed = GRIPPER.surface_points(0.0)
    assert np.isclose(np.abs(closed[closed[:, 2] > GRIPPER.heel, 0]).max(), 0.015)


@pytest.mark.parametrize(
    "wrong",
    [
        {"max_opening": 0.0},
        {"max_opening": 85.0},
        {"finger_width": float("nan")},
        {"palm_size": (0.08, 0.08)},
        {"heel": 0.05},
        {"camera_center": (0.0, np.inf, 0.0)},
        {"tool_offset": 0.05},
    ],
    ids=str,
)
def test_impossible_hands_are_refused_by_name(wrong):
    with pytest.raises(GraspError, match=next(iter(wrong))):
        ParallelGripper(**wrong)


def test_a_hand_cannot_open_further_than_it_can():
    with pytest.raises(GraspError, match="max_opening"):
        GRIPPER.surface_points(0.2)
