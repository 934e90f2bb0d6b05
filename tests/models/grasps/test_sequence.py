"""Phases of a grasp, stepped by hand, and the targets that belong to them."""

import copy
import dataclasses as dc

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import (
    CommittedMotion,
    GraspSequenceConfig,
    GraspState,
    Phase,
    unmet_condition,
)
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.pose_filter import Noise, empty_state, measure_kernel
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.systems.remote.served import packed, unpacked

CONFIG = GraspSequenceConfig()
WIDTH = 0.05
X_WO = se3.make_pose(se3.so3_exp([0.1, 0.2, 0.3]), [0.5, 0.1, 0.6])
V_WO = np.array([0.1, -0.2, 0.3, 0.02, 0.05, -0.01])
GRASPS = GraspSet(
    np.stack([se3.exp([0.0, 1.0, 0.0, 0.01, 0.0, 0.0]), se3.exp([0.0, -1.0, 0.5, 0.0, 0.02, 0.0])]),
    [WIDTH, WIDTH],
    [0.5, 0.9],
)
AT_GRASP = X_WO @ GRASPS.X_OG[1]
AWAY = AT_GRASP @ se3.exp([0, 0, 0, 0, 0, -0.2])


#: Fingers take so long to meet something, in these tests [s]; their rate until then [m/s].
REACHED, RATE = 0.3, -0.1
#: From then on, until the hand lifts [s].
SQUEEZED = CONFIG.squeeze_time + CONFIG.handover_time


def advanced(state, t, X_WH=AT_GRASP, *, grasps=GRASPS, opening=WIDTH, rate=0.0, config=CONFIG):
    return state.advanced(t, X_WH, X_WO, V_WO, grasps, [opening, rate], config)


def closing(t=0.0):
    state = GraspState()
    state = advanced(state, t)
    state = advanced(state, t + CONFIG.dwell)
    assert state.phase == Phase.CLOSE
    return state


def closed(state, X_WH=AT_GRASP, opening=WIDTH):
    """The state after fingers that meet something have pressed for as long as they should."""
    met = state.since + REACHED
    state = advanced(state, met, opening=opening)
    assert state.phase == Phase.CLOSE
    state = advanced(state, met + CONFIG.squeeze_time, X_WH, opening=opening)
    if state.released:  # the carrier is asked to let go, and the hand waits for it
        assert state.phase == Phase.CLOSE
        state = advanced(state, met + SQUEEZED, X_WH, opening=opening)
    return state


def lifting(t=0.0):
    return closed(closing(t))


def test_the_whole_sequence():
    state, phases = GraspState(), []
    met = 1.0 + CONFIG.dwell + REACHED
    for t in np.arange(0.0, 9.0, 0.01):
        X_WH, rate = AWAY if t < 1.0 else AT_GRASP, RATE if t < met - 1e-9 else 0.0
        state = advanced(state, t, X_WH, rate=rate)
        phases.append(state.phase)
    changes = {phase: 0.01 * phases.index(phase) for phase in Phase}
    expected = np.cumsum(
        [
            1.0,
            CONFIG.dwell,
            REACHED + SQUEEZED,
            CONFIG.lift_time,
            CONFIG.shake_time,
            CONFIG.hold_time,
        ]
    )
    got = [1.0 if phases[99] == Phase.APPROACH else np.nan]
    got += [changes[phase] for phase in list(Phase)[1:]]
    np.testing.assert_allclose(got, expected, atol=0.011)
    assert sorted(phases) == phases  # never back


def test_far_from_all_grasps_it_goes_on_approaching():
    state = GraspState()
    for t in np.arange(0.0, 2.0, 0.05):
        state = advanced(state, t, AWAY)
    assert state.phase == Phase.APPROACH and not state.released


def test_without_grasps_it_goes_on_approaching():
    near = advanced(GraspState(), 0.0)
    state = advanced(near, 1.0, grasps=GraspSet.empty())
    assert state.phase == Phase.APPROACH and np.isnan(state.near_since)


@pytest.mark.parametrize("part", ["pose", "twist"])
def test_an_object_that_is_nowhere_is_neither_grasped_nor_let_go(part):
    X, V = X_WO.copy(), V_WO.copy()
    (X if part == "pose" else V)[0] = np.nan
    waiting, start = advanced(GraspState(), 0.0), closing()
    after = waiting.advanced(10.0, AT_GRASP, X, V, GRASPS, WIDTH, CONFIG)
    assert after.phase == Phase.APPROACH and np.isnan(after.near_since)
    after = start.advanced(start.since + 10.0, AT_GRASP, X, V, GRASPS, WIDTH, CONFIG)
    assert after.phase == Phase.CLOSE and not after.released
    # Once it is let go, where it is does not matter.
    lift = lifting()
    after = lift.advanced(lift.since + CONFIG.lift_time, AT_GRASP, X, V, GRASPS, WIDTH, CONFIG)
    assert after.phase == Phase.SHAKE


