"""A scene on a grid: against the true distance of a box, and an arm that must not touch it."""

import numpy as np
import pytest

from feasigrasp.models.arrays import record
from feasigrasp.models.control.safety.problem import ArmState, Body, rows_kernel
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.robot.capsule_kernels import link_poses_kernel
from feasigrasp.models.robot.capsules import arm_balls, capsule_model
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.models.shape.grids import obstacle_grid
from feasigrasp.models.shape.scene_field import fit_scene
from feasigrasp_lab.arm import IIWA_CAPSULES
from tests.truths import capsule_ends_kernel

HOME = np.array([0, -0.846, 0, -1.582, 0, 1.446, 0])
CENTRE, HALF = np.array([0.45, 0.0, 0.25]), np.array([0.06, 0.15, 0.12])
OPTIONS = SafetyOptions()


def box_distance(x):
    """Signed distance to the box, shape (m,)."""
    outside = np.abs(x - CENTRE) - HALF
    return np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0)


@pytest.fixture(scope="module")
def box():
    """The field of the box, seen from outside all around."""
    rng = np.random.default_rng(0)
    points, views = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            face = rng.uniform(-1, 1, (4000, 3))
            face[:, axis] = sign
            points.append(CENTRE + face * HALF)
            views.append(np.tile(sign * np.eye(3)[axis], (4000, 1)))
    return fit_scene(np.concatenate(points), np.concatenate(views))


@pytest.fixture(scope="module")
def grid(box):
    return obstacle_grid(box)


def test_it_is_the_distance_of_the_box(grid):
    rng = np.random.default_rng(1)
    x = CENTRE + rng.uniform(-0.4, 0.4, (4000, 3))
    truth = box_distance(x)
    distance, _ = grid.distance_and_gradient(x)
    near, far = (truth > 0.02) & (truth < 0.35), truth > 0.45
    error = distance[near] - truth[near]
    assert np.abs(error).max() < 0.01 and np.median(np.abs(error)) < 0.003
    np.testing.assert_allclose(distance[far], 0.4, atol=1e-6)
    assert (distance[(truth < -0.01) & (truth > -0.04)] < 0).all()


def test_between_field_and_transform_there_is_no_step(grid):
    """Along rays from the faces outwards the distance grows as the way does."""
    for axis in range(3):
        way = np.arange(0.02, 0.2, 0.002)
        x = (
            CENTRE
            + 0.5 * HALF * (np.arange(3) != axis)
            + (way[:, None] + HALF[axis]) * np.eye(3)[axis]
        )
        distance, _ = grid.distance_and_gradient(x)
        np.testing.assert_allclose(np.diff(distance), 0.002, atol=0.0015)


def test_gradients_by_finite_differences(grid):
    rng = np.random.default_rng(2)
    x = CENTRE + rng.uniform(-0.3, 0.3, (300, 3))
    # Not across a face between two voxels, where the slope changes.
    share = (x - grid.frame[:3]) / grid.frame[3] % 1.0
    x = x[((share > 0.01) & (share < 0.99)).all(axis=1)]
    _, gradient = grid.distance_and_gradient(x)
    step = 1e-4
    for axis in range(3):
        ahead = grid.distance_and_gradient(x + step * np.eye(3)[axis])[0]
        behind = grid.distance_and_gradient(x - step * np.eye(3)[axis])[0]
        np.testing.assert_allclose((ahead - behind) / (2 * step), gradient[:, axis], atol=1e-4)


def test_outside_the_grid_nothing_is_near(grid):
    x = np.array([[5.0, 0, 0], [0, -5.0, 0], [0, 0, 9.0], [0, 0, -9.0], [np.nan, 0, 0]])
    distance, gradient = grid.distance_and_gradient(x)
    np.testing.assert_array_equal(distance, grid.frame[4])
    np.testing.assert_array_equal(gradient, 0.0)


def all_rows(q, grid, bound=1e6):
    """Every row and the distance it is for: between bounds this wide all of them are kept."""
    model = capsule_model()
    balls = arm_balls(model)
    most = len(model.pairs) + 2 * len(model.movers) + len(balls.link)
    rows, bounds = np.empty((most + 1, 7)), np.empty(most + 1)
    geometry = (
        model.chain,
        model.link,
        model.ends,
        model.radius,
        model.pairs,
        model.movers,
        *balls[1:],
    )
    body = Body(*geometry, np.empty((0, 3)))
    wide = np.full(7, bound)
    options = SafetyOptions(clearance=0.0, obstacle_clearance=0.0, approach_gain=1.0)
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(IIWA_7.chain, q, R, p)
    arm = ArmState(IIWA_7.chain, R, p, -wide, wide)
    m = rows_kernel(arm, record(options)[0], body, grid.values, grid.frame, rows, bounds)
    return rows[:m], -bounds[:m]


