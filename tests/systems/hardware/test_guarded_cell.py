"""A guard of a cell: requests lead neither into the arm itself nor into what stands there."""

import pickle

import numpy as np
import pytest

from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.robot.capsules import arm_balls, capsule_model
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.hardware.guard import make_guarded_cell
from tests.truths import min_distance, table_distances

T = 0.005
START = np.array([0.1, -0.5, 0.2, -1.2, 0.0, 1.0, 0.3])
BALLS = arm_balls(capsule_model())
#: Of the hand [rad/s; m/s].
DOWN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.6])
#: A box in front of the arm, beyond its reach at `START`.
BOX = "cell: {boxes: {shelf: {size: [0.1, 0.8, 0.4], position: [0.75, 0.0, 0.2]}}}"


def guarded(speed, more=""):
    text = f"{{control: {{speed: {speed}}}, {more}}}"
    return make_guarded_cell(
        load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", None, text)
    )


def followed(guard, request, seconds):
    """Positions (k, 7) [rad] of an arm that is where it was sent."""
    q, sent = START.copy(), []
    for k in range(round(seconds / T)):
        command = guard.command(k * T, q, q, k * T)
        guard.request(k * T, request(k * T))
        q = q if command is None else command
        sent.append(q)
    v = np.diff(sent, axis=0, prepend=[START]) / T
    assert (np.abs(v) <= IIWA_7.velocity_limits * (1 + 1e-9)).all()
    assert (np.abs(np.diff(v, axis=0)) <= T * IIWA_7.acceleration_limits * (1 + 1e-6)).all()
    return np.array(sent)


def clearance(q):
    return min(min_distance(q), table_distances(q).min())


def straight(goal, speed):
    """Positions on the straight way to a goal over time, at most as fast as is allowed."""
    needed = np.max(np.abs(goal - START) / (0.8 * speed * np.array(IIWA_7.velocity_limits)))
    return lambda t: START + np.clip((t - 0.5) / needed, 0.0, 1.0) * (goal - START), needed


@pytest.mark.parametrize("speed", [1.0, 0.3])
@pytest.mark.parametrize("seed", range(8))
def test_no_request_leads_into_the_arm_itself_or_the_table(seed, speed):
    rng, limit = np.random.default_rng(seed), IIWA_7.upper - 0.1
    goal = START
    while clearance(goal) > -0.03:
        goal = rng.uniform(-limit, limit)
    request, needed = straight(goal, speed)
    cell = pickle.loads(pickle.dumps(guarded(speed)))  # as it goes to the guard's process
    sent = followed(cell.make_guard(), request, needed + 1.5)
    asked = [request(t) for t in np.linspace(0.5, 0.5 + needed, 50)]
    assert min(map(clearance, asked)) < -0.03
    assert min(map(clearance, sent[::4])) > cell.options.clearance - 3e-4  # see docs/safety.md


def test_clearances_change_nothing_of_what_keeps_twice_as_much():
    """A controller's safety filter leads the arm down to the table."""
    theirs, q, v, asked = SafetyFilter(SafetyOptions(speed=0.5)), START.copy(), np.zeros(7), []
    for _ in range(round(3.0 / T)):
        J = pose_and_jacobian(q, WSG_50.X_FG)[1]
        v = theirs.velocity(q, np.zeros(7), J, DOWN, qd_last=v)
        q = q + T * v
        asked.append(q)

    def request(t):
        return START if t < 0.4 else asked[min(round((t - 0.4) / T), len(asked) - 1)]

    assert clearance(asked[-1]) < 0.022
    kept, plain = (
        followed(guard, request, 3.5) for guard in (guarded(0.5).make_guard(), CommandGuard(T, 0.5))
    )
    np.testing.assert_allclose(kept, plain, atol=1e-9)


def test_bodies_of_the_cell_are_kept_clear_of():
    cell = guarded(1.0, BOX)
    half, center = np.array([0.05, 0.4, 0.2]), np.array([0.75, 0.0, 0.2])

    def room(q):
        """Of the balls that cover the arm, from the box by its closed form [m]."""
        outside = np.abs(BALLS.placed(q) - center) - half
        inside = np.minimum(outside.max(axis=1), 0.0)
        return np.min(np.linalg.norm(np.maximum(outside, 0.0), axis=1) + inside - BALLS.radius)

    request, needed = straight(np.array([0.0, 0.9, 0.0, -0.8, 0.0, 1.2, 0.0]), 1.0)
    assert min(room(request(t)) for t in np.linspace(0.5, 0.5 + needed, 50)) < -0.03
    sent = followed(cell.make_guard(), request, needed + 1.5)
    # Half of the 2 cm, less what the grid is exact to around a box.
    assert min(room(q) for q in sent[::4]) > 0.0
    assert room(sent[-1]) < 0.1 < room(START)
