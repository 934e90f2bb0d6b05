"""Arm and open hand keep off the object that they follow, and give way to it."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import record
from feasigrasp.models.control.safety.problem import (
    MOST_OBJECT_ROWS,
    ArmState,
    Obstacles,
    object_rows_kernel,
)
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import MovingObject, ObstacleGrid, box_distance_kernel
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.robot.capsule_kernels import link_poses_kernel
from feasigrasp.models.robot.capsules import arm_balls, capsule_model, hand_points
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.shape.gpdf import Gpdf, fit_gpdf
from feasigrasp.models.shape.grids import object_grid
from tests.truths import min_distance, table_distances

RADIUS = 0.04
GRIPPER = ParallelGripper()
HAND = GRIPPER.skin_points()
#: The hand points down, 0.3 m above the table.
Q = np.array([0.0, 0.55, 0.0, -1.6, 0.0, 0.99, 0.0])
OPTIONS = SafetyOptions()


@pytest.fixture(scope="module")
def grid():
    cloud = sphere_points(1200, RADIUS)  # seen all round: nothing is far from an observed point
    return object_grid(fit_gpdf(cloud, length_scale=0.1, max_points=1200))


@pytest.fixture(scope="module")
def safety():
    return SafetyFilter(OPTIONS)


def at(position):
    X = np.eye(4)
    X[:3, 3] = position
    return X


def gap(q, X_WO):
    """Least distance of the open hand's points from the ball."""
    X = forward_kinematics(q, GRIPPER.X_FG)
    points = HAND @ X[:3, :3].T + X[:3, 3]
    return np.linalg.norm(points - X_WO[:3, 3], axis=1).min() - RADIUS


def test_the_grid_is_the_distance_of_the_ball(grid):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(2000, 3))
    x *= (rng.uniform(0.0, 0.1, 2000) / np.linalg.norm(x, axis=1))[:, None]
    truth = np.linalg.norm(x, axis=1) - RADIUS
    distance, gradient = grid.distance_and_gradient(x)
    near = np.abs(truth) < 0.025
    np.testing.assert_allclose(distance[near], truth[near], atol=0.003)
    outward = (gradient * x).sum(axis=1) / np.linalg.norm(x, axis=1)
    np.testing.assert_allclose(outward[near & (truth > -0.02)], 1.0, atol=0.25)
    assert (distance[truth < -0.01] < 0).all() and (distance[truth > 0.005] > 0).all()


def test_a_long_object_has_no_holes():
    """Between the few points that complete it there is surface as well."""
    rng = np.random.default_rng(0)
    turn, along = rng.uniform(0.0, 2.0 * np.pi, 3000), rng.uniform(-0.12, 0.12, 3000)
    rod = np.column_stack([0.012 * np.cos(turn), 0.012 * np.sin(turn), along])
    gpdf = fit_gpdf(rod[:2000], max_points=320)
    assert cKDTree(gpdf.completion.points).query(rod[2000:])[0].max() > 0.012
    distance, _ = object_grid(gpdf).distance_and_gradient(rod[2000:])
    assert np.abs(distance).max() < 0.004


def test_beyond_the_grid_the_distance_is_that_of_the_box_of_the_surface(grid):
    """A lower bound of the true distance, with the gradient that finite differences give."""
    rng = np.random.default_rng(2)
    size = np.array(grid.values.shape)
    for x in rng.uniform(-0.4, 0.4, (200, 3)):
        distance, gradient = box_distance_kernel(tuple(x), tuple(size), grid.frame)
        truth = np.linalg.norm(x) - RADIUS
        assert distance <= truth + 0.001
        assert distance >= np.linalg.norm(np.maximum(np.abs(x) - RADIUS - 0.009, 0.0)) - 1e-9
        if distance > 1e-3:
            moved = box_distance_kernel(
                tuple(x + 1e-6 * np.array(gradient)), tuple(size), grid.frame
            )
            assert moved[0] - distance == pytest.approx(1e-6, rel=1e-3)


