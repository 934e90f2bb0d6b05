"""The safety QP: its promises for any request, kept over time against adversarial requests."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from feasigrasp.errors import ControlError
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from tests.truths import min_distance, signed_distances, table_distances

OPTIONS = SafetyOptions()
SAFETY = SafetyFilter(OPTIONS)
HOME = np.array([0, -0.846, 0, -1.582, 0, 1.446, 0])
CAPACITY = OPTIONS.velocity_scale * IIWA_7.velocity_limits

numbers = st.floats(allow_nan=True, allow_infinity=True)


def vectors(element, n):
    return st.lists(element, min_size=n, max_size=n).map(np.array)


#: Configurations up to 50 % outside the limits.
positions = vectors(st.floats(-1.5, 1.5), 7).map(lambda x: x * IIWA_7.upper)


def clearance(q):
    return min(min_distance(q), table_distances(q).min())


def with_gradient(distances, q, step=1e-6):
    """Distances (m,) and their gradients (m, 7), by central differences."""
    ahead, behind = (np.stack([distances(q + s * e) for e in np.eye(7)]) for s in (step, -step))
    return distances(q), (ahead - behind).T / (2 * step)


def random_twist_request(q, rng):
    return pose_and_jacobian(q)[1], rng.normal(size=6) * [3, 3, 3, 1, 1, 1]


@settings(deadline=None, max_examples=150)
@given(positions, vectors(numbers, 7), vectors(numbers, 6), st.booleans())
def test_the_answer_is_always_an_admissible_velocity(q, request, twist, follow):
    J = pose_and_jacobian(q)[1]
    with np.errstate(all="ignore"):
        qd = SAFETY.velocity(q, request, *((J, twist) if follow else ()))
    assert np.isfinite(qd).all()
    lower, upper = SAFETY.problem(q, np.zeros(7))[1][:2, :7]
    assert ((lower <= qd) & (qd <= upper)).all() or (qd == 0.0).all()
    assert (np.abs(qd) <= CAPACITY).all()


@settings(deadline=None, max_examples=50)
@given(vectors(numbers, 7))
def test_positions_that_are_not_finite_stop_the_arm(q):
    if not np.isfinite(q).all():
        with np.errstate(all="ignore"):
            np.testing.assert_array_equal(SAFETY.velocity(q, np.ones(7)), 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_requests_that_are_not_finite_stop_the_arm(bad):
    request, twist = np.full(7, 0.1), np.full(6, 0.1)
    J = pose_and_jacobian(HOME)[1]
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(SAFETY.velocity(HOME, request * bad), 0.0)
        np.testing.assert_array_equal(SAFETY.velocity(HOME, request * bad, J, twist), 0.0)
        np.testing.assert_array_equal(SAFETY.velocity(HOME, request, J, twist * bad), 0.0)
        np.testing.assert_array_equal(SAFETY.velocity(HOME, request, J * bad, twist), 0.0)


def test_a_joint_velocity_is_granted_where_nothing_is_in_the_way():
    for seed in range(20):
        request = np.random.default_rng(seed).uniform(-0.5, 0.5, 7)
        np.testing.assert_allclose(SAFETY.velocity(HOME, request), request, atol=1e-6)


def test_a_twist_is_followed_where_nothing_is_in_the_way():
    X, J = pose_and_jacobian(HOME)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        V = rng.normal(size=6) * [0.3, 0.3, 0.3, 0.1, 0.1, 0.1]
        request = rng.uniform(-0.2, 0.2, 7)
        qd = SAFETY.velocity(HOME, request, J, V)
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
    qd = SAFETY.velocity(HOME, 0.3 * null, J, np.zeros(6))
    np.testing.assert_allclose(qd, 0.3 * null, atol=1e-6)


@pytest.mark.parametrize("bend_deg", [0.0, 0.2, -0.2, 1.0])
def test_a_straight_arm_draws_back(bend_deg):
    """In any direction in which it is stretched; outwards it stays as it is."""
    for q0, q1 in [(0.0, 90.0), (40.0, 60.0), (-100.0, 80.0)]:
        q = np.deg2rad([q0, q1, 0.0, -bend_deg, 0.0, 0.0, 0.0])
        start, qd = pose_and_jacobian(q)[0][:3, 3].copy(), np.zeros(7)
        way = start - [0.0, 0.0, IIWA_7.link_steps[0]]
        V = np.concatenate([np.zeros(3), -0.1 * way / np.linalg.norm(way)])
        for _ in range(400):
            qd = SAFETY.velocity(q, np.zeros(7), pose_and_jacobian(q)[1], V, qd_last=qd)
            q = q + OPTIONS.period * qd
        moved = pose_and_jacobian(q)[0][:3, 3] - start
        assert moved @ V[3:] > 0.1 * 0.08  # of 0.2 m
    still = np.deg2rad([0.0, 90.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    J = pose_and_jacobian(still)[1]
    np.testing.assert_allclose(SAFETY.velocity(still, np.zeros(7), J, -V), 0.0, atol=0.2)


def test_a_request_that_is_too_fast_is_cut_per_joint():
    qd = SAFETY.velocity(HOME, np.array([10.0, 0, 0, 0, 0, 0, -10.0]))
    np.testing.assert_allclose(qd[[0, 6]], [CAPACITY[0], -CAPACITY[6]], atol=1e-9)


def test_outside_a_limit_it_leads_back():
    q = HOME.copy()
    q[4] = IIWA_7.upper[4] + 0.1
    assert SAFETY.velocity(q, np.zeros(7))[4] <= -0.99 * OPTIONS.approach_gain * 0.1
    assert SAFETY.velocity(q, np.full(7, 0.3))[4] <= -0.99 * OPTIONS.approach_gain * 0.1


def near_collision(n, closer_than, seed):
    """Configurations inside the limits with a pair or the table this near, not below clearance."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        q = rng.uniform(-0.95, 0.95, 7) * IIWA_7.upper
        if OPTIONS.clearance < clearance(q) < closer_than:
            found.append(q)
    return found


