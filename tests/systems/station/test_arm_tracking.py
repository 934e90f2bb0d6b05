"""The simulated arm follows what it is sent without overshooting it."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.systems.station.cell_models import ARM_KD, ARM_KP, StationConfig
from feasigrasp.systems.station.station import Station

SPEED = 0.8


def velocity_peaks(joint: int, q_start: np.ndarray) -> np.ndarray:
    """Largest speeds, over the limits, of a joint sent up to `SPEED` and back."""
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap")
    config = StationConfig(scenario.plant_config, scenario.directives, cameras={}, q_start=q_start)
    builder = DiagramBuilder()
    station = builder.AddSystem(Station(config, load_object("mug"), make_motion(scenario)))
    top = SPEED * IIWA_7.velocity_limits[joint]
    ramp = top / (0.95 * IIWA_7.acceleration_limits[joint])
    times = np.array([0.0, ramp, ramp + 0.3, 2.0 * ramp + 0.3])
    velocity = np.zeros((7, 4))
    velocity[joint, 1:3] = top
    position = np.tile(q_start[:, None], (1, 4))
    position[joint] += top * np.array([0.0, 0.5 * ramp, 0.5 * ramp + 0.3, ramp + 0.3])
    path = PiecewisePolynomial.CubicHermite(times, position, velocity)  # exact: it is quadratic
    sent = builder.AddSystem(TrajectorySource(path, 1))
    builder.Connect(sent.get_output_port(), station.GetInputPort("iiwa.desired_state"))
    for port, value in (("gripper.position", [0.085]), ("object.hold", [1.0])):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), station.GetInputPort(port))
    log = LogVectorOutput(station.GetOutputPort("iiwa.state_estimated"), builder, 0.005)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(2.0 * ramp + 0.6)
    speeds = np.abs(log.FindLog(simulator.get_context()).data()[7:])
    return np.asarray(speeds.max(axis=1) / IIWA_7.velocity_limits)


@pytest.mark.parametrize("joint", range(IIWA_7.joints))
def test_no_joint_exceeds_its_limit_after_the_hardest_start(joint):
    """With the arm stretched out, where inertias are largest."""
    peaks = velocity_peaks(joint, np.deg2rad([0.0, 60.0, 0.0, -20.0, 0.0, 20.0, 0.0]))
    assert 0.98 * SPEED < peaks[joint] < 1.15 * SPEED


def test_joints_are_damped_at_any_inertia():
    """Each by itself, by Drake's mass matrix, in which the rotors are."""
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap")
    config = StationConfig(
        scenario.plant_config, scenario.directives, cameras={}, q_start=np.zeros(7)
    )
    plant = Station(config, load_object("mug"), make_motion(scenario)).plant
    context, arm = plant.CreateDefaultContext(), plant.GetModelInstanceByName(IIWA_7.name)
    first = plant.GetJointByName(IIWA_7.joint_names[0]).velocity_start()
    rng, limit = np.random.default_rng(0), IIWA_7.position_limits
    inertia = np.zeros(7)
    for q in rng.uniform(-limit, limit, size=(2000, 7)):
        plant.SetPositions(context, arm, q)
        M = plant.CalcMassMatrix(context)
        inertia = np.maximum(inertia, np.diag(M)[first : first + 7])
    assert (ARM_KD / (2.0 * np.sqrt(ARM_KP * inertia))).min() > 2.0 / 3.0