def test_surface_that_was_not_seen_counts_as_nearer():
    """By half of the deviation that is expected there; where it was seen it is where it is."""
    cloud = sphere_points(1200, RADIUS)
    cloud = cloud[cloud[:, 2] > -0.02]
    field = fit_gpdf(cloud, length_scale=0.1, max_points=1200)
    made = object_grid(field)
    nodes = np.moveaxis(np.indices(made.values.shape), 0, -1) * made.frame[3] + made.frame[:3]
    near = (made.values > 0.0) & (made.values < 0.012)
    x, values = nodes[near], made.values[near]
    distance, at, _ = field.refine(x, 3)
    apart = np.linalg.norm(at[:, None] - cloud, axis=2).min(axis=1)
    extra_clearance = 0.5 * (0.0002 + 0.21 * apart)
    np.testing.assert_allclose(values, distance - extra_clearance, atol=1e-5)
    seen, unobserved = x[:, 2] > 0.0, x[:, 2] < -0.03
    np.testing.assert_allclose(values[seen], np.linalg.norm(x[seen], axis=1) - RADIUS, atol=1e-3)
    assert (values[unobserved] < distance[unobserved] - 0.001).all() and unobserved.sum() > 20


def test_a_finger_may_go_where_the_camera_has_looked_through():
    """A filled ball that is known to be hollow: inside, its wall is as far as it is."""

    class Hollow(Gpdf):
        def possible(self, x):
            return np.linalg.norm(x, axis=1) > 0.75 * RADIUS

    filled = fit_gpdf(sphere_points(1200, RADIUS), length_scale=0.1, max_points=1200)
    hollow = Hollow(**{f.name: getattr(filled, f.name) for f in dataclasses.fields(Gpdf)})
    x = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, -0.012, 0.008]])
    truth = RADIUS - np.linalg.norm(x, axis=1)
    assert (object_grid(filled).distance_and_gradient(x)[0] < -0.02).all()
    np.testing.assert_allclose(object_grid(hollow).distance_and_gradient(x)[0], truth, atol=0.004)


def test_the_grid_of_a_field_is_made_once():
    field, other = (fit_gpdf(sphere_points(100, RADIUS), length_scale=0.1) for _ in range(2))
    made = object_grid(field)
    assert object_grid(field) is made
    assert object_grid(other) is not made  # equal points, another field


def test_hand_points_lie_on_the_hand():
    X = forward_kinematics(Q)  # the flange
    X_7 = X.copy()
    X_7[:3, 3] -= 0.045 * X[:3, 2]
    in_world = hand_points() @ X_7[:3, :3].T + X_7[:3, 3]
    X_WG = forward_kinematics(Q, GRIPPER.X_FG)
    np.testing.assert_allclose(in_world, HAND @ X_WG[:3, :3].T + X_WG[:3, 3], atol=1e-12)


def all_rows(q, grid, X_WO, V_WO, most=10_000, points=None, extra_clearance=0.0):
    hand = hand_points() if points is None else points
    hand = np.pad(hand, ((0, 0), (1, 1)))  # radius 0 ...
    hand[:, 0] = 7.0  # ... on link 7
    rows, bounds = np.empty((len(hand) + 1, 7)), np.empty(len(hand) + 1)
    wide = np.full(7, 1e6)
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(IIWA_7.chain, q, R, p)
    options = record(SafetyOptions(object_clearance=0.0, object_gain=1.0, slow=1e3))[0]
    arm, nothing = (
        ArmState(IIWA_7.chain, R, p, -wide, wide),
        (np.empty((0, 0, 0), np.float32), np.zeros(5)),
    )
    moving = Obstacles(*nothing, grid.values, grid.frame, X_WO, V_WO, extra_clearance)
    m = object_rows_kernel(arm, options, hand, moving, most, rows, bounds)
    return rows[:m].copy(), bounds[:m].copy()


def test_rows_are_the_rates_of_the_distances_as_hand_and_object_move(grid):
    rng = np.random.default_rng(1)
    below = forward_kinematics(Q, GRIPPER.X_FG)[:3, 3]
    checked = 0
    for _ in range(10):
        q = Q + rng.uniform(-0.02, 0.02, 7)
        R = se3.so3_exp(rng.normal(size=3))
        X_WO = at(below + rng.uniform(-0.03, 0.03, 3))
        X_WO[:3, :3] = R
        qd, V = rng.normal(size=7), rng.normal(size=6)
        rows, bounds = all_rows(q, grid, X_WO, V)
        distance = -all_rows(q, grid, X_WO, np.zeros(6))[1]
        rate = rows @ qd - (bounds + distance)  # n . (v_point - v_surface)
        step, moved = 1e-6, []
        for sign in (1, -1):
            X = X_WO.copy()
            X[:3, 3] += sign * step * V[3:]
            X[:3, :3] = se3.so3_exp(sign * step * V[:3]) @ R
            moved.append(-all_rows(q + sign * step * qd, grid, X, np.zeros(6))[1])
        if not len(moved[0]) == len(moved[1]) == len(rate):
            continue  # a point at the rim of the grid
        error = np.abs((moved[0] - moved[1]) / (2 * step) - rate)
        # Between grid and box all that is known is that the surface is at least as far as this.
        known = ~np.isclose(distance, grid.frame[4], atol=1e-4)
        error, rate = error[known], rate[known]
        assert len(rate) > 100
        assert np.mean(error < 1e-3 * (1 + np.abs(rate))) > 0.9  # apart from faces of voxels
        checked += 1
    assert checked > 5


