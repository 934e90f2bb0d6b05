"""When a hand gives a grasp up."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.control.planning.stall import Attempt
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet

PERIOD, PATIENCE = 0.1, 3.0
NONE = GraspSet.empty()


def grasps(*x):
    """Grasps whose origins are at x along the object's x-axis."""
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    poses[:, 0, 3] = x
    return GraspSet(poses, np.full(len(x), 0.04), np.ones(len(x)))


def hand(x):
    return se3.make_pose(np.eye(3), [x, 0.0, 0.0])


def after(seconds, attempt, offered, x=0.2, start=0.0):
    """The attempt after so many seconds with the hand at x (a number, or a function of time)."""
    for t in np.arange(start, start + seconds + 1e-9, PERIOD):
        at = x(t) if callable(x) else x
        attempt = attempt.advanced(float(t), hand(at), offered, PATIENCE)
    return attempt


def test_the_nearest_grasp_is_given_up_when_the_hand_comes_no_nearer():
    offered = grasps(0.0, 0.1, -0.3)
    assert len(after(PATIENCE - PERIOD, Attempt(), offered).given_up) == 0
    attempt = after(PATIENCE, Attempt(), offered)
    np.testing.assert_allclose(attempt.usable(offered).X_OG[:, 0, 3], [0.0, -0.3])
    # Its neighbours are given up with it; after a while they are tried again.
    assert len(attempt.usable(grasps(0.11))) == 0
    later = after(20.0, attempt, grasps(-0.3), x=lambda t: 0.3 - 0.3 * np.exp(-0.1 * t), start=3.1)
    assert 0.1 in later.usable(offered).X_OG[:, 0, 3]


def test_a_gap_without_data_forgets_no_grasp_that_was_given_up():
    attempt = after(PATIENCE, Attempt(), grasps(0.0, 0.1, -0.3))
    gap = attempt.interrupted(PATIENCE + PERIOD)
    assert len(gap.usable(grasps(0.1))) == 0
    # The way until then does not count: the hand may have been led elsewhere.
    assert gap.left == np.inf and gap.relaxation == attempt.relaxation


def test_a_hand_that_gets_on_gives_nothing_up():
    coming = after(8.0, Attempt(), grasps(0.0), x=lambda t: 0.5 * np.exp(-0.2 * t))
    assert len(coming.given_up) == 0


def test_a_hand_that_comes_to_a_grasp_now_and_then_without_closing_gives_it_up():
    attempt = after(PATIENCE + 0.4, Attempt(), grasps(0.0), x=lambda t: 0.003 + 0.02 * (t % 0.4))
    assert len(attempt.given_up) >= 1


def test_time_without_a_grasp_in_reach_counts_for_nothing():
    attempt = after(0.5 * PATIENCE, Attempt(), grasps(0.0))
    attempt = after(20.0, attempt, NONE, start=0.5 * PATIENCE + PERIOD)
    start = 20.0 + 0.5 * PATIENCE + 2 * PERIOD
    assert len(after(0.4 * PATIENCE, attempt, grasps(0.0), start=start).given_up) == 0
    assert len(after(0.6 * PATIENCE, attempt, grasps(0.0), start=start).given_up) == 1


def test_grasps_that_come_and_go_do_not_make_the_hand_get_on():
    attempt = Attempt()
    for k in range(37):
        attempt = attempt.advanced(
            0.1 * k, hand(0.2), NONE if k % 5 == 4 else grasps(0.0), PATIENCE
        )
    assert len(attempt.given_up) == 0
    for k in range(37, 40):
        attempt = attempt.advanced(0.1 * k, hand(0.2), grasps(0.0), PATIENCE)
    assert len(attempt.given_up) == 1


@pytest.mark.parametrize(
    "what", [{"payload_score": np.array([0.5, 0.2])}, {"score": 0.5 * np.array([0.5, 0.2])}]
)
def test_the_longer_no_good_grasp_is_in_reach_the_less_is_asked_of_another_one(what):
    """How sure it is to carry, and how likely beside even odds."""
    unsure = replace(grasps(0.0, 0.1), **what)
    attempt, accepted = Attempt(), []
    for t in np.arange(0.0, 20.0, PERIOD):
        attempt = attempt.advanced(float(t), hand(0.2), unsure, np.inf)
        accepted.append(len(attempt.usable(unsure)))
    first, both = accepted.index(1) * PERIOD, accepted.index(2) * PERIOD
    assert first == pytest.approx(2.0 * np.log(1.0 / 0.5), abs=0.11)
    assert both == pytest.approx(2.0 * np.log(1.0 / 0.2), abs=0.11)


def test_what_was_enough_for_want_of_better_is_not_when_there_is_better():
    unsure = replace(grasps(0.0, 0.1), payload_score=np.array([0.5, 0.2]))
    attempt = replace(Attempt(), relaxation=20.0)
    # An object out of sight for a while changes nothing; with a sure one it wants more again.
    reliable = unsure.joined(replace(grasps(-0.3), payload_score=np.array([1.2])))
    attempt = attempt.interrupted(25.0)
    assert len(attempt.usable(reliable)) == 3
    for t in np.arange(25.0, 46.0, PERIOD):
        attempt = attempt.advanced(float(t), hand(0.2), reliable, np.inf)
    assert attempt.usable(reliable).payload_score.tolist() == [1.2]
    assert attempt.usable(reliable).rejected == {"too heavy there": 2}