def test_a_gripper_that_shall_not_close_never_does():
    config = GraspSequenceConfig(close=False)
    state = GraspState()
    for t in np.arange(0.0, 2.0, 0.05):
        state = advanced(state, t, config=config)
    assert state.phase == Phase.APPROACH


@pytest.mark.parametrize(
    ("error", "near"),
    [
        ([0, 0, 0, 0.9 * CONFIG.position_tolerance, 0, 0], True),
        ([0, 0, 0, 1.1 * CONFIG.position_tolerance, 0, 0], False),
        ([0, 0.9 * CONFIG.angle_tolerance, 0, 0, 0, 0], True),
        ([0, 1.1 * CONFIG.angle_tolerance, 0, 0, 0, 0], False),
    ],
)
def test_tolerances(error, near):
    X_WH = AT_GRASP @ se3.exp(np.array(error, dtype=float))
    state = advanced(advanced(GraspState(), 0.0, X_WH), 1.0, X_WH)
    assert (state.phase == Phase.CLOSE) == near


def test_the_hand_must_dwell():
    state = advanced(GraspState(), 0.0)
    assert advanced(state, 0.5 * CONFIG.dwell).phase == Phase.APPROACH
    assert advanced(state, CONFIG.dwell).phase == Phase.CLOSE
    # Leaving in between starts the wait anew.
    state = advanced(state, 0.5 * CONFIG.dwell, AWAY)
    state = advanced(state, 0.6 * CONFIG.dwell)
    assert advanced(state, 1.5 * CONFIG.dwell).phase == Phase.APPROACH
    assert advanced(state, 1.6 * CONFIG.dwell).phase == Phase.CLOSE


def test_it_commits_to_the_grasp_it_is_at():
    state = closing()
    assert len(state.grasp) == 1
    np.testing.assert_array_equal(state.grasp.X_OG[0], GRASPS.X_OG[1])
    np.testing.assert_array_equal(state.X_WO, X_WO)
    np.testing.assert_array_equal(state.V_WO, V_WO)
    assert not state.released


def test_fingers_that_close_on_nothing_go_back_to_the_approach():
    start, nothing = closing(), 0.5 * CONFIG.min_width
    missed = closed(start, opening=nothing)
    end = start.since + REACHED + CONFIG.squeeze_time
    assert missed.phase == Phase.APPROACH and missed.since == end
    assert missed.grasp is None and missed.X_WO is None and np.isnan(missed.near_since)
    # Too early to tell: the fingers are still on their way.
    early = advanced(start, start.since + REACHED, opening=nothing, rate=RATE)
    assert early.phase == Phase.CLOSE
    again = advanced(advanced(missed, end), end + CONFIG.dwell)
    assert again.phase == Phase.CLOSE


def test_fingers_that_have_not_set_off_do_not_press():
    start = closing()
    state = advanced(start, start.since + 0.1, opening=0.085)
    assert np.isnan(state.pressing_since)


def test_fingers_that_move_on_press_anew():
    """They pushed the object against the other finger."""
    start = closing()
    met = start.since + REACHED
    pushing = advanced(start, met)
    moved = advanced(pushing, met + 0.1, rate=RATE)
    assert (pushing.pressing_since, moved.pressing_since) == (met, met + 0.1)
    late = met + CONFIG.squeeze_time
    assert not advanced(moved, late).released
    assert advanced(moved, late + 0.1).released


def test_fingers_that_never_stop_have_closed_after_a_while():
    state = closing()
    for t in state.since + np.arange(0.0, CONFIG.closing_time - 0.01, 0.05):
        state = advanced(state, t, rate=RATE)
        assert state.phase == Phase.CLOSE
    assert advanced(state, state.since + CONFIG.closing_time, rate=RATE).released


