"""The way to where a strand will be: it arrives in time, and as quick as it."""

import numpy as np

from feasigrasp.models.objects.predicted_poses import PredictionModel
from feasigrasp.models.control.task.choice import ChoiceOptions
from feasigrasp.models.control.task.safe_law import (
    _SOONEST,
    interception_velocity,
    object_at_interception,
)
from feasigrasp.models.geometry import se3

PERIOD = 0.005
OPTIONS = ChoiceOptions(prediction=PredictionModel.TWIST)


def way(q, v, q_meet, v_meet, duration):
    """Positions and velocities at the ticks until the meeting is too close to be met."""
    left, path = duration, []
    while left > _SOONEST:
        v = interception_velocity(q, v, q_meet, v_meet, left, PERIOD)
        q, left = q + PERIOD * v, left - PERIOD
        path.append((duration - left, q, v))
    return path


def cubic(t, q, v, q_meet, v_meet, T):
    """Hermite's polynomial."""
    s = t / T
    return (
        (1 + 2 * s) * (1 - s) ** 2 * q
        + s * (1 - s) ** 2 * T * v
        + s**2 * (3 - 2 * s) * q_meet
        + s**2 * (s - 1) * T * v_meet
    )


def test_it_follows_the_cubic_that_arrives_with_the_velocity_of_what_it_meets():
    rng = np.random.default_rng(0)
    start, v, goal, v_goal = rng.uniform(-1.0, 1.0, (4, 7))
    path = way(start, v, goal, v_goal, 1.2)
    for t, q, _ in path:
        np.testing.assert_allclose(q, cubic(t, start, v, goal, v_goal, 1.2), atol=0.02)
    t, q, v = path[-1]
    np.testing.assert_allclose(q + (1.2 - t) * v, goal, atol=0.1)  # what is left is followed


def test_what_moves_as_it_is_met_needs_no_acceleration():
    v = np.linspace(-1.0, 1.0, 7)
    np.testing.assert_allclose(interception_velocity(np.zeros(7), v, 0.8 * v, v, 0.8, PERIOD), v)


def test_the_object_is_expected_on_its_way_with_the_twist_that_it_will_have():
    V_WO = np.array([0.3, -0.5, 2.0, 0.1, 0.4, -0.2])
    X_WO = se3.random_pose(np.random.default_rng(1), 1)[0]
    X, V = object_at_interception(None, X_WO, V_WO, 0.7, OPTIONS)
    np.testing.assert_allclose(X, se3.extrapolate(X_WO, V_WO, 0.7), atol=1e-9)
    np.testing.assert_allclose(V, V_WO, atol=1e-6)
    X, V = object_at_interception(
        None, X_WO, V_WO, 0.7, ChoiceOptions(prediction=PredictionModel.NONE)
    )
    np.testing.assert_array_equal(X, X_WO)
    np.testing.assert_array_equal(V, np.zeros(6))
