"""The safety QP: its promises for any request, kept over time against adversarial requests."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feasigrasp.models.iiwa import ACCELERATION_LIMITS, POSITION_LIMITS, VELOCITY_LIMITS
from feasigrasp.models.iiwa_kinematics import pose_and_jacobian
from feasigrasp.models.safe_velocity import SafetyOptions, safe_velocity, velocity_bounds
from feasigrasp.models.self_collision import (
    distances_and_gradients,
    min_distance,
    table_distances_and_gradients,
)

OPTIONS = SafetyOptions()
HOME = np.array([0, -0.846, 0, -1.582, 0, 1.446, 0])
CAPACITY = OPTIONS.velocity_scale * VELOCITY_LIMITS

numbers = st.floats(allow_nan=True, allow_infinity=True)


def vectors(element, n):
    return st.lists(element, min_size=n, max_size=n).map(np.array)


#: Configurations up to 50 % outside the limits.
positions = vectors(st.floats(-1.5, 1.5), 7).map(lambda x: x * POSITION_LIMITS)


def clearance(q):
    return min(min_distance(q), table_distances_and_gradients(q)[0].min())


def random_twist_request(q, rng):
    return pose_and_jacobian(q)[1], rng.normal(size=6) * [3, 3, 3, 1, 1, 1]


@settings(deadline=None, max_examples=150)
@given(positions, vectors(numbers, 7), vectors(numbers, 6), st.booleans())
def test_the_answer_is_always_an_admissible_velocity(q, request, twist, follow):
    J = pose_and_jacobian(q)[1]
    with np.errstate(all="ignore"):
        qd = safe_velocity(q, request, *((J, twist) if follow else ()))
    assert np.isfinite(qd).all()
    lower, upper = velocity_bounds(q, OPTIONS)
    assert ((lower <= qd) & (qd <= upper)).all() or (qd == 0.0).all()
    assert (np.abs(qd) <= CAPACITY).all()


@settings(deadline=None, max_examples=50)
@given(vectors(numbers, 7))
def test_positions_that_are_not_finite_stop_the_arm(q):
    if not np.isfinite(q).all():
        with np.errstate(all="ignore"):
            np.testing.assert_array_equal(safe_velocity(q, np.ones(7)), 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_requests_that_are_not_finite_stop_the_arm(bad):
    request, twist = np.full(7, 0.1), np.full(6, 0.1)
    J = pose_and_jacobian(HOME)[1]
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(safe_velocity(HOME, request * bad), 0.0)
        np.testing.assert_array_equal(safe_velocity(HOME, request * bad, J, twist), 0.0)
        np.testing.assert_array_equal(safe_velocity(HOME, request, J, twist * bad), 0.0)
        np.testing.assert_array_equal(safe_velocity(HOME, request, J * bad, twist), 0.0)


@settings(deadline=None)
@given(positions)
def test_velocity_bounds(q):
    lower, upper = velocity_bounds(q, OPTIONS)
    assert (lower <= upper).all()
    assert (np.abs(lower) <= CAPACITY).all() and (np.abs(upper) <= CAPACITY).all()
    room = POSITION_LIMITS - OPTIONS.position_margin - np.abs(q)
    towards = np.where(q > 0, upper, -lower)
    inside = room > 0
    assert (towards[inside] >= 0).all() and (towards[~inside] <= 0).all()
    # Half of the joint's acceleration stops it within the room that is left.
    braking = towards[inside] ** 2 / ACCELERATION_LIMITS[inside]
    assert (braking <= room[inside] + 1e-12).all()
    middle = np.abs(q) < 0.2
    np.testing.assert_allclose(upper[middle], CAPACITY[middle])
    np.testing.assert_allclose(lower[middle], -CAPACITY[middle])


def test_a_joint_velocity_is_granted_where_nothing_is_in_the_way():
    for seed in range(20):
        request = np.random.default_rng(seed).uniform(-0.5, 0.5, 7)
        np.testing.assert_allclose(safe_velocity(HOME, request), request, atol=1e-6)


def test_a_twist_is_followed_where_nothing_is_in_the_way():
    X, J = pose_and_jacobian(HOME)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        V = rng.normal(size=6) * [0.3, 0.3, 0.3, 0.1, 0.1, 0.1]
        request = rng.uniform(-0.2, 0.2, 7)
        qd = safe_velocity(HOME, request, J, V)
        np.testing.assert_allclose(J @ qd, V, atol=0.02 * np.linalg.norm(V) + 0.002)
        # Without bounds it is the minimiser of the objective.
        W = np.diag([OPTIONS.rotation_weight] * 3 + [1.0] * 3)
        root = np.sqrt(OPTIONS.damping)
        stacked = np.vstack([W @ J, root * np.eye(7)])
        best = np.linalg.lstsq(stacked, np.concatenate([W @ V, root * request]), rcond=None)[0]
        np.testing.assert_allclose(qd, best, atol=1e-6)


def test_redundant_motion_follows_the_preferred_velocity():
    """The elbow turns as asked while the hand stays."""
    J = pose_and_jacobian(HOME)[1]
    null = np.linalg.svd(J)[2][-1]
    qd = safe_velocity(HOME, 0.3 * null, J, np.zeros(6))
    np.testing.assert_allclose(qd, 0.3 * null, atol=1e-6)


def test_a_request_that_is_too_fast_is_cut_per_joint():
    qd = safe_velocity(HOME, np.array([10.0, 0, 0, 0, 0, 0, -10.0]))
    np.testing.assert_allclose(qd[[0, 6]], [CAPACITY[0], -CAPACITY[6]], atol=1e-9)


def test_outside_a_limit_it_leads_back():
    q = HOME.copy()
    q[4] = POSITION_LIMITS[4] + 0.1
    assert safe_velocity(q, np.zeros(7))[4] <= -5.0 * 0.1
    assert safe_velocity(q, np.full(7, 0.3))[4] <= -5.0 * 0.1


def near_collision(n, closer_than, seed):
    """Configurations inside the limits with a pair or the table this near, not below clearance."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        q = rng.uniform(-0.95, 0.95, 7) * POSITION_LIMITS
        if OPTIONS.clearance < clearance(q) < closer_than:
            found.append(q)
    return found


