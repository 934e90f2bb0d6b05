"""The simulated arm follows what it is sent without overshooting it."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from feasigrasp.models.control.safety.velocity_limits import drive_step_kernel
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.motion_limits import WINDOW, true_accelerations
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.systems.station.cell_models import StationConfig
from feasigrasp.systems.station.station import Station

SPEED = 0.8


def followed(config, source, until, period):
    """True joint velocities (n, 7) [rad/s] of an arm that is sent its desired state by a source."""
    builder = DiagramBuilder()
    motion = make_motion(load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap"))
    station = builder.AddSystem(Station(config, load_object("mug"), motion))
    sent = builder.AddSystem(source)
    builder.Connect(sent.get_output_port(), station.GetInputPort("arm.desired_state"))
    for port, value in (("gripper.position", [0.085]), ("object.hold", [1.0])):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), station.GetInputPort(port))
    log = LogVectorOutput(station.GetOutputPort("arm.velocity_estimated"), builder, period)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(until)
    return log.FindLog(simulator.get_context()).data().T


def velocity_peaks(joint: int, q_start: np.ndarray) -> np.ndarray:
    """Largest speeds, over the limits, of a joint sent up to `SPEED` and back."""
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap")
    config = StationConfig(scenario.plant_config, scenario.directives, cameras={}, q_start=q_start)
    top = SPEED * IIWA_7.velocity_limits[joint]
    ramp = top / (0.95 * IIWA_7.acceleration_limits[joint])
    times = np.array([0.0, ramp, ramp + 0.3, 2.0 * ramp + 0.3])
    velocity = np.zeros((7, 4))
    velocity[joint, 1:3] = top
    position = np.tile(q_start[:, None], (1, 4))
    position[joint] += top * np.array([0.0, 0.5 * ramp, 0.5 * ramp + 0.3, ramp + 0.3])
    path = PiecewisePolynomial.CubicHermite(times, position, velocity)  # exact: it is quadratic
    speeds = np.abs(followed(config, TrajectorySource(path, 1), 2.0 * ramp + 0.6, 0.005))
    return np.asarray(speeds.max(axis=0) / IIWA_7.velocity_limits)


@pytest.mark.parametrize("joint", range(IIWA_7.joints))
def test_no_joint_exceeds_its_limit_after_the_hardest_start(joint):
    """With the arm stretched out, where inertias are largest."""
    peaks = velocity_peaks(joint, np.deg2rad([0.0, 60.0, 0.0, -20.0, 0.0, 20.0, 0.0]))
    assert 0.98 * SPEED < peaks[joint] < 1.15 * SPEED


#: Steps of the plant [s], of the drive in steps of the plant, and of the metric's window.
STEP, PERIOD, WINDOW_STEPS = 0.0025, 2, round(WINDOW / 0.0025)


@pytest.fixture(scope="module")
def cell():
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap")
    config = StationConfig(
        scenario.plant_config, scenario.directives, cameras={}, q_start=np.zeros(7)
    )
    return Station(config, load_object("mug"), make_motion(scenario)).plant


def mass_matrix(plant, q):
    """Of the arm's joints, by Drake, in which rotors and hand are."""
    context, arm = plant.CreateDefaultContext(), plant.GetModelInstanceByName(IIWA_7.name)
    first = plant.GetJointByName(IIWA_7.joint_names[0]).velocity_start()
    plant.SetPositions(context, arm, q)
    return plant.CalcMassMatrix(context)[first : first + 7, first : first + 7]


def response(M, steps=400):
    """Mean accelerations over the window after one commanded in each joint for one period.

    By ``M dv = dt (Kd (v_d - v) + Kp (q_d - q))``, implicit in v and q, as the plant steps;
    shape (steps, 7, 7): when, of which joint, to which joint's command.
    """
    kp, kd = IIWA_7.kp[:, None], IIWA_7.kd[:, None]
    inverse = np.linalg.inv(M + np.diag(STEP * IIWA_7.kd + STEP**2 * IIWA_7.kp))
    q, v, q_d = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((7, 7))
    v_d, velocity = np.eye(7) * PERIOD * STEP, [v] * WINDOW_STEPS
    for step in range(steps):
        if step % PERIOD == 0:
            q_d = q_d + PERIOD * STEP * v_d
        velocity.append(v)
        v = inverse @ (M @ v + STEP * (kd * v_d + kp * (q_d - q)))
        q = q + STEP * v
    velocity = np.array([*velocity, v])
    return (velocity[WINDOW_STEPS:] - velocity[:-WINDOW_STEPS]) / (WINDOW_STEPS * STEP)


def test_the_share_of_the_accelerations_is_what_the_servo_overshoots(cell):
    """The gain from the largest command to the largest acceleration: the sum of the response.

    It is reached by commands that switch with the sign of the response, so no smaller share would
    do at the worst of these configurations, and the share sent is one over the worst.
    """
    rng, limit = np.random.default_rng(0), IIWA_7.upper
    A, gains = IIWA_7.acceleration_limits, []
    for q in rng.uniform(-limit, limit, size=(60, 7)):
        after = np.abs(response(mass_matrix(cell, q)))
        each = (after[first::PERIOD].sum(axis=0) @ A / A for first in range(PERIOD))
        gains.append(max(float(gain.max()) for gain in each))
    assert 0.98 < IIWA_7.acceleration_share * max(gains) <= 1.0


def test_the_hardest_commands_keep_the_true_acceleration():
    """Every joint, through the drive, at full acceleration to and fro, first this or that way."""
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap")
    q = np.deg2rad([0.0, 60.0, 0.0, -20.0, 0.0, 20.0, 0.0])
    config = StationConfig(scenario.plant_config, scenario.directives, cameras={}, q_start=q)
    rng, period, n = np.random.default_rng(0), PERIOD * STEP, 400
    there = rng.choice([-5.0, 5.0], (n // 16, 7))
    switches = np.repeat(np.stack([there, -there], axis=1).reshape(-1, 7), 8, axis=0)
    desired, v = [np.concatenate([q, 0.0 * q])], np.zeros(7)
    for command in switches[:n]:
        q_next, v_next = np.empty(7), np.empty(7)
        drive_step_kernel(IIWA_7.chain, q, v, command, q, (period, 0.1, 1.0), q_next, v_next)
        q, v = q_next, v_next
        desired.append(np.concatenate([q, v]))
    times = period * np.arange(n + 1)
    sent = PiecewisePolynomial.ZeroOrderHold(times, np.array(desired).T)
    velocity = followed(config, TrajectorySource(sent), times[-1], STEP)
    share = np.abs(true_accelerations(velocity, STEP)) / IIWA_7.acceleration_limits
    assert 0.95 < share.max() <= 1.0
