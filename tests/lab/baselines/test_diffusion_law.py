"""Down the energy of grasp diffusion: on a ball, whose grasps are known, and in what units."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp_lab.baselines.diffusion_energy import LENGTH
from feasigrasp_lab.baselines.grasp_diffusion import LAST_TIME, load_grasp_diffusion
from feasigrasp_lab.baselines.grasp_diffusion_controller import (
    DiffusedField,
    diffusion_velocity,
)
from feasigrasp_lab.paper.options import Law, PaperOptions

X_FG = ParallelGripper().X_FG
HOME = np.deg2rad([10.0, -40.0, 5.0, -95.0, 5.0, 75.0, 10.0])
STILL = np.zeros(6)
RADIUS = 0.03


@pytest.fixture(scope="module")
def energy():
    return DiffusedField().of(fit_gpdf(sphere_points(128, RADIUS)), load_grasp_diffusion())


def test_a_hand_far_away_is_led_to_a_grasp_of_a_ball(energy):
    """The closing line passes the middle within 20 degrees of both normals, as of few poses."""
    rng, good = np.random.default_rng(2), 0
    for _ in range(6):
        X, field = se3.random_pose(rng, 1)[0], energy
        X[:3, 3] = -0.3 * X[:3, 2]
        for step in range(120):
            field = field.cooled(X) if step % 2 == 0 else field
            X = X @ se3.exp(0.25 * field.way(X))
        assert field.time == LAST_TIME
        along = X[:3, 3] @ X[:3, 0]
        beside = np.linalg.norm(X[:3, 3] - along * X[:3, 0])
        good += beside < RADIUS * np.sin(np.deg2rad(20.0))
    assert good >= 5


def test_far_from_the_grasps_noise_rises_again(energy):
    near = se3.make_pose(np.eye(3), np.zeros(3))
    cold = energy
    for _ in range(50):
        cold = cold.cooled(near)
    far = se3.make_pose(np.eye(3), [0.0, 0.0, -0.6])
    warm = cold
    for _ in range(50):
        warm = warm.cooled(far)
    assert cold.time < 0.01
    assert warm.time > 2.0 * cold.time


def _cold(energy):
    for _ in range(60):
        energy = energy.cooled(se3.make_pose(np.eye(3), np.zeros(3)))
    assert energy.time == LAST_TIME
    return energy


REACH = Reachability()
#: A hand that has the ball between its fingers, nearly in the middle.
AT_BALL = se3.make_pose(se3.so3_exp([0.1, 0.2, 0.0]), [0.004, 0.003, -0.002])


def _arriving(field, X_OH):
    return field.arriving(X_OH, HOME, forward_kinematics(HOME, X_FG) @ se3.inverse(X_OH), REACH)


def test_where_the_energy_ends_is_a_grasp_across_the_middle_of_a_ball(energy):
    found = _arriving(_cold(energy), AT_BALL)
    assert len(found.arrival) == 1 and found.grasp
    assert found.arrival.payload_score.tolist() == [
        1.0
    ]  # else those of others would be lost beside it
    X_OG, width = found.arrival.X_OG[0], found.arrival.width[0]
    # Centred on the closing line: its middle is as far from the ball's as the line is.
    assert abs(X_OG[:3, 3] @ X_OG[:3, 0]) < 1e-3
    beside = np.linalg.norm(X_OG[:3, 3])
    assert beside < RADIUS * np.sin(np.deg2rad(20.0))
    assert width == pytest.approx(2.0 * np.sqrt(RADIUS**2 - beside**2), abs=2e-3)
    np.testing.assert_array_equal(found.grasp.X_OG, X_OG)
    again = _arriving(found, AT_BALL @ se3.exp(np.array([0.02, 0, 0, 0, 0, 0.01])))
    assert again.arrival is found.arrival


def test_a_grasp_of_the_energy_is_left_when_the_hand_or_the_object_goes_away(energy):
    found = _arriving(_cold(energy), AT_BALL)
    away = AT_BALL @ se3.make_pose(np.eye(3), [0.0, 0.0, -0.1])
    far = se3.make_pose(np.eye(3), [3.0, 0.0, 0.5])
    for left in (_arriving(found, away), found.arriving(AT_BALL, HOME, far, REACH)):
        assert len(left.arrival) == 0 and not left.grasp


def test_while_there_is_noise_there_is_no_grasp_of_the_energy(energy):
    assert len(_arriving(energy, AT_BALL).arrival) == 0


def test_the_same_field_is_encoded_once(energy):
    assert energy.of(energy.gpdf, None) is energy
    other = fit_gpdf(sphere_points(64, 0.02))
    assert energy.of(other, load_grasp_diffusion()).diffused is not energy.diffused


@pytest.mark.parametrize("law", list(Law))
def test_the_joints_move_the_hand_down_the_energy(energy, law):
    """J qd is the twist that was asked for: the gradient in radians and units of the energy."""
    X_WH = forward_kinematics(HOME, X_FG)
    X_OH = se3.make_pose(se3.so3_exp([0.3, -0.2, 0.4]), [0.01, 0.0, -0.02])
    X_WO = X_WH @ se3.inverse(X_OH)
    options = PaperOptions(law=law, gain=0.01, damping=0.0)
    qd, J, V = diffusion_velocity(HOME, energy, X_WO, STILL, X_FG, options)
    np.testing.assert_allclose(J @ qd, V, atol=1e-9)
    slope = energy.diffused.gradient(X_OH[None], LAST_TIME if law == Law.GRADIENT else 1.0)[0]
    slope[3:] *= LENGTH**2
    if law == Law.PRECONDITIONED:
        slope *= 0.75 / (2.0 * np.log(2.0))  # the variance at time 1
    body = np.concatenate([X_WH[:3, :3].T @ V[:3], X_WH[:3, :3].T @ V[3:]])
    np.testing.assert_allclose(body, -0.01 * slope, rtol=1e-4, atol=1e-7)


def test_the_objects_twist_is_added_if_it_is_fed_forward(energy):
    V_WO = np.array([0.0, 0.0, 0.2, 0.05, 0.0, 0.0])
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    twists = [
        diffusion_velocity(HOME, energy, X_WO, V_WO, X_FG, PaperOptions(feed_forward=fed))[2]
        for fed in (True, False)
    ]
    X_WH = forward_kinematics(HOME, X_FG)
    lever = X_WH[:3, 3] - X_WO[:3, 3]
    carried = np.concatenate([V_WO[:3], V_WO[3:] + np.cross(V_WO[:3], lever)])
    np.testing.assert_allclose(twists[0] - twists[1], carried, atol=1e-9)


@pytest.mark.parametrize("unknown", ["energy", "pose", "twist"])
def test_what_is_not_known_is_no_reason_to_move(energy, unknown):
    X_WO, V_WO, field = np.eye(4), STILL, energy
    if unknown == "energy":
        field = DiffusedField()
    elif unknown == "pose":
        X_WO = np.full((4, 4), np.nan)
    else:
        V_WO = np.full(6, np.nan)
    options = PaperOptions()
    qd, _, V = diffusion_velocity(HOME, field, X_WO, V_WO, X_FG, options)
    np.testing.assert_array_equal(qd, np.zeros(7))
    np.testing.assert_array_equal(V, np.zeros(6))
