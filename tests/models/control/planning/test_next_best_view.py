"""When a hand gives a grasp up, and from which side it looks at the object then."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.control.planning.next_best_view import (
    Attempt,
    next_best_view,
    view_configuration,
)
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf_fit import fit_gpdf

REACH = Reachability()
X_HC = se3.make_pose(se3.so3_exp([np.deg2rad(15.0), 0.0, 0.0]), [0.0, 0.085, -0.105])
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
X_WO = se3.make_pose(se3.so3_exp([0.2, -0.4, 1.0]), [0.45, 0.05, 0.55])
PERIOD, PATIENCE = 0.1, 3.0
NONE = GraspSet.empty()


def camera(q):
    return forward_kinematics(q, REACH.gripper.X_FG) @ X_HC


def half_ball(direction):
    """The field of a ball of 4 cm that was seen from a direction in O."""
    points = sphere_points(400, 0.04)
    return fit_gpdf(points[points @ direction > 0.0])


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


@pytest.mark.parametrize("seen_from", [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.6, 0.8]])
def test_it_looks_at_the_side_that_was_not_seen(seen_from):
    seen_from = np.array(seen_from)
    gpdf, X_WC = half_ball(seen_from), camera(HOME)
    side, travel = next_best_view(seen_from[None], gpdf, X_WO, HOME, X_WC, REACH)
    assert np.linalg.norm(side) == pytest.approx(1.0) and 0.0 < travel < 4.0
    unobserved = sphere_points(400, 1.0)
    unobserved = unobserved[unobserved @ seen_from < -0.1]
    # Of the hidden half it sees more than a camera on the seen side would.
    assert np.mean(unobserved @ side > 0.3) > np.mean(unobserved @ seen_from > 0.3) + 0.1
    assert side @ seen_from < 0.7


def test_sides_that_were_looked_from_are_not_taken_again_until_none_is_left():
    gpdf, sides = half_ball(np.array([1.0, 0.0, 0.0])), np.zeros((0, 3))
    for _ in range(60):
        side, _ = next_best_view(sides, gpdf, X_WO, HOME, camera(HOME), REACH)
        if side is None:
            break
        assert (sides @ side < 0.86).all()
        sides = np.vstack([sides, side])
    assert side is None and len(sides) > 4


def test_the_camera_has_the_object_in_the_middle_of_its_image_there():
    gpdf = half_ball(np.array([1.0, 0.0, 0.0]))
    side, travel = next_best_view(np.zeros((0, 3)), gpdf, X_WO, HOME, camera(HOME), REACH)
    q = view_configuration(side, gpdf, X_WO, HOME, camera(HOME), REACH)
    assert REACH.admissible(q[None])[0]
    middle = X_WO @ [*gpdf.bounds.mean(axis=0), 1.0]
    x, y, z, _ = se3.inverse(camera(q)) @ middle
    assert abs(x) < 1e-6 and abs(y) < 1e-6 and 0.3 < z < 0.5
    away = X_WO[:3, :3].T @ (camera(q)[:3, 3] - middle[:3])
    np.testing.assert_allclose(away / np.linalg.norm(away), side, atol=1e-6)
    assert travel == pytest.approx(REACH.nearest((camera(q) @ se3.inverse(X_HC))[None], HOME)[1][0])


def test_nothing_is_found_for_an_object_out_of_reach():
    far = se3.make_pose(np.eye(3), [3.0, 0.0, 0.5])
    gpdf = half_ball(np.array([1.0, 0.0, 0.0]))
    side, travel = next_best_view(np.zeros((0, 3)), gpdf, far, HOME, camera(HOME), REACH)
    assert side is None and np.isinf(travel)
    looks = view_configuration(np.array([0.0, 0.0, 1.0]), gpdf, far, HOME, camera(HOME), REACH)
    assert looks is None


def test_the_nearest_grasp_is_given_up_when_the_hand_comes_no_nearer():
    offered = grasps(0.0, 0.1, -0.3)
    assert not after(PATIENCE - PERIOD, Attempt(), offered).blocked
    attempt = after(PATIENCE, Attempt(), offered)
    assert attempt.blocked
    np.testing.assert_allclose(attempt.usable(offered).X_OG[:, 0, 3], [0.0, -0.3])
    # Whoever has no grasp left has to look elsewhere, and whoever has given one up tries it again.
    assert len(attempt.usable(grasps(0.11))) == 0
    later = after(20.0, replace(attempt, blocked=False), grasps(-0.3), x=-0.3, start=4.0)
    assert len(later.usable(offered)) == 3


def test_a_hand_that_gets_on_gives_nothing_up():
    coming = after(8.0, Attempt(), grasps(0.0), x=lambda t: 0.5 * np.exp(-0.2 * t))
    assert not coming.blocked and len(coming.given_up) == 0


def test_a_hand_that_comes_to_a_grasp_now_and_then_without_closing_gives_it_up():
    attempt = after(PATIENCE + 0.4, Attempt(), grasps(0.0), x=lambda t: 0.003 + 0.02 * (t % 0.4))
    assert attempt.blocked and len(attempt.given_up) >= 1


def test_without_a_grasp_in_reach_it_waits_a_moment_and_then_looks_elsewhere():
    assert not after(0.9, Attempt(), NONE).blocked
    attempt = after(1.2, Attempt(), NONE)
    assert attempt.blocked and len(attempt.given_up) == 0
    side = np.array([0.0, 0.0, 1.0])
    looking = attempt.looking(1.2, side, 0.5)
    assert after(1.0, looking, NONE, start=1.3).side is not None
    # It ends when something has come into reach, or after the time that it takes.
    assert after(0.1, looking, grasps(0.0), start=1.3).side is None
    done = after(3.0, looking, NONE, start=1.3)
    assert done.side is None and done.blocked
    np.testing.assert_allclose(done.sides, [side])


def test_without_another_side_the_hand_tries_what_is_left():
    attempt = after(PATIENCE, Attempt(), grasps(0.0, 0.1)).looking(3.1, None, np.inf)
    assert attempt.side is None and not attempt.blocked
    assert len(attempt.usable(grasps(0.0, 0.1))) == 1


def test_grasps_that_come_and_go_do_not_make_the_hand_get_on():
    attempt = Attempt()
    for k in range(29):
        attempt = attempt.advanced(
            0.1 * k, hand(0.2), NONE if k % 5 == 4 else grasps(0.0), PATIENCE
        )
    assert not attempt.blocked
    attempt = attempt.advanced(3.0, hand(0.2), grasps(0.0), PATIENCE)
    assert attempt.blocked and len(attempt.given_up) == 1


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
        if attempt.blocked:
            attempt = attempt.looking(float(t), None, np.inf)
    first, both = accepted.index(1) * PERIOD, accepted.index(2) * PERIOD
    assert first == pytest.approx(2.0 * np.log(1.0 / 0.5), abs=0.11)
    assert both == pytest.approx(2.0 * np.log(1.0 / 0.2), abs=0.11)


def test_what_was_enough_for_want_of_better_is_not_when_there_is_better():
    unsure = replace(grasps(0.0, 0.1), payload_score=np.array([0.5, 0.2]))
    attempt = replace(Attempt(), wanting=20.0)
    # An object out of sight for a while changes nothing; with a sure one it wants more again.
    reliable = unsure.joined(replace(grasps(-0.3), payload_score=np.array([1.2])))
    attempt = attempt.interrupted(25.0)
    assert len(attempt.usable(reliable)) == 3
    for t in np.arange(25.0, 46.0, PERIOD):
        attempt = attempt.advanced(float(t), hand(0.2), reliable, np.inf)
    assert attempt.usable(reliable).payload_score.tolist() == [1.2]
    assert attempt.usable(reliable).rejected == {"too heavy there": 2}