def test_close_bodies_approach_no_faster_than_their_room_allows():
    for q in near_collision(20, 0.04, seed=1):
        for distances in (signed_distances, table_distances):
            distance, gradient = with_gradient(distances, q)
            for row in np.flatnonzero(distance < 0.08):
                qd = SAFETY.velocity(q, -5.0 * gradient[row])
                allowed = -OPTIONS.approach_gain * (distance[row] - OPTIONS.clearance)
                assert gradient[row] @ qd >= allowed - 1e-6


def test_bodies_that_are_too_close_are_pushed_apart():
    rng = np.random.default_rng(2)
    checked = 0
    while checked < 10:
        q = rng.uniform(-0.9, 0.9, 7) * IIWA_7.upper
        if not 0.0 < clearance(q) < 0.8 * OPTIONS.clearance:
            continue
        before = clearance(q)
        for _ in range(200):
            q = q + 0.005 * SAFETY.velocity(q, np.zeros(7))
        assert clearance(q) > (before + OPTIONS.clearance) / 2
        checked += 1


def towards_contact(q, rng):
    """Full speed at whatever is nearest and can come nearer, self or table."""
    d_self, grad_self = with_gradient(signed_distances, q)
    d_table, grad_table = with_gradient(table_distances, q)
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


def starts(n, rng, margin=0.02):
    """Configurations at rest inside the limits and clear of everything."""
    found = []
    while len(found) < n:
        q = rng.uniform(-1, 1, 7) * IIWA_7.upper
        if np.abs(q / IIWA_7.upper).max() < 0.98 and clearance(q) > margin:
            found.append(q)
    return found


@pytest.mark.parametrize("accelerations", [True, False])
@pytest.mark.parametrize("name", ADVERSARIES)
def test_no_request_leads_out_of_the_limits_or_into_contact(name, accelerations):
    """Three seconds at 200 Hz from random admissible configurations; new requests every 0.1 s."""
    rng = np.random.default_rng(3)
    change = OPTIONS.period * OPTIONS.acceleration_scale * IIWA_7.acceleration_limits
    for start in starts(4, rng):
        q, last = start, np.zeros(7)
        for k in range(600):
            if k % 20 == 0 or name in ("contact", "dive"):
                request = ADVERSARIES[name](q, rng)
            qd = SAFETY.velocity(q, *request, qd_last=last if accelerations else None)
            assert (np.abs(qd) <= CAPACITY).all()
            if accelerations:
                assert (np.abs(qd - last) <= change * (1 + 1e-9)).all()
            last, q = qd, q + OPTIONS.period * qd
            assert (np.abs(q) <= IIWA_7.upper - OPTIONS.position_margin + 1e-9).all()
            assert clearance(q) > 0.97 * OPTIONS.clearance
        assert np.abs(q - start).max() > 0.01


def test_when_the_request_ends_the_arm_stops_as_soon_as_its_accelerations_allow():
    rng = np.random.default_rng(4)
    slowest = (CAPACITY / (OPTIONS.acceleration_scale * IIWA_7.acceleration_limits)).max()
    for q in starts(5, rng):
        last = np.zeros(7)
        for _ in range(100):
            last = SAFETY.velocity(q, np.array([1.0, -1, 1, 1, -1, 1, 2]), qd_last=last)
            q = q + OPTIONS.period * last
        for k in range(int(np.ceil(slowest / OPTIONS.period)) + 1):
            request = np.full(7, np.nan) if k % 2 else np.zeros(7)  # lost, or nothing to do
            last = SAFETY.velocity(q, request, qd_last=last)
            q = q + OPTIONS.period * last
        np.testing.assert_allclose(last, 0.0, atol=1e-9)