def test_the_hand_goes_on_with_the_object_until_its_carrier_has_let_go():
    """And it lifts then, whatever is still known of the object."""
    start = closing()
    asked = advanced(advanced(start, start.since + REACHED), start.since + REACHED + 0.2)
    assert asked.released and asked.phase == Phase.CLOSE
    X, V = target_at(asked, REACHED + 0.3)
    np.testing.assert_allclose(X, start.target(start.since + REACHED + 0.3, X, V, CONFIG)[0])
    end = asked.let_go_since + CONFIG.handover_time
    assert advanced(asked, end - 0.01).phase == Phase.CLOSE
    nowhere = np.full((4, 4), np.nan)
    after = asked.advanced(end, AT_GRASP, nowhere, V_WO, GRASPS, [WIDTH, 0.0], CONFIG)
    assert after.phase == Phase.LIFT
    at_once = dc.replace(CONFIG, handover_time=0.0)
    pressed = advanced(start, start.since + REACHED)
    assert advanced(pressed, start.since + REACHED + 0.2, config=at_once).phase == Phase.LIFT


def test_the_lift_goes_on_from_where_the_hand_was_going():
    """Nothing jumps, whatever fingers and object have done to each other."""
    state = closing()
    end = state.since + REACHED + SQUEEZED
    X, V = state.target(end, np.eye(4), np.zeros(6), CONFIG)
    slipped = AT_GRASP @ se3.exp([0.0, 0.01, 0.0, 0.003, 0.0, 0.002])
    pushed = se3.make_pose(X_WO[:3, :3], X_WO[:3, 3] + [0.0, 0.05, 0.0])
    lifted = state
    for t in (state.since + REACHED, end - CONFIG.handover_time, end):
        lifted = lifted.advanced(t, slipped, pushed, V_WO + 0.5, GRASPS, [WIDTH, 0.0], CONFIG)
    assert lifted.phase == Phase.LIFT and lifted.released
    assert lifted.grasp is state.grasp
    X_lifted, V_lifted = target_at(lifted, 0.0)
    np.testing.assert_allclose(X_lifted, X, atol=1e-12)
    np.testing.assert_allclose(V_lifted, V, atol=1e-12)


def test_the_target_of_the_approach_is_the_object():
    X, V = GraspState().target(3.0, X_WO, V_WO, CONFIG)
    np.testing.assert_array_equal(X, X_WO)
    np.testing.assert_array_equal(V, V_WO)


def test_while_closing_the_target_moves_on_as_before():
    """Whatever the fingers do to the object in the meantime."""
    state = closing()
    pushed = se3.make_pose(np.eye(3), [0.7, 0.0, 0.4])
    for elapsed in (0.0, 0.3, CONFIG.closing_time):
        X, V = state.target(state.since + elapsed, pushed, np.zeros(6), CONFIG)
        np.testing.assert_allclose(X[:3, 3], X_WO[:3, 3] + elapsed * V_WO[3:])
        turn = se3.so3_exp(elapsed * V_WO[:3])
        np.testing.assert_allclose(X[:3, :3], turn @ X_WO[:3, :3], atol=1e-12)
        np.testing.assert_array_equal(V, V_WO)


def test_while_closing_the_target_turns_off_as_the_object_would():
    """A swing: without a prediction the hand would be 3 cm off when the fingers have squeezed."""
    swing = HarmonicMotion(
        center=np.array([0.5, 0.0, 0.6]),
        amplitude=np.array([0.0, 0.2, 0.08]),
        harmonic=np.array([1.0, 1.0, 2.0]),
        offset_deg=np.array([90.0, 0.0, 0.0]),
        rate=0.2 * np.pi,
        start_phase=0.0,
        spin_axis=np.array([0.0, 0.0, 1.0]),
        spin=0.2,
    )
    filtered, t = empty_state(), 0.0
    for t in np.arange(0.0, 5.0, 0.005):
        measure_kernel(filtered, t, swing.pose(t), Noise())
    here, V = swing.pose(t), swing.velocity(t)
    path = MotionEstimate(filtered, t).predict
    state = GraspState(Phase.CLOSE, t, X_WO=here, V_WO=V, path=path)
    for elapsed in (0.0, 0.5, CONFIG.closing_time):
        X, V = state.target(t + elapsed, here, np.zeros(6), CONFIG)
        truth = swing.pose(t + elapsed)
        assert np.linalg.norm(X[:3, 3] - truth[:3, 3]) < 0.004
        assert se3.rotation_angle(X[:3, :3].T @ truth[:3, :3]) < 0.01
        assert np.linalg.norm(V[3:] - swing.velocity(t + elapsed)[3:]) < 0.02
    motion = CommittedMotion(dc.replace(state, grasp=GRASPS.select([0])), t, CONFIG)
    X = motion.predict([0.2, 0.5])
    np.testing.assert_allclose(X, [swing.pose(t + s) for s in (0.2, 0.5)], atol=0.01)
    ahead = [0.2, CONFIG.closing_time + CONFIG.handover_time, 5.0]
    elsewhere = unpacked(packed(motion)).predict(ahead)  # in another process
    np.testing.assert_array_equal(elsewhere, motion.predict(ahead))
    np.testing.assert_allclose(elsewhere[2, :3, 3] - elsewhere[1, :3, 3], CONFIG.lift)
    blind = dc.replace(state, path=None).target(t + elapsed, here, np.zeros(6), CONFIG)[0]
    assert np.linalg.norm(blind[:3, 3] - truth[:3, 3]) > 0.025