def test_a_finger_is_not_stopped_at_the_mouth_of_a_bowl():
    """It is next to the box of the surface there, and far from the surface."""
    radius, size, far = 0.08, 0.008, 0.05
    sphere = sphere_points(4000, radius)
    bowl = sphere[sphere[:, 2] < 0.0]
    low = bowl.min(axis=0) - far
    shape = (np.ceil((np.ptp(bowl, axis=0) + 2 * far) / size) + 1).astype(int)
    nodes = np.moveaxis(np.indices(shape), 0, -1) * size + low
    distance = np.minimum(cKDTree(bowl).query(nodes)[0], far)
    grid = ObstacleGrid(distance.astype(np.float32), np.array([*low, size, far]))
    tip = np.array([[0.0, 0.0, 0.225]])  # on the axis of link 7
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(IIWA_7.chain, Q, R, p)
    for height in (0.03, 0.005):
        X_WO = at(R[7] @ tip[0] + p[7] - [0.0, 0.0, height])
        _, bounds = all_rows(Q, grid, X_WO, np.zeros(6), points=tip)
        assert len(bounds) == 1 and bounds[0] <= -far + 1e-9  # gain 1: approach at 5 cm/s


def test_in_the_reserve_the_hand_comes_nearer_but_slowly(grid, safety):
    X_WO = at(forward_kinematics(Q, GRIPPER.X_FG)[:3, 3] - [0.0, 0.0, 0.1])
    rows, bounds = all_rows(Q, grid, X_WO, np.zeros(6))
    kept, slowed = all_rows(Q, grid, X_WO, np.zeros(6), extra_clearance=0.04)
    np.testing.assert_array_equal(kept, rows)
    left = -bounds  # gain 1
    near = (left > 0.0) & (left < 0.05)
    assert near.any() and not near.all()
    np.testing.assert_allclose(-slowed[near], 0.2 * left[near])
    np.testing.assert_allclose(-slowed[left > 0.05], left[left > 0.05] - 0.04)
    np.testing.assert_allclose(-slowed[left <= 0.0], left[left <= 0.0])


def test_of_too_many_rows_the_most_urgent_stay(grid):
    """The ball lies in the open hand; each row keeps its bound, and their order."""
    X_WO, V_WO = at(forward_kinematics(Q, GRIPPER.X_FG)[:3, 3]), np.full(6, 0.1)
    rows, bounds = all_rows(Q, grid, X_WO, V_WO)
    assert len(rows) > MOST_OBJECT_ROWS
    urgent = np.sort(np.argsort(-bounds)[:MOST_OBJECT_ROWS])
    kept = all_rows(Q, grid, X_WO, V_WO, MOST_OBJECT_ROWS)
    np.testing.assert_array_equal(kept[0], rows[urgent])
    np.testing.assert_array_equal(kept[1], bounds[urgent])
    enough = all_rows(Q, grid, X_WO, V_WO, len(rows))
    np.testing.assert_array_equal(enough[0], rows)


@pytest.mark.parametrize("direction", [[0, 0, -0.3], [0.2, 0, -0.2], [0, 0.2, -0.2]])
def test_a_hand_that_is_led_through_the_object_does_not_touch_it(safety, grid, direction):
    """The ball lies below the palm or beside a finger; without the rows the hand goes through."""
    X_WG = forward_kinematics(Q, GRIPPER.X_FG)
    X_WO = at(X_WG[:3, 3] + 0.32 * np.array(direction))
    change = OPTIONS.period * OPTIONS.acceleration_scale * IIWA_7.acceleration_limits
    nearest = {}
    for moving in (None, MovingObject(grid, X_WO, np.zeros(6))):
        q, last, gaps = Q, np.zeros(7), []
        for _ in range(300):
            J = pose_and_jacobian(q, GRIPPER.X_FG)[1]
            V = np.concatenate([np.zeros(3), direction])
            qd = safety.velocity(q, np.zeros(7), J, V, qd_last=last, moving=moving)
            assert (np.abs(qd - last) <= change * (1 + 1e-9)).all()
            q, last = q + OPTIONS.period * qd, qd
            gaps.append(gap(q, X_WO))
        nearest[moving is None] = min(gaps)
    assert nearest[True] < -0.005
    assert nearest[False] > -0.001