@settings(deadline=None, max_examples=100)
@given(positions, vectors(st.floats(-1.0, 1.0), 7), vectors(numbers, 7), vectors(numbers, 6))
def test_accelerations_are_kept_in_any_state_and_for_any_request(q, share, request, twist):
    """Outside position limits, inside contact, with NaN or infinite requests."""
    last = share * CAPACITY
    change = OPTIONS.period * OPTIONS.acceleration_scale * IIWA_7.acceleration_limits
    for follow in (False, True):
        with np.errstate(all="ignore"):
            J = pose_and_jacobian(q)[1]
            qd = SAFETY.velocity(q, request, *((J, twist) if follow else ()), qd_last=last)
        assert (np.abs(qd) <= CAPACITY).all()
        assert (np.abs(qd - last) <= change * (1 + 1e-9)).all()


@settings(deadline=None, max_examples=50)
@given(vectors(numbers, 7), vectors(numbers, 7))
def test_without_a_finite_state_every_joint_brakes(q, last):
    if np.isfinite(q).all() and np.isfinite(last).all():
        return
    q = np.where(np.abs(q) > 2.0 * np.pi, np.inf, q)  # more would be degrees
    with np.errstate(all="ignore"):
        qd = SAFETY.velocity(q, np.ones(7), qd_last=last)
    known = np.isfinite(last)
    assert np.isfinite(qd).all() and (qd[~known] == 0.0).all()
    assert (np.abs(qd[known]) <= np.abs(last[known])).all()
    assert (qd[known] * np.sign(last[known]) >= 0.0).all()


def test_a_joint_that_is_too_fast_slows_down_within_its_acceleration():
    last = 1.3 * CAPACITY
    qd = SAFETY.velocity(HOME, 10.0 * CAPACITY, qd_last=last)
    change = OPTIONS.period * OPTIONS.acceleration_scale * IIWA_7.acceleration_limits
    np.testing.assert_allclose(qd, last - change, rtol=1e-9)


def test_rows_that_are_left_out_change_nothing():
    """The same QP with all rows, by another solver."""
    rng = np.random.default_rng(6)
    bound = 0
    for q in near_collision(12, 0.03, seed=6):
        request = rng.normal(size=7) + towards_contact(q, rng)[0] / 10
        lower, upper = SAFETY.problem(q, np.zeros(7))[1][:2, :7]
        parts = [with_gradient(f, q) for f in (signed_distances, table_distances)]
        distance, gradient = (np.concatenate(x) for x in zip(*parts, strict=True))
        allowed = -OPTIONS.approach_gain * (distance - OPTIONS.clearance)
        best = minimize(
            lambda x, request=request: 0.5 * ((x - request) ** 2).sum(),
            np.clip(request, lower, upper),
            jac=lambda x, request=request: x - request,
            bounds=list(zip(lower, upper, strict=True)),
            constraints={
                "type": "ineq",
                "fun": lambda x, g=gradient, a=allowed: g @ x - a,
                "jac": lambda x, g=gradient: g,
            },
            options={"ftol": 1e-14, "maxiter": 300},
        )
        if not best.success or (gradient @ best.x < allowed - 1e-7).any():
            continue
        bound += (gradient @ best.x < allowed + 1e-7).any()
        np.testing.assert_allclose(SAFETY.velocity(q, request), best.x, atol=1e-5)
    assert bound >= 3


def test_the_hand_that_is_given_is_the_one_that_is_kept_clear():
    """A larger hand dives at the table: its own fingers stop above it, not the default ones."""
    large = ParallelGripper(max_opening=0.13, tool_offset=0.25, tip=0.04, heel=-0.08)
    model, safety = capsule_model(large), SafetyFilter(OPTIONS, large)
    q, last = HOME, np.zeros(7)
    dive = np.array([0, 0, 0, 0, 0, -0.5])
    lowest = []
    for _ in range(600):
        J = pose_and_jacobian(q, large.X_FG)[1]
        last = safety.velocity(q, np.zeros(7), J, dive, qd_last=last)
        q = q + OPTIONS.period * last
        nearest = table_distances(q, 0.0, model).min()
        lowest.append(min(nearest, min_distance(q, model)))
    assert 0.97 * OPTIONS.clearance < min(lowest) < 1.5 * OPTIONS.clearance
    # The default hand would have had several centimetres to go.
    assert table_distances(q).min() > OPTIONS.clearance + 0.03


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"approach_gain": 10.0}, "approach_gain = 10.0.*velocity_scale"),
        ({"velocity_scale": 1.5}, "velocity_scale = 1.5"),
        ({"period": 0.0}, "period = 0.0"),
        ({"clearance": np.nan}, "clearance = nan"),
        ({"damping": -1.0}, "damping = -1.0"),
    ],
)
def test_options_that_promise_too_much_are_refused(change, names):
    with pytest.raises(ControlError, match=names):
        SafetyOptions(**change)