def target_at(state, elapsed):
    return state.target(state.since + elapsed, np.eye(4), np.zeros(6), CONFIG)


def test_the_lift_is_smooth_and_as_long_as_configured():
    state, h = lifting(), 1e-6
    for elapsed in np.linspace(0.1, CONFIG.lift_time - 0.1, 15):
        V = target_at(state, elapsed)[1]
        ahead, behind = target_at(state, elapsed + h)[0], target_at(state, elapsed - h)[0]
        np.testing.assert_allclose(V[3:], (ahead - behind)[:3, 3] / (2 * h), atol=1e-7)
        turned = se3.so3_log(ahead[:3, :3] @ behind[:3, :3].T)
        np.testing.assert_allclose(V[:3], turned / (2 * h), atol=1e-7)
    X_start, V_start = target_at(state, 0.0)
    X_end, V_end = target_at(state, CONFIG.lift_time)
    np.testing.assert_allclose(X_end[:3, 3] - X_start[:3, 3], CONFIG.lift)
    np.testing.assert_allclose(X_end[:3, :3], X_start[:3, :3])
    np.testing.assert_allclose(V_start, V_WO)
    np.testing.assert_allclose(V_end, 0.0, atol=1e-12)
    np.testing.assert_allclose(target_at(state, 2 * CONFIG.lift_time)[0], X_end)


@pytest.mark.parametrize("speed", [0.0, 0.3, 0.6])
def test_a_quick_object_is_brought_to_rest_gently(speed):
    """It takes four times what stopping it evenly over the lift would, at most."""
    V = np.array([0.0, 0.0, 0.0, 0.0, speed, 0.0])
    state = dc.replace(lifting(), V_WO=V)
    times = np.linspace(0.0, CONFIG.lift_time, 301)
    v = np.array([target_at(state, t)[1][3:] for t in times])
    acceleration = np.linalg.norm(np.diff(v, axis=0), axis=1) / np.diff(times)
    lift = 6.0 * np.linalg.norm(CONFIG.lift) / CONFIG.lift_time**2
    assert acceleration.max() < 4.0 * speed / CONFIG.lift_time + lift
    way = np.array([target_at(state, t)[0][1, 3] for t in times])
    way -= way[0]
    assert way.max() <= 4.0 / 27.0 * speed * CONFIG.lift_time + 1e-9


def shaking():
    lift = lifting()
    state = advanced(lift, lift.since + CONFIG.lift_time)
    assert state.phase == Phase.SHAKE and state.released
    return state


def test_the_shake_goes_to_and_fro_as_far_and_as_often_as_configured():
    state, X_lifted = shaking(), target_at(lifting(), CONFIG.lift_time)[0]
    times = np.linspace(0.0, CONFIG.shake_time, 3001)
    X = np.array([target_at(state, t)[0] for t in times])
    np.testing.assert_array_equal(X[:, :3, :3], np.broadcast_to(X_lifted[:3, :3], (3001, 3, 3)))
    moved = X[:, :3, 3] - X_lifted[:3, 3]
    # Half of the time at full amplitude: there the sine reaches its crests.
    np.testing.assert_allclose(np.abs(moved).max(axis=0), CONFIG.shake, rtol=1e-3)
    crossings = np.flatnonzero(np.diff(moved[1:-1, 2] > 0.0))
    half = np.diff(times[1:-1][crossings])
    np.testing.assert_allclose(half, 0.5 / CONFIG.shake_frequency, atol=1e-3)