def test_close_bodies_approach_no_faster_than_their_room_allows():
    for q in near_collision(20, 0.04, seed=1):
        for distance, gradient in (distances_and_gradients(q), table_distances_and_gradients(q)):
            for row in np.flatnonzero(distance < OPTIONS.active_distance):
                qd = safe_velocity(q, -5.0 * gradient[row])
                allowed = -OPTIONS.collision_gain * (distance[row] - OPTIONS.clearance)
                assert gradient[row] @ qd >= allowed - 1e-3


def test_bodies_that_are_too_close_are_pushed_apart():
    rng = np.random.default_rng(2)
    checked = 0
    while checked < 10:
        q = rng.uniform(-0.9, 0.9, 7) * POSITION_LIMITS
        if not 0.0 < clearance(q) < 0.8 * OPTIONS.clearance:
            continue
        before = clearance(q)
        for _ in range(200):
            q = q + 0.005 * safe_velocity(q, np.zeros(7))
        assert clearance(q) > (before + OPTIONS.clearance) / 2
        checked += 1


def towards_contact(q, rng):
    """Full speed at whatever is nearest and can come nearer, self or table."""
    d_self, grad_self = distances_and_gradients(q)
    d_table, grad_table = table_distances_and_gradients(q)
    distance, gradient = np.concatenate([d_self, d_table]), np.concatenate([grad_self, grad_table])
    distance[np.abs(gradient).max(axis=1) < 1e-9] = np.inf
    return (-20.0 * gradient[np.argmin(distance)],)


ADVERSARIES = {
    "constant": lambda q, rng: (3.0 * np.sign(np.arange(7) % 3 - 0.5) * (1 + rng.random(7)),),
    "limits": lambda q, rng: (10.0 * np.sign(q),),
    "random": lambda q, rng: (rng.normal(scale=3.0, size=7),),
    "contact": towards_contact,
    "twist": lambda q, rng: (rng.normal(size=7), *random_twist_request(q, rng)),
    "dive": lambda q, rng: (np.zeros(7), pose_and_jacobian(q)[1], np.array([0, 0, 0, 0, 0, -2.0])),
}


@pytest.mark.parametrize("name", ADVERSARIES)
def test_no_request_leads_out_of_the_limits_or_into_contact(name):
    """Two seconds at 200 Hz from random admissible configurations."""
    rng = np.random.default_rng(3)
    starts = []
    while len(starts) < 4:
        q = rng.uniform(-1, 1, 7) * POSITION_LIMITS
        if np.abs(q / POSITION_LIMITS).max() < 0.98 and clearance(q) > 0.02:
            starts.append(q)
    for q in starts:
        start = q
        for _ in range(400):
            qd = safe_velocity(q, *ADVERSARIES[name](q, rng))
            assert (np.abs(qd) <= CAPACITY).all()
            q = q + 0.005 * qd
            assert (np.abs(q) <= POSITION_LIMITS - 0.99 * OPTIONS.position_margin).all()
            assert clearance(q) > 0.98 * OPTIONS.clearance
        assert np.abs(q - start).max() > 0.01
