"""From where the arm looks for an object that is out of sight."""

import numpy as np
import pytest

from feasigrasp.models.control.planning.search_pose import (
    SearchTarget,
    search_configuration,
    search_velocity,
)
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

REACH = Reachability()
X_HC = se3.make_pose(se3.so3_exp([np.deg2rad(25.0), 0.0, 0.0]), [0.0, 0.085, -0.105])
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
#: Where objects move in the scenarios, and a configuration near each that looks past it.
PLACES = [np.array([0.5, y, z]) for y in (-0.2, 0.0, 0.2) for z in (0.5, 0.6)]


def search_target(p_W, age=0.5):
    return SearchTarget(se3.make_pose(np.eye(3), p_W), age)


def camera(q):
    return forward_kinematics(q, REACH.gripper.X_FG) @ X_HC


@pytest.mark.parametrize("p_W", PLACES)
@pytest.mark.parametrize("turn", [0.0, 0.6, -0.9])
def test_the_camera_sees_the_place_from_some_way_off(p_W, turn):
    q = HOME + turn * np.array([0.3, 0.2, 0.5, 0.3, 1.0, -0.5, 1.0])
    found = search_configuration(search_target(p_W), q, camera(q), REACH)
    assert REACH.admissible(found[None])[0]
    X_WC = camera(found)
    x, y, z, _ = se3.inverse(X_WC) @ [*p_W, 1.0]
    assert 0.3 < z < 0.5 and np.hypot(x, y) < np.tan(np.deg2rad(4.0)) * z


def test_the_view_goes_round_the_place_in_circles_that_widen():
    p_W, aside = PLACES[2], []
    for age in np.arange(0.25, 5.0, 0.25):
        z = camera(search_configuration(search_target(p_W, age), HOME, camera(HOME), REACH))[:3]
        to = p_W - z[:, 3]
        off = z[:, 2] - (z[:, 2] @ to) * to / (to @ to)
        aside.append((np.linalg.norm(off), *off))
    angle = np.arcsin(np.array(aside)[:, 0])
    assert angle[:2].max() < 1e-6  # at first straight there
    assert angle[-1] > 0.2 and angle.max() < 0.36
    directions = np.array(aside)[10:, 1:]
    assert (directions[:-8] * directions[8:]).sum(axis=1).min() < 0.0  # to either side


def test_after_a_while_it_is_looked_for_from_home_wherever_it_is_expected():
    for p_W in (PLACES[0], [3.0, 0.0, 0.5]):
        q = HOME + 0.3
        found = search_configuration(search_target(p_W, 5.5), q, camera(q), REACH)
        np.testing.assert_array_equal(found, IIWA_7.home)


def test_a_home_that_is_not_admissible_is_not_gone_to(monkeypatch):
    monkeypatch.setattr(Reachability, "admissible", lambda *_: np.array([False]))
    p_W = PLACES[2]
    for age in (5.5, 60.0):
        z = camera(search_configuration(search_target(p_W, age), HOME, camera(HOME), REACH))[:3]
        to = (p_W - z[:, 3]) / np.linalg.norm(p_W - z[:, 3])
        assert z[:, 2] @ to > np.cos(0.3)  # the circles end to widen


def test_a_place_that_neither_the_camera_s_side_nor_the_base_s_shows_is_seen_from_another():
    """From here no camera at 0.38 m on either of these sides is in the arm's reach."""
    p_W = np.array([0.566, -0.078, 0.582])
    q = np.array([0.435, 0.591, -0.696, -0.837, -0.706, 1.853, -0.483])
    for age in (0.3, 2.0, 3.5, 5.0):
        found = search_configuration(search_target(p_W, age), q, camera(q), REACH)
        assert REACH.admissible(found[None])[0]
        x, y, z, _ = se3.inverse(camera(found)) @ [*p_W, 1.0]
        assert 0.25 < z < 0.5 and np.hypot(x, y) < np.tan(np.deg2rad(24.0)) * z


def test_nothing_is_found_for_a_place_out_of_reach():
    assert search_configuration(search_target([3.0, 0.0, 0.5]), HOME, camera(HOME), REACH) is None


def test_the_way_there_is_inside_the_speed_limits_and_ends_at_rest():
    q, there = HOME, HOME + np.array([1.0, -0.3, 0.2, 0.4, -1.0, 0.5, 2.0])
    assert np.all(np.abs(search_velocity(q, there)) <= 0.5 * IIWA_7.velocity_limits + 1e-9)
    for _ in range(3000):
        q = q + 0.005 * search_velocity(q, there)
    np.testing.assert_allclose(q, there, atol=1e-3)
    np.testing.assert_allclose(search_velocity(there, there), 0.0)