@pytest.mark.parametrize("frequency", [CONFIG.shake_frequency, 2.7])
def test_the_twist_of_the_shake_is_its_derivative_and_nothing_jumps(frequency):
    """Position, velocity and acceleration, from the lift before to the hold after."""
    config = dc.replace(CONFIG, shake_frequency=frequency)
    state, h = shaking(), 1e-5

    def at(elapsed):
        after = int(elapsed > 0.0) + int(elapsed > config.shake_time)
        phase = (Phase.LIFT, Phase.SHAKE, Phase.HOLD)[after]
        since = {Phase.LIFT: -config.lift_time, Phase.SHAKE: 0.0, Phase.HOLD: config.shake_time}
        there = dc.replace(state, phase=phase, since=since[phase])
        X, V = there.target(elapsed, np.eye(4), np.zeros(6), config)
        if phase == Phase.LIFT:  # what is left of the twist of closing
            np.testing.assert_allclose(V[:3], 0.0, atol=1e-5)
        else:
            np.testing.assert_array_equal(V[:3], 0.0)
        return X[:3, 3], V[3:]

    for elapsed in np.linspace(0.01, config.shake_time - 0.01, 101):
        slope = (at(elapsed + h)[0] - at(elapsed - h)[0]) / (2 * h)
        np.testing.assert_allclose(at(elapsed)[1], slope, atol=1e-6)
    for edge in (0.0, config.shake_time):
        before, after = at(edge - h), at(edge + h)
        np.testing.assert_allclose(before[0], after[0], atol=1e-6)
        np.testing.assert_allclose(before[1], after[1], atol=1e-4)
    for end in (h, config.shake_time - h):  # the shake itself begins and ends without a jerk
        acceleration = (at(end + h / 2)[1] - at(end - h / 2)[1]) / h
        np.testing.assert_allclose(acceleration, 0.0, atol=0.02)


def test_without_a_time_for_it_there_is_no_shake():
    config = dc.replace(CONFIG, shake_time=0.0)
    lift = lifting()
    assert advanced(lift, lift.since + CONFIG.lift_time, config=config).phase == Phase.HOLD


def test_after_the_shake_the_hand_stays():
    lift, shake = lifting(), shaking()
    hold = advanced(shake, shake.since + CONFIG.shake_time)
    done = advanced(hold, hold.since + CONFIG.hold_time)
    assert (hold.phase, done.phase) == (Phase.HOLD, Phase.DONE)
    X_end = target_at(lift, CONFIG.lift_time)[0]
    for state in (hold, done):
        X, V = target_at(state, 0.7)
        np.testing.assert_allclose(X, X_end)
        np.testing.assert_array_equal(V, 0.0)
        assert state.released
    assert advanced(done, 1e3) is done


def test_a_long_lift_does_not_take_a_quick_object_far():
    config = dc.replace(CONFIG, lift_time=30.0)
    V = np.array([0.0, 0.0, 0.0, 0.0, 0.6, 0.0])
    state = dc.replace(lifting(), V_WO=V)
    way = [state.target(state.since + t, X_WO, V, config)[0] for t in np.linspace(0.0, 30.0, 601)]
    way = np.array(way)[:, :3, 3]
    lift = np.linalg.norm(CONFIG.lift)
    assert np.linalg.norm(way - way[0], axis=1).max() < lift + 4.0 / 27.0 * 0.6 * CONFIG.lift_time


def test_targets_do_not_change_the_state():
    state = lifting()
    before, X = state.X_WO.copy(), target_at(state, CONFIG.lift_time)[0]
    X[:] = 0.0
    np.testing.assert_array_equal(state.X_WO, before)


def test_a_deep_copy_is_the_state_itself():
    state = closing()
    assert copy.deepcopy(state) is state


@pytest.mark.parametrize(
    ("back", "turn", "words"),
    [
        (0.05, 0.0, ["50 mm off", "closes at 6"]),
        (0.0, 0.2, ["11 deg off", "closes at 5"]),
        (0.02, 0.3, ["20 mm", "17 deg"]),
        (0.001, 0.01, ["at a grasp", "0.1 s"]),
    ],
)
def test_the_condition_that_keeps_fingers_from_closing_is_named(back, turn, words):
    X_OH = GRASPS.X_OG[1] @ se3.exp([0, 0, turn, 0, 0, -back])
    said = unmet_condition(X_OH, GRASPS, CONFIG)
    assert all(word in said for word in words), said
    # It names a condition exactly as long as the sequence does not begin to wait for the dwell.
    waits = np.isnan(advanced(GraspState(), 0.0, X_WO @ X_OH).near_since)
    assert waits == ("at a grasp" not in said)


def test_a_pose_that_is_not_measured_and_a_gripper_that_stays_open_are_named():
    assert "extrapolated" in unmet_condition(GRASPS.X_OG[0], GRASPS, CONFIG, measured=False)
    assert unmet_condition(np.eye(4), GRASPS, dc.replace(CONFIG, close=False)) == ""
