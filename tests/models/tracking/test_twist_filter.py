"""The filter's prediction is the motion's, and its covariance that of the errors it makes."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.tracking.twist_filter import DECAY, TwistFilter, moved, pose_error
from tests.tracked_block import on_a_circle

X0 = se3.make_pose(se3.so3_exp([0.3, -0.2, 1.0]), [0.5, 0.1, 0.4])
TWIST = np.array([0.1, -0.2, 0.15, 0.05, 0.1, -0.02])
PERIOD = 1.0 / 30.0


def followed(rng, seconds=2.0, information=None, sigma=(0.005, 0.0005)):
    """The filter after that long of noisy poses of a steady motion, and the true pose."""
    estimate = TwistFilter.at_rest(0.0, X0)
    noise = np.repeat(sigma, 3)
    known = np.diag(noise**-2.0) if information is None else information
    for k in range(1, round(seconds / PERIOD) + 1):
        t = k * PERIOD
        X_true = se3.extrapolate(X0, TWIST, t)
        estimate = estimate.predicted(t)
        # The most likely pose given measurement z and prior P: e = (I + P^-1)^-1 I z.
        z = pose_error(estimate.X_WO, moved(X_true, noise * rng.standard_normal(6)))
        prior = np.linalg.inv(estimate.pose_covariance)
        e = np.linalg.solve(known + prior, known @ z)
        estimate = estimate.measured(moved(estimate.X_WO, e), known)
    return estimate, se3.extrapolate(X0, TWIST, round(seconds / PERIOD) * PERIOD)


def test_errors_are_the_inverse_of_moves():
    e = np.array([0.3, -0.1, 0.2, 0.1, 0.2, 0.3])
    assert np.allclose(pose_error(X0, moved(X0, e)), e)


def test_the_covariance_is_that_of_the_errors():
    rng = np.random.default_rng(0)
    errors, claimed = [], None
    for _ in range(60):
        estimate, X_true = followed(rng, 1.0)
        twist = TWIST - estimate.V_WO
        errors.append(np.concatenate([pose_error(estimate.X_WO, X_true), twist, estimate.a_WO]))
        claimed = estimate.covariance
    # It reckons with a twist that changes, which this one does not: errors are smaller than
    # claimed, and not by much.
    ratio = np.std(errors, axis=0) / np.sqrt(np.diag(claimed))
    assert ratio.min() > 0.2 and ratio.max() < 1.3


def test_it_finds_a_steady_twist():
    estimate, _ = followed(np.random.default_rng(1))
    claimed = np.sqrt(np.diag(estimate.covariance)[6:12])
    assert np.all(np.abs(estimate.V_WO - TWIST) < 2.0 * claimed)
    assert claimed[:3].max() < 0.1 and claimed[3:].max() < 0.03
    assert np.linalg.norm(estimate.V_WO - TWIST) < 0.3 * np.linalg.norm(TWIST)


def test_what_is_not_measured_stays_at_its_prior():
    known = np.diag([1e5, 1e5, 0.0, 1e7, 1e7, 1e7])
    estimate, _ = followed(np.random.default_rng(2), information=known)
    assert abs(estimate.V_WO[2]) < 0.01
    sigma = np.sqrt(np.diag(estimate.covariance))
    assert sigma[2] > 20 * sigma[0]


def test_a_measurement_is_the_textbook_update():
    """Against the Kalman gain of a measured pose, for a covariance with correlations."""
    rng = np.random.default_rng(3)
    before = TwistFilter.at_rest(0.0, X0).predicted(0.1)
    noise = np.diag(rng.random(6) * 1e-4)
    z = 1e-3 * rng.standard_normal(6)
    H = np.hstack([np.eye(6), np.zeros((6, 9))])
    K = before.covariance @ H.T @ np.linalg.inv(H @ before.covariance @ H.T + noise)
    e = K @ z
    after = before.measured(moved(before.X_WO, e[:6]), np.linalg.inv(noise))
    assert np.allclose(after.V_WO - before.V_WO, e[6:12], atol=1e-9)
    assert np.allclose(after.a_WO - before.a_WO, e[12:], atol=1e-9)
    assert np.allclose(after.covariance, (np.eye(15) - K @ H) @ before.covariance, atol=1e-12)


def test_while_nothing_is_measured_the_twist_dies_away():
    estimate = TwistFilter(0.0, X0, TWIST, np.array([0.5, -1.0, 2.0]), np.eye(15) * 1e-6)
    late = estimate.predicted(10.0 * DECAY, coasting=True)
    assert np.abs(late.V_WO).max() < 1e-4
    assert np.allclose(late.X_WO[:3, 3] - X0[:3, 3], DECAY * TWIST[3:], atol=1e-4)
    steps = estimate
    for k in range(1, 11):
        steps = steps.predicted(k * DECAY, coasting=True)
    assert np.allclose(steps.X_WO, late.X_WO, atol=1e-9)
    assert np.trace(late.covariance) > np.trace(estimate.covariance)
    assert np.allclose(late.a_WO, 0.0)


@pytest.mark.parametrize(("speed", "lag"), [(0.1, 0.002), (0.3, 0.007), (0.6, 0.02)])
def test_on_a_circle_the_velocity_does_not_lag_behind(speed, lag):
    """A filter of constant velocity that smooths as much lags by 4, 35 and 143 mm/s."""
    estimate, known = TwistFilter.at_rest(0.0, on_a_circle(0.0, speed)[0]), np.full(6, 1e6)
    known[:3], errors = 4e4, []  # poses as of an image that errs by 1 mm and 5 mrad, but true ones
    for k in range(1, 121):
        X_true, v = on_a_circle(k * PERIOD, speed)
        estimate = estimate.predicted(k * PERIOD)
        prior = np.linalg.inv(estimate.pose_covariance)
        e = np.linalg.solve(np.diag(known) + prior, known * pose_error(estimate.X_WO, X_true))
        estimate = estimate.measured(moved(estimate.X_WO, e), np.diag(known))
        errors.append(np.linalg.norm(estimate.V_WO[3:] - v))
    assert np.median(errors[60:]) < lag


def test_a_curve_is_followed_for_a_moment_and_then_straight_on():
    a_WO = np.array([0.0, 0.0, 2.0])
    estimate = TwistFilter(0.0, X0, TWIST, a_WO, np.eye(15))
    straight = TwistFilter(0.0, X0, TWIST, np.zeros(3), np.eye(15))

    def bent(t):
        return (estimate.pose(t) - straight.pose(t))[:3, 3]

    h = 1e-6
    for t in (0.03, 0.09, 0.5):
        velocity = (bent(t + h) - bent(t - h)) / (2.0 * h)
        np.testing.assert_allclose(estimate.twist(t)[3:] - TWIST[3:], velocity, atol=1e-6)
    assert np.linalg.norm(bent(1.0)) < 0.25


def test_an_acceleration_along_the_way_dies_soon_and_one_across_turns_with_it():
    v_WO, t = np.array([0.0, 0.0, 0.3]), 0.08
    along = TwistFilter(0.0, X0, np.r_[np.zeros(3), v_WO], 4.0 * v_WO, np.eye(15))
    # v' = 4 v exp(-t / 0.05 s), integrated
    way = t + 4.0 * 0.05 * (t - 0.05 * (1.0 - np.exp(-t / 0.05)))
    np.testing.assert_allclose(along.pose(t)[:3, 3] - X0[:3, 3], way * v_WO, atol=1e-12)
    speed, radius = 0.45, 0.12
    X, v_WO = on_a_circle(0.0, speed, radius)
    inwards = -(speed**2) / radius**2 * X[:3, 3]
    across = TwistFilter(0.0, X, np.r_[np.zeros(3), v_WO], inwards, np.eye(15))
    # By Taylor's theorem what is left is at most r (v t / r)^4 / 24, and its derivative.
    turned = speed * t / radius
    X_later, v_later = on_a_circle(t, speed, radius)
    off = across.pose(t)[:3, 3] - X_later[:3, 3]
    assert np.linalg.norm(off) < 1.01 * radius * turned**4 / 24.0
    assert np.linalg.norm(across.twist(t)[3:] - v_later) < 1.01 * speed * turned**3 / 6.0


def test_an_object_that_stops_is_soon_expected_at_rest():
    """It brakes within 0.12 s; a filter that takes the braking to go on expects it to come back.

    That one expected up to 0.24 m/s, 0.1 s after the stop.
    """
    rng, speed, brakes, stop = np.random.default_rng(5), 0.3, 2.5, 1.0
    noise = np.repeat((0.01, 0.002), 3)
    estimate, known, fastest = TwistFilter.at_rest(0.0, X0), np.diag(noise**-2.0), []
    for k in range(1, 46):
        t = k * PERIOD
        braking = max(0.0, min(t - stop, speed / brakes))
        way = speed * min(t, stop) + speed * braking - 0.5 * brakes * braking**2
        X_true = moved(X0, np.array([0.0, 0.0, 0.0, way, 0.0, 0.0]))
        estimate = estimate.predicted(t)
        z = pose_error(estimate.X_WO, moved(X_true, noise * rng.standard_normal(6)))
        e = np.linalg.solve(known + np.linalg.inv(estimate.pose_covariance), known @ z)
        estimate = estimate.measured(moved(estimate.X_WO, e), known)
        if t > stop + speed / brakes + 0.1:  # an image that comes 70 ms late
            fastest.append(np.linalg.norm(estimate.twist(t + 0.07)[3:]))
    assert max(fastest) < 0.1


def test_the_past_changes_nothing():
    estimate = TwistFilter.at_rest(1.0, X0)
    assert estimate.predicted(0.9) is estimate
    with pytest.raises(ValueError):
        estimate.covariance[0, 0] = 1.0