def test_rows_by_finite_differences(grid):
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(40):
        q = HOME + rng.uniform(-0.5, 0.5, 7)
        rows, distance = all_rows(q, grid)
        step = 1e-6
        central = np.empty_like(rows)
        for j in range(7):
            shift = step * np.eye(7)[j]
            ahead, behind = all_rows(q + shift, grid)[1], all_rows(q - shift, grid)[1]
            if not len(ahead) == len(behind) == len(rows):
                break  # a row without any effect, or a ball at the rim of the grid
            central[:, j] = (ahead - behind) / (2 * step)
        else:
            # Kinks: where the closest ends change, or a ball moves on to the next voxel.
            smooth = np.abs(central - rows).max(axis=1) < 1e-4
            assert smooth.mean() > 0.97
            checked += 1
    assert checked > 25


def test_rows_agree_with_the_scene_field(box, grid):
    """Distances of the grid and of the field itself, ball by ball."""
    balls = arm_balls(IIWA_CAPSULES)
    rng = np.random.default_rng(4)
    for _ in range(10):
        q = HOME + rng.uniform(-0.6, 0.6, 7)
        R, p = np.empty((8, 3, 3)), np.empty((8, 3))
        link_poses_kernel(IIWA_7.chain, q, R, p)
        center = np.einsum("kij,kj->ki", R[balls.link], balls.center) + p[balls.link]
        expected = box.distance(center) - balls.radius
        near = (expected > 0.0) & (expected < 0.19)
        _, distance = all_rows(q, grid)
        found = distance[-len(balls.link) :]
        if len(found) == len(balls.link) and near.any():
            np.testing.assert_allclose(found[near], expected[near], atol=0.012)


def capsule_clearance(q, model):
    """Least distance of the moving capsules from the box, by points along their segments."""
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(q, model, ends)
    share = np.linspace(0.0, 1.0, 41)[:, None]
    return min(
        (box_distance(ends[c, 0] + share * (ends[c, 1] - ends[c, 0])) - model.radius[c]).min()
        for c in model.movers
    )


REQUESTS = {
    "through": lambda k: np.array([0, 0, 0, 1.0, 0, -0.3]),
    "down": lambda k: np.array([0, 0, 0, 0.2, 0, -1.0]),
    "sweep": lambda k: np.array([0, 0, 0, 0.0, np.sign(np.sin(k / 150)), -0.4]),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_no_capsule_touches_the_box(grid, name):
    """Five seconds of twists that lead the hand into the box, at up to 1 m/s."""
    model, safety = capsule_model(), SafetyFilter(OPTIONS)
    change = OPTIONS.period * OPTIONS.acceleration_scale * IIWA_7.acceleration_limits
    q, last, nearest = np.array([0.3, -0.5, 0.0, -1.5, 0.0, 1.2, 0.0]), np.zeros(7), np.inf
    for k in range(1000):
        J = pose_and_jacobian(q)[1]
        qd = safety.velocity(q, np.zeros(7), J, REQUESTS[name](k), qd_last=last, obstacles=grid)
        assert (np.abs(qd - last) <= change * (1 + 1e-9)).all()
        q, last = q + OPTIONS.period * qd, qd
        nearest = min(nearest, capsule_clearance(q, model))
    assert 0.0 < nearest < 0.03  # it came close, and no closer


def test_without_the_grid_the_same_requests_lead_into_the_box():
    model, safety = capsule_model(), SafetyFilter(OPTIONS)
    q, last, nearest = np.array([0.3, -0.5, 0.0, -1.5, 0.0, 1.2, 0.0]), np.zeros(7), np.inf
    for k in range(600):
        J = pose_and_jacobian(q)[1]
        last = safety.velocity(q, np.zeros(7), J, REQUESTS["down"](k), qd_last=last)
        q = q + OPTIONS.period * last
        nearest = min(nearest, capsule_clearance(q, model))
    assert nearest < -0.02