def test_a_hand_that_comes_at_full_speed_can_still_brake(safety, grid):
    """From so far away that the grid does not reach there, the palm first."""
    X_WG = forward_kinematics(Q, GRIPPER.X_FG)
    X_WO = at(X_WG[:3, 3] + [0.0, 0.35, -0.02])
    for moving, lowest in ((None, -0.1), (MovingObject(grid, X_WO, np.zeros(6)), -0.001)):
        q, last, gaps = Q, np.zeros(7), []
        for _ in range(250):
            J = pose_and_jacobian(q, GRIPPER.X_FG)[1]
            V = np.array([0.0, 0.0, 0.0, 0.0, 1.5, 0.0])
            last = safety.velocity(q, np.zeros(7), J, V, qd_last=last, moving=moving)
            q = q + OPTIONS.period * last
            gaps.append(gap(q, X_WO))
        assert (min(gaps) < -0.005) == (moving is None)
        assert min(gaps) > lowest


def test_the_forearm_keeps_off_too(safety, grid):
    """Joint 1 swings the arm past a ball beside the forearm, where the hand does not come."""
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(IIWA_7.chain, Q, R, p)
    middle = 0.5 * (p[4] + p[6])  # between elbow and wrist
    turn = se3.so3_exp([0.0, 0.0, 0.5])
    X_WO = at(turn @ middle)
    balls = arm_balls(capsule_model(GRIPPER, with_hand=False))

    def arm_gap(q):
        link_poses_kernel(IIWA_7.chain, q, R, p)
        centers = np.einsum("kij,kj->ki", R[balls.link], balls.center) + p[balls.link]
        return (np.linalg.norm(centers - X_WO[:3, 3], axis=1) - balls.radius).min() - RADIUS

    nearest = {}
    for moving in (None, MovingObject(grid, X_WO, np.zeros(6))):
        q, last, gaps = Q, np.zeros(7), []
        for _ in range(200):
            last = safety.velocity(q, np.eye(7)[0], qd_last=last, moving=moving)
            q = q + OPTIONS.period * last
            gaps.append(arm_gap(q))
        nearest[moving is None] = min(gaps)
    assert nearest[True] < -0.02
    assert nearest[False] > 0.01


def test_a_hand_at_rest_gives_way_to_the_object(safety, grid):
    """A ball comes at 0.1 m/s from the side; the table and the arm itself come first."""
    X_WG = forward_kinematics(Q, GRIPPER.X_FG)
    velocity = np.array([0.0, 0.1, 0.0])
    start = X_WG[:3, 3] - 1.5 * velocity
    q, last = Q, np.zeros(7)
    for k in range(500):
        X_WO = at(start + k * OPTIONS.period * velocity)
        moving = MovingObject(grid, X_WO, np.concatenate([np.zeros(3), velocity]))
        last = safety.velocity(q, np.zeros(7), qd_last=last, moving=moving)
        q = q + OPTIONS.period * last
        assert gap(q, X_WO) > -0.002
        assert min(min_distance(q), table_distances(q).min()) > 0.0097
    assert np.abs(q - Q).max() > 0.05


def test_an_object_that_presses_the_hand_onto_the_table_does_not_win(safety, grid):
    q, last, velocity = Q, np.zeros(7), np.array([0.0, 0.0, -0.15])
    start = forward_kinematics(Q, GRIPPER.X_FG)[:3, 3] + [0.0, 0.0, 0.12]
    change = OPTIONS.period * OPTIONS.acceleration_scale * IIWA_7.acceleration_limits
    for k in range(600):
        X_WO = at(start + k * OPTIONS.period * velocity)
        moving = MovingObject(grid, X_WO, np.concatenate([np.zeros(3), velocity]))
        qd = safety.velocity(q, np.zeros(7), qd_last=last, moving=moving)
        assert (np.abs(qd - last) <= change * (1 + 1e-9)).all()
        q, last = q + OPTIONS.period * qd, qd
        assert min(min_distance(q), table_distances(q).min()) > 0.0097


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_object_that_is_nowhere_is_not_there(safety, grid, bad):
    request = np.full(7, 0.1)
    free = safety.velocity(Q, request)
    for X_WO, V_WO in ((at([bad, 0, 0]), np.zeros(6)), (at([0, 0, 0.3]), np.full(6, bad))):
        lost = safety.velocity(Q, request, moving=MovingObject(grid, X_WO, V_WO))
        np.testing.assert_array_equal(lost, free)
