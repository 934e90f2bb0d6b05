"""The estimator follows, and predicts, motions whose truth is known in closed form."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.pose_filter import (
    Noise,
    empty_state,
    measure_kernel,
    pose_kernel,
    twist_kernel,
)
from feasigrasp.models.objects.prediction import MotionEstimate, future_poses

PERIOD = 0.005
HORIZON = np.array([0.5, 1.0, 2.0, 4.0])


def motion(amplitude=(0.0, 0.0, 0.0), harmonic=(1.0, 1.0, 1.0), rate=0.3, **options):
    return HarmonicMotion(
        center=np.array([0.1, -0.2, 0.3]),
        amplitude=np.array(amplitude),
        harmonic=np.array(harmonic),
        offset_deg=np.array(options.get("offset_deg", [90.0, 0.0, 0.0])),
        rate=rate,
        start_phase=0.7,
        spin_axis=np.array([1.0, 0.5, -0.3]),
        spin=options.get("spin", 0.3),
        R_WO=se3.so3_exp([0.3, -1.0, 2.0]),
    )


CIRCLE = motion((0.45, 0.45, 0.0))
LINE = motion((0.0, 0.45, 0.1))
QUICK = motion((0.15, 0.15, 0.0), rate=3.0)
SWING = motion((0.1, 0.35, 0.0), (10.0, 1.0, 1.0))


def follow(truth, duration, noise=Noise(), seed=0, lost=0.0):  # noqa: B008 - a constant
    """The estimate after some time, and the root mean square errors of pose and twist."""
    rng = np.random.default_rng(seed)
    state, errors = empty_state(), []
    for t in np.arange(0.0, duration, PERIOD):
        X, z = truth.pose(t).copy(), rng.standard_normal(6)
        X[:3, :3] = se3.so3_exp(noise.rotation * z[:3]) @ X[:3, :3]
        X[:3, 3] += noise.position * z[3:]
        if rng.random() >= lost:
            measure_kernel(state, t, X, noise)
        if t > 0.5 * duration:
            X, V = np.empty((4, 4)), np.empty(6)
            pose_kernel(state, t, X)
            twist_kernel(state, t, V)
            true, twist = truth.pose(t), truth.velocity(t)
            turn = se3.rotation_angle(X[:3, :3] @ true[:3, :3].T)
            errors.append([np.linalg.norm((X - true)[:3, 3]), turn, *np.abs(V - twist)])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    return MotionEstimate(state, float(t)), rms


def off(truth, estimate, ahead=HORIZON):
    """Position [m] and angle [rad] between predicted and true poses."""
    X = estimate.predict(ahead)
    true = np.array([truth.pose(estimate.time + s) for s in ahead])
    position = np.linalg.norm((X - true)[:, :3, 3], axis=1)
    return position, se3.rotation_angle(X[:, :3, :3] @ true[:, :3, :3].swapaxes(1, 2))


@pytest.mark.parametrize("truth", [CIRCLE, LINE, SWING])
def test_perfect_measurements_give_the_motion_itself(truth):
    _, rms = follow(truth, 2.0)
    assert rms[0] < 1e-6
    assert rms[1] < 1e-6
    assert np.all(rms[2:] < 1e-4)


@pytest.mark.parametrize("truth", [CIRCLE, LINE, SWING])
def test_noise_of_2_mm_and_1_degree_leaves_a_usable_twist(truth):
    _, rms = follow(truth, 6.0, Noise(0.002, np.deg2rad(1.0)))
    # A difference over 20 ms would be off by 140 mm/s and 1.2 rad/s per axis.
    assert np.all(rms[2:5] < 0.05)
    assert np.all(rms[5:] < 0.04)


@pytest.mark.parametrize("truth", [CIRCLE, LINE, SWING])
def test_the_future_is_predicted_along_the_curve(truth):
    estimate, _ = follow(truth, 8.0)
    position, angle = off(truth, estimate)
    assert np.all(position < 0.01)
    assert np.all(angle < 1e-3)
    straight = [
        np.linalg.norm(
            (se3.extrapolate(*truth.state(estimate.time)[:2], s) - truth.pose(estimate.time + s))[
                :3, 3
            ]
        )
        for s in HORIZON
    ]
    assert position[-1] < 0.1 * straight[-1]


def test_the_future_survives_noise_and_losses():
    position, angle = off(CIRCLE, follow(CIRCLE, 8.0, Noise(0.002, np.deg2rad(1.0)), lost=0.3)[0])
    assert np.all(position < [0.05, 0.08, 0.12, 0.2])
    assert np.all(angle < 0.15)


def test_a_still_object_stays_where_it_is():
    still = motion(spin=0.0, rate=0.0)
    position, angle = off(still, follow(still, 6.0)[0])
    assert position.max() < 1e-6
    assert angle.max() < 1e-6


def test_a_straight_motion_goes_on_straight():
    class Straight:
        def pose(self, t):
            return se3.make_pose(np.eye(3), np.array([0.1 * t, -0.2 * t, 0.5]))

        def velocity(self, t):
            return np.array([0.0, 0.0, 0.0, 0.1, -0.2, 0.0])

    truth = Straight()
    position, _ = off(truth, follow(truth, 8.0)[0])
    assert np.all(position < 0.01)


def test_turning_the_world_turns_the_prediction():
    turn = se3.make_pose(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [1, 2, 3])

    class Turned:
        def pose(self, t):
            return turn @ SWING.pose(t)

        def velocity(self, t):
            return np.zeros(6)

    here, there = follow(SWING, 6.0)[0], follow(Turned(), 6.0)[0]
    np.testing.assert_allclose(turn @ here.predict(HORIZON), there.predict(HORIZON), atol=1e-6)


def test_what_is_no_pose_is_ignored():
    estimate, _ = follow(CIRCLE, 1.0)
    state = estimate.state.copy()
    measure_kernel(state, 2.0, np.full((4, 4), np.nan), Noise())
    np.testing.assert_array_equal(state, estimate.state)
    measure_kernel(state, 0.5, np.eye(4), Noise())  # older than the last one
    np.testing.assert_array_equal(state, estimate.state)


FAR = se3.make_pose(np.eye(3), np.array([5.0, 0.0, 0.0]))
TURNED_OVER = se3.make_pose(se3.so3_exp([np.pi, 0.0, 0.0]), np.zeros(3))


@pytest.mark.parametrize("moved", [FAR, TURNED_OVER])
def test_a_jump_is_believed_when_it_lasts(moved):
    estimate, _ = follow(CIRCLE, 1.0)
    state, before = estimate.state.copy(), estimate.predict([0.0, 0.2])
    for t in np.arange(1.0, 1.095, PERIOD):
        measure_kernel(state, t, CIRCLE.pose(t) @ moved, Noise())
    at_once = MotionEstimate(state, estimate.time).predict([0.0, 0.2])
    np.testing.assert_allclose(at_once, before, atol=1e-4)
    for t in (1.1, 1.11):
        measure_kernel(state, t, CIRCLE.pose(t) @ moved, Noise())
    expected = CIRCLE.pose(t) @ moved
    np.testing.assert_allclose(MotionEstimate(state, t).predict([0.0])[0], expected, atol=1e-9)


def test_a_path_says_how_fast_the_object_is():
    """Noise of 2 mm: one of two seconds errs by a third of what the filter errs by, or less."""
    noise, errors = Noise(position=2e-3, jerk=3.0), []
    for seed in range(10):
        estimate, _ = follow(QUICK, 6.0, noise, seed)
        V, true = np.empty(6), QUICK.velocity(estimate.time)[3:]
        twist_kernel(estimate.state, estimate.time, V)
        errors.append([np.linalg.norm(v - true) for v in (V[3:], estimate.velocity(V[3:]))])
    filtered, by_path = np.mean(errors, axis=0)
    assert by_path < filtered / 3.0


class Stopping:
    """A circle until an instant; then rest."""

    def __init__(self, at):
        self.at = at

    def pose(self, t):
        return QUICK.pose(min(t, self.at))

    def velocity(self, t):
        return np.zeros(6) if t > self.at else QUICK.velocity(t)


@pytest.mark.parametrize("since", [0.2, 0.5, 1.0, 1.5, 2.0, 4.0])
def test_a_path_that_has_ended_says_nothing(since):
    estimate, _ = follow(Stopping(6.0), 6.0 + since, Noise(position=1e-3, jerk=3.0))
    V = np.empty(6)
    twist_kernel(estimate.state, estimate.time, V)
    added = estimate.velocity(V[3:]) - V[3:]
    assert np.linalg.norm(added) < 0.1 * np.linalg.norm(QUICK.velocity(6.0)[3:])


def test_without_a_path_the_velocity_stays():
    np.testing.assert_array_equal(MotionEstimate(empty_state(), 0.0).velocity([1, 2, 3]), [1, 2, 3])


def test_where_the_path_has_ended_it_goes_on_as_fast_as_another_filter_says():
    """A tracker with a filter of its own knows of a stop, or of a start, before the path does."""
    estimate, _ = follow(Stopping(6.0), 6.3, Noise(position=1e-3, jerk=3.0))
    slow, quick = ([0.1, -0.05, 0.0], [0.2, -0.1, 0.0])
    now, a = estimate.predict([0.0, 1e-3], slow)[:, :3, 3]
    b = estimate.predict([1e-3], quick)[0, :3, 3]
    np.testing.assert_allclose((a - now) / 1e-3, slow, atol=0.02)
    np.testing.assert_allclose((b - now) / 1e-3, quick, atol=0.02)


@pytest.mark.parametrize("angle", [0.2, 1.0, np.pi])
def test_what_is_turned_over_moves_on_as_before(angle):
    """Position and angular velocity are those of the motion, about the object as it is now."""
    turned = se3.make_pose(se3.so3_exp([0.0, angle, 0.0]), np.zeros(3))
    state = follow(CIRCLE, 6.0)[0].state.copy()
    for t in np.arange(6.0, 6.3, PERIOD):
        measure_kernel(state, t, CIRCLE.pose(t) @ turned, Noise())
    position, turn = off(Turned(CIRCLE, turned), MotionEstimate(state, float(t)))
    assert np.all(position < 3e-3)
    assert np.all(turn < 1e-2)


def test_an_orientation_that_jumps_again_and_again_leaves_the_path_as_it_is():
    """As that of a ball, which looks the same from all sides."""
    state, rng = empty_state(), np.random.default_rng(0)
    for t in np.arange(0.0, 6.0, 1.0 / 30.0):
        turned = se3.make_pose(se3.so3_exp(rng.uniform(-1.0, 1.0, 3)), np.zeros(3))
        measure_kernel(state, t, QUICK.pose(t) @ turned, Noise(1.5e-3, 8e-3, jerk=1.5))
    position, _ = off(QUICK, MotionEstimate(state, float(t), QUICK.pose(t)))
    assert np.all(position < 0.01)


def test_a_prediction_goes_on_from_the_pose_of_a_better_filter():
    """Of images that are 0.1 s old, by a filter that lags behind."""
    state = empty_state()
    for t in np.arange(0.0, 6.0, 1.0 / 30.0):
        measure_kernel(state, t, QUICK.pose(t), Noise(1.5e-3, 8e-3, jerk=1.5))
    now = float(t) + 0.1
    alone, ahead = MotionEstimate(state, now), np.linspace(0.0, 1.0, 11)
    start, true = QUICK.pose(now), np.array([QUICK.pose(now + s)[:3, 3] for s in ahead])
    better = MotionEstimate(state, now, start)
    np.testing.assert_allclose(better.predict([0.0])[0], start, atol=1e-12)
    shifted = alone.predict(ahead)[:, :3, 3] - alone.predict([0.0])[0, :3, 3] + start[:3, 3]
    worst = [
        np.linalg.norm(p - true, axis=1).max() for p in (better.predict(ahead)[:, :3, 3], shifted)
    ]
    assert worst[0] < 4e-3 < 8e-3 < worst[1]


class Turned:
    """A motion of a frame that is turned in the object."""

    def __init__(self, truth, turned):
        self.truth, self.turned = truth, turned

    def pose(self, t):
        return self.truth.pose(t) @ self.turned

    def velocity(self, t):
        return self.truth.velocity(t)


def test_what_jumps_there_and_back_leaves_no_trace():
    noise = Noise(position=1e-3)
    there, plain = follow(CIRCLE, 1.0)[0].state.copy(), follow(CIRCLE, 1.0)[0].state.copy()
    for k, t in enumerate(np.arange(1.0, 3.0, PERIOD)):
        # Every other measurement is somewhere else, never at the same place.
        if k % 2:
            far = se3.make_pose(np.eye(3), np.array([2.0 + k, 0.0, 0.0]))
            measure_kernel(there, t, CIRCLE.pose(t) @ far, noise)
        else:
            measure_kernel(there, t, CIRCLE.pose(t), noise)
            measure_kernel(plain, t, CIRCLE.pose(t), noise)
    same = [MotionEstimate(state, t).predict([0.0, 0.5]) for state in (there, plain)]
    np.testing.assert_array_equal(*same)


def test_after_a_long_silence_the_filter_starts_anew():
    state = follow(CIRCLE, 1.0)[0].state.copy()
    X = CIRCLE.pose(1.0)
    X[0, 3] += 0.1
    measure_kernel(state, 5.0, X, Noise())
    np.testing.assert_array_equal(MotionEstimate(state, 5.0).predict([0.0, 1.0]), [X, X])


def test_future_poses_fall_back_on_the_twist():
    estimate, _ = follow(CIRCLE, 6.0)
    X_WO, V_WO = CIRCLE.pose(estimate.time), CIRCLE.velocity(estimate.time)
    np.testing.assert_allclose(
        future_poses(estimate, X_WO, V_WO, HORIZON), estimate.predict(HORIZON, V_WO[3:]), atol=1e-12
    )
    lifted = X_WO.copy()
    lifted[2, 3] += 0.1
    expected = [se3.extrapolate(lifted, V_WO, s) for s in HORIZON]
    for unknown in (estimate, None, MotionEstimate(empty_state(), 0.0)):
        np.testing.assert_allclose(future_poses(unknown, lifted, V_WO, HORIZON), expected)


def test_a_pose_beside_the_filtered_one_goes_the_same_way():
    """As an image that errs by 2 cm and 10 degrees has it: no reason to forget the circle."""
    estimate, _ = follow(CIRCLE, 6.0)
    beside = se3.make_pose(se3.so3_exp([0.1, -0.15, 0.05]), [0.01, -0.015, 0.01])
    X_WO = CIRCLE.pose(estimate.time)
    beside = se3.make_pose(X_WO[:3, :3] @ beside[:3, :3], X_WO[:3, 3] + beside[:3, 3])
    X = future_poses(estimate, beside, CIRCLE.velocity(estimate.time), HORIZON)
    for later, s in zip(X, HORIZON, strict=True):
        true = CIRCLE.pose(estimate.time + s)
        moved = true[:3, 3] - X_WO[:3, 3]
        np.testing.assert_allclose(later[:3, 3] - beside[:3, 3], moved, atol=3e-3)
        turned = true[:3, :3] @ X_WO[:3, :3].T
        assert se3.rotation_angle(later[:3, :3] @ (turned @ beside[:3, :3]).T) < 2e-2


class SpeedingUp:
    """A straight motion that never oscillates: its acceleration stays what it is."""

    a = np.array([0.05, 0.0, -0.02])

    def pose(self, t):
        X = np.eye(4)
        X[:3, 3] = 0.5 * self.a * t * t
        return X

    def velocity(self, t):
        return np.r_[np.zeros(3), self.a * t]


def test_an_acceleration_without_end_is_not_believed_for_long():
    """What the object gains in speed from now on is what a second and a half of it would bring."""
    estimate, _ = follow(SpeedingUp(), 8.0)
    soon, late, later = estimate.predict([0.1, 9.9, 10.0])[:, :3, 3]
    true = SpeedingUp().pose(estimate.time + 0.1)[:3, 3]
    np.testing.assert_allclose(soon, true, atol=1e-3)
    gained = (later - late) / 0.1 - SpeedingUp().velocity(estimate.time)[3:]
    np.testing.assert_allclose(gained, 1.5 * SpeedingUp.a, rtol=0.05, atol=1e-3)
