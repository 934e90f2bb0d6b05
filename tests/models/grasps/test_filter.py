"""The post-filter on a ball and a box, where right and wrong grasps are known by construction."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.errors import GraspError, PointCloudError
from feasigrasp.models.grasps import filter
from feasigrasp.models.grasps.filter import (
    _holding,
    contact_state,
    filter_grasps,
)
from feasigrasp.models.grasps.grasp_set import GraspSet, contacts
from feasigrasp.models.grasps.hand_clearance import FAR, hand_clearance
from feasigrasp.models.grasps.success_probability import (
    CLEARANCE,
    CONTACT,
    clearance_evidence,
    contact_evidence,
    probability,
)
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import fit_gpdf

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
    assert 0.8 < kept.score[0] <= 1.0
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


def test_limits_are_relaxed_only_while_too_few_pass(ball, monkeypatch):
    tilts = [0.0, 0.006, 0.012]  # chords off the centre: normals 0, 12 and 24 degrees off the line
    X_OG = [grasp(at=(0, y, 0)) for y in tilts]
    width = [2 * np.sqrt(0.03**2 - y**2) for y in tilts]
    _, cosine = contact_state(ball, GraspSet(np.array(X_OG), np.array(width), np.zeros(3)))
    expected = [-np.cos(2 * np.arcsin(y / 0.03)) for y in tilts]
    np.testing.assert_allclose(cosine, expected, atol=0.03)
    monkeypatch.setattr(filter, "COSINE_STEPS", (-0.95, -0.85, -0.6))
    for enough, left in ((1, 1), (2, 2), (3, 3)):
        monkeypatch.setattr(filter, "ENOUGH", enough)
        kept = filter_grasps(ball, X_OG, width, GRIPPER)
        assert len(kept) == left
        assert kept.rejected.get("not antipodal", 0) == 3 - left


def test_ids_are_the_numbers_of_the_candidates(ball):
    X_OG, _ = REASONS["off the surface"]
    kept = filter_grasps(ball, [X_OG, grasp(), grasp(z=(0, 1, 0))], [0.045, 0.06, 0.06], GRIPPER)
    assert sorted(kept.id) == [1, 2]
    for i, X in zip(kept.id, kept.X_OG, strict=True):
        np.testing.assert_array_equal(X, [None, grasp(), grasp(z=(0, 1, 0))][i])


def test_a_prior_is_weighed_with_the_field(ball):
    X_OG, width = [grasp(), grasp(), grasp(at=(0, 0.01, 0))], [0.06, 0.06, 0.0566]
    given = filter_grasps(ball, X_OG, width, GRIPPER, prior=[[0.3, 0.9], [0.9, 0.9], [0.9, 0.9]])
    likely = dict(zip(given.id, given.score, strict=True))
    assert likely[1] > likely[0], "what the network says counts"
    assert likely[1] > likely[2], "what the field says counts"
    assert all(0.0 < score < 1.0 for score in likely.values())
    with pytest.raises(GraspError, match="prior has shape"):
        filter_grasps(ball, X_OG, width, GRIPPER, prior=[0.5])


def test_what_was_not_seen_is_given_more_room(sphere_cloud):
    """The same ball, seen from one side only: the hand may not come as close behind it."""
    cloud = sphere_cloud(radius=0.03)
    half = fit_gpdf(cloud[cloud[:, 2] > -0.005])
    for z, seen in (((0, 0, -1), True), ((0, 0, 1), False)):  # the palm comes from +z, from -z
        X_OG = grasp(z=z)[None]
        clearance, deviation = hand_clearance(half, X_OG, ParallelGripper(heel=-0.034))
        assert (deviation[0] < 0.004) == seen
        assert (deviation[0] > 0.006) != seen
        assert clearance[0] < FAR
    grasps = GraspSet(
        np.stack([grasp(z=(0, 0, -1)), grasp((0, 1, 0), at=(0, 0, -0.02))]), [0.06, 0.045], [1, 1]
    )
    reliable, unsure = probability(CONTACT, *contact_evidence(half, grasps))
    assert reliable > unsure


def test_certainty_falls_with_angle_and_with_less_room():
    clearance = np.array([0.0, 0.003, 0.006, 0.012])
    certain = probability(CLEARANCE, clearance_evidence(clearance, np.zeros(4)))
    assert (np.diff(certain) > 0).all() and (certain > 0).all() and (certain < 1).all()
    less = probability(CLEARANCE, clearance_evidence(clearance, np.full(4, 0.005)))
    assert (less[1:] < certain[1:]).all()


def test_angle_makes_contacts_uncertain(ball):
    heights = [0.0, 0.006, 0.012, 0.018]
    X_OG = np.array([grasp(at=(0, y, 0)) for y in heights])
    width = [2 * np.sqrt(0.03**2 - y**2) for y in heights]
    certain = probability(CONTACT, *contact_evidence(ball, GraspSet(X_OG, width, np.ones(4))))
    assert (np.diff(certain) < 0).all()


TABLE = np.array([0.0, 0.0, 1.0, 0.03])


def test_a_table_stops_the_hand(ball):
    """Under a ball that lies on a table there is no room for fingers or palm."""
    from_above, from_below, sideways = (grasp(z=z) for z in ((0, 0, -1), (0, 0, 1), (0, 1, 0)))
    X_OG, width = [from_above, from_below, sideways], [0.06] * 3
    free = filter_grasps(ball, X_OG, width, GRIPPER)
    assert len(free) == 3
    kept = filter_grasps(replace(ball, table=TABLE), X_OG, width, GRIPPER)
    assert list(kept.id) == [0]
    assert kept.rejected == {"hits the table": 2}
    for wrong in ([0, 0, 2.0, 0], [0, 0, 1]):
        with pytest.raises(PointCloudError, match="table"):
            replace(ball, table=wrong)


def test_a_table_turns_the_hand_to_its_other_side(ball):
    """Of a hand that comes sideways the camera has to be on top."""
    hand = ParallelGripper(palm_size=(0.04, 0.04, 0.065), finger_width=0.02)
    up, down = grasp((1, 0, 0), (0, 1, 0)), grasp((-1, 0, 0), (0, 1, 0))
    assert down[2, 1] == -up[2, 1]
    standing = replace(ball, table=np.array([0.0, 0.0, 1.0, 0.05]))
    for given in (up, down):
        kept = filter_grasps(standing, given[None], [0.06], hand)
        camera = kept.X_OG[0] @ [*hand.camera_center, 1.0]
        assert camera[2] > 0.05


def test_contacts_are_a_width_apart_along_x():
    X_OG = np.array([grasp((0, 1, 0), (1, 0, 0), (0.1, 0.2, 0.3))])
    first, second = contacts(GraspSet(X_OG, np.array([0.04]), np.zeros(1)))
    np.testing.assert_allclose(first, [[0.1, 0.18, 0.3]])
    np.testing.assert_allclose(second, [[0.1, 0.22, 0.3]])


def test_no_candidates_give_no_grasps(ball):
    assert len(filter_grasps(ball, np.zeros((0, 4, 4)), [], GRIPPER)) == 0


def test_mismatched_and_broken_candidates_are_refused(ball):
    with pytest.raises(GraspError, match="width has shape"):
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


class Tube:
    """A field that is exact: a tube round z, 3 cm in radius outside, with a wall."""

    def __init__(self, wall):
        self.wall = wall

    def distance(self, x):
        r = np.hypot(x[:, 0], x[:, 1])
        return np.maximum(r - 0.03, 0.03 - self.wall - r)


@pytest.mark.parametrize(("wall", "holds"), [(0.03, True), (0.003, True), (0.001, False)])
def test_of_a_cup_there_are_the_walls_alone_between_the_pads(wall, holds):
    """Walls of 3 mm are found behind the contacts, thinner ones not: those the network judges."""
    across = GraspSet(np.eye(4)[None], np.array([0.06]), np.ones(1))
    assert _holding(Tube(wall), across).item() is holds
