"""Pushed, touched, slipped, turned and held, from poses made by hand."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.runs.metrics.handling import (
    HELD_ANGLE,
    HELD_DISTANCE,
    HELD_FOR,
    ON_PATH_AFTER,
    closing_speed,
    contact_metrics,
    displacement_metrics,
    hold_metrics,
)

PERIOD = 0.02
#: A path on which the object turns, too.
T = np.arange(200) * PERIOD
PATH = se3.make_pose(se3.so3_exp(T[:, None] * [0.1, 0.2, -0.3]), T[:, None] * [0.1, -0.05, 0.0])


def path(n):
    return PATH[:n].copy()


def pushed_metrics(X_WO, X_WP, approach):
    """Of an approach; the fingers never close."""
    found = displacement_metrics(X_WO, X_WP, approach, np.zeros(len(X_WO), bool), PERIOD)
    assert (found.pop("displaced_mm"), found.pop("turned_deg")) == (None, None)
    return found


def displaced_metrics(X_WO, X_WP, closing):
    """Of closing fingers, without an approach."""
    found = displacement_metrics(X_WO, X_WP, np.zeros(len(X_WO), bool), closing, PERIOD)
    assert (found.pop("pushed_mm"), found.pop("pushed_deg")) == (None, None)
    return found


def test_an_object_on_its_path_is_not_pushed():
    pushed = pushed_metrics(path(50), path(50), np.full(50, True))
    assert pushed["pushed_mm"] == 0.0
    assert pushed["pushed_deg"] == pytest.approx(0.0, abs=1e-5)


def test_pushed_is_the_largest_distance_and_angle_of_the_approach():
    X, approach = path(100), np.arange(100) < 60
    X[30, :3, 3] += [0.003, 0.0, 0.004]
    X[40, :3, :3] = se3.so3_exp([0.0, 0.0, np.deg2rad(20.0)]) @ X[40, :3, :3]
    X[80:, :3, 3] += 0.5  # in the hand: that is no push
    pushed = pushed_metrics(X, path(100), approach)
    assert pushed["pushed_mm"] == pytest.approx(5.0)
    assert pushed["pushed_deg"] == pytest.approx(20.0)


def test_the_way_onto_the_path_is_no_push():
    start = round(ON_PATH_AFTER / PERIOD)
    X = path(50)
    X[:start, :3, 3] += 0.001
    assert pushed_metrics(X, path(50), np.full(50, True))["pushed_mm"] == 0.0
    X[start, :3, 3] += 0.001
    assert pushed_metrics(X, path(50), np.full(50, True))["pushed_mm"] > 1.0


def test_without_an_approach_there_is_no_push():
    expected = {"pushed_mm": None, "pushed_deg": None}
    assert pushed_metrics(path(50), path(50), np.full(50, False)) == expected
    few = round(ON_PATH_AFTER / PERIOD)
    assert pushed_metrics(path(few), path(few), np.full(few, True)) == expected


def test_displaced_is_the_largest_distance_and_angle_while_the_fingers_close():
    X, closing = path(100), (np.arange(100) >= 40) & (np.arange(100) < 60)
    X[:40, :3, 3] += 0.1  # before
    X[50, :3, 3] += [0.0, 0.003, 0.004]
    X[55, :3, :3] = se3.so3_exp([0.0, np.deg2rad(9.0), 0.0]) @ X[55, :3, :3]
    X[60:, :3, 3] += 0.5  # in the hand
    found = displaced_metrics(X, path(100), closing)
    assert found == pytest.approx({"displaced_mm": 5.0, "turned_deg": 9.0})
    never = displaced_metrics(X, path(100), np.full(100, False))
    assert never == {"displaced_mm": None, "turned_deg": None}


@pytest.mark.parametrize(
    ("contact", "peak", "impulse", "share"),
    [
        ([2.0, 0.5, 12.0, 3.0], 12.0, 3.0, 25.0),
        ([2.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0),
        ([0.0, 0.0, 0.0, 0.0], 0.0, 0.0, None),
    ],
)
def test_contact_is_told_as_force_impulse_and_share_of_time(contact, peak, impulse, share):
    assert contact_metrics(np.array(contact)) == {
        "contact_force_peak_n": peak,
        "contact_impulse_n_s": impulse,
        "contact_time_percent": share,
    }


# ------------------------------------------------------------------------------------- in the hand

#: Approach, closing, lift, shake, hold [samples]; the hold lasts as long as the rule looks back.
N = {Phase.APPROACH: 50, Phase.CLOSE: 50, Phase.LIFT: 75, Phase.SHAKE: 75, Phase.HOLD: 100}
PHASE = np.concatenate([np.full(n, float(phase)) for phase, n in N.items()] + [[Phase.DONE]])
RELEASED = 100
X_HO = se3.make_pose(se3.so3_exp([0.3, -0.2, 1.0]), [0.01, 0.02, -0.03])


def in_hand(*changes):
    """Poses in the hand; each change is (first sample, end, turn [rad vector], move [m])."""
    X = np.tile(X_HO, (len(PHASE), 1, 1))
    X[:RELEASED, :3, 3] += np.linspace(0.5, 0.0, RELEASED)[:, None]  # the way to the object
    for first, end, turn, move in changes:
        X[first:end, :3, :3] = X_HO[:3, :3] @ se3.so3_exp(turn)
        X[first:end, :3, 3] = X_HO[:3, 3] + move
    return X


def test_the_closing_speed_is_that_of_the_path_at_the_last_closing():
    """Along a line of amplitude 0.2 m at 3 rad/s, closed twice; the first time it missed."""
    t = np.arange(100) * PERIOD
    path = np.tile(np.eye(4), (100, 1, 1))
    path[:, 1, 3] = 0.2 * np.sin(3.0 * t)
    phase = np.full(100, Phase.APPROACH)
    assert closing_speed(path, phase, PERIOD) is None
    phase[20:30], phase[40:60], phase[60:] = Phase.CLOSE, Phase.CLOSE, Phase.LIFT
    speed = closing_speed(path, phase, PERIOD)
    assert speed == pytest.approx(0.6 * abs(np.cos(3.0 * t[40])), abs=2e-3)


def held(X, phase=PHASE):
    return hold_metrics(X, np.zeros((len(X), 3)), phase, PERIOD)


END = len(PHASE)
LAST = END - 1 - round(HELD_FOR / PERIOD)
ZERO = np.zeros(3)
ALONG, ABOUT = np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.6, -0.8])


def test_an_object_that_stays_is_held():
    told = held(in_hand())
    assert told["grasp_held"] is True
    assert told["held_after_s"] == pytest.approx(RELEASED * PERIOD)
    assert told["slip_mm"] == pytest.approx(0.0, abs=1e-9)
    assert told["turn_deg"] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("factor", [0.99, 1.01])
@pytest.mark.parametrize("first", [LAST, END - 1, RELEASED + 1])
def test_the_bounds_are_a_centimetre_and_fifteen_degrees(factor, first):
    moved = held(in_hand((first, END, ZERO, factor * HELD_DISTANCE * ALONG)))
    assert moved["slip_mm"] == pytest.approx(10.0 * factor)
    assert moved["turn_deg"] == pytest.approx(0.0, abs=1e-5)
    turned = held(in_hand((first, END, factor * HELD_ANGLE * ABOUT, ZERO)))
    assert turned["turn_deg"] == pytest.approx(15.0 * factor)
    assert turned["slip_mm"] == pytest.approx(0.0, abs=1e-9)
    assert moved["grasp_held"] is turned["grasp_held"] is (factor < 1.0)


def test_what_comes_back_before_the_last_seconds_is_held_and_told():
    told = held(in_hand((RELEASED + 10, LAST, 0.5 * ABOUT, 0.03 * ALONG)))
    assert told["grasp_held"] is True
    assert told["slip_mm"] == pytest.approx(30.0)
    assert told["turn_deg"] == pytest.approx(np.rad2deg(0.5))
    one_late = held(in_hand((RELEASED + 10, LAST + 1, 0.5 * ABOUT, 0.03 * ALONG)))
    assert one_late["grasp_held"] is False


def test_the_place_is_that_when_it_was_let_go():
    """Squeezing moves the object; that is no slip."""
    told = held(in_hand((0, RELEASED, 0.4 * ABOUT, 0.02 * ALONG)))
    assert told["grasp_held"] is True and told["slip_mm"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("last", [Phase.CLOSE, Phase.LIFT, Phase.SHAKE, Phase.HOLD])
def test_a_sequence_that_did_not_end_holds_nothing(last):
    n = int(np.argmax(last < PHASE))
    told = held(in_hand()[:n], PHASE[:n])
    assert told["grasp_held"] is False
    assert (told["slip_mm"] is None) == (last == Phase.CLOSE) == (told["lift_cm"] is None)


@pytest.mark.parametrize(("rise", "holds"), [(0.049, False), (0.051, True)])
def test_an_object_that_is_not_lifted_is_not_held(rise, holds):
    p_WO = np.zeros((END, 3))
    p_WO[:, 2] = np.interp(np.arange(END), [RELEASED, END - 1], [0.5, 0.5 + rise])
    assert hold_metrics(in_hand(), p_WO, PHASE, PERIOD, 0.1)["grasp_held"] is holds
    assert hold_metrics(in_hand(), p_WO, PHASE, PERIOD, 0.0)["grasp_held"] is True


def test_lift_is_the_rise_since_the_object_was_let_go():
    p_WO = np.zeros((END, 3))
    p_WO[:, 2] = np.interp(np.arange(END), [0, RELEASED, END - 1], [0.2, 0.5, 0.59])
    assert hold_metrics(in_hand(), p_WO, PHASE, PERIOD)["lift_cm"] == pytest.approx(9.0)
