"""What a scenario's faults make of the object in the cell."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object, make_motion
from feasigrasp.systems.from_scenario import make_station

FILE = diagram_path("dynamic.scenarios.yaml")


def cell(faults, hold):
    """A cell without cameras whose arm stands still, and its scenario."""
    scenario = load_scenario(
        FILE,
        "ReachLinearMocap",
        f"{{object: {{model: ball}}, carrier: {{release_delay: 0}}, faults: {faults}}}",
    )
    scenario.cameras = {}
    station = make_station(scenario)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    state = np.concatenate([scenario.start, np.zeros(7)])
    station.GetInputPort("arm.desired_state").FixValue(context, state)
    station.GetInputPort("gripper.position").FixValue(context, [0.085])
    station.GetInputPort("object.hold").FixValue(context, [float(hold)])
    return station, simulator, scenario


def velocity(station, simulator):
    port = station.GetOutputPort("object.velocity")
    return port.Eval(simulator.get_context()).translational()


def test_a_pull_acts_on_what_is_let_go_for_its_time():
    """Newton: gravity, and force over mass while the fault is there; in 0.1 s it hits nothing."""
    faults = "[!ObjectPulled {start: 0.04, duration: 0.02, force: [3.0, -2.0, 1.0]}]"
    station, simulator, scenario = cell(faults, hold=False)
    mass = load_scenario_object(scenario).mass
    simulator.AdvanceTo(0.04)
    np.testing.assert_allclose(velocity(station, simulator), [0, 0, -9.81 * 0.04], atol=1e-6)
    simulator.AdvanceTo(0.1)
    expected = np.array([3.0, -2.0, 1.0]) * 0.02 / mass + [0.0, 0.0, -9.81 * 0.1]
    np.testing.assert_allclose(velocity(station, simulator), expected, rtol=1e-6, atol=1e-6)


def test_nothing_pulls_at_an_object_that_is_carried():
    station, simulator, scenario = cell("[!ObjectPulled {duration: .inf}]", hold=True)
    simulator.AdvanceTo(0.5)
    X_WO = station.GetOutputPort("object.pose").Eval(simulator.get_context()).GetAsMatrix4()
    np.testing.assert_allclose(X_WO, make_motion(scenario).pose(0.5), atol=1e-3)


@pytest.mark.parametrize(
    "fault", ["!ObjectPace {start: 0.3, ramp: 0.1}", "!ObjectMoved {to: [0.6, 0.2, 0.7]}"]
)
def test_the_object_is_carried_along_its_altered_motion(fault):
    station, simulator, scenario = cell(f"[{fault}]", hold=True)
    expected, plain = make_motion(scenario), make_motion(replace(scenario, faults=[]))
    for t in (0.2, 0.6, 1.2):
        simulator.AdvanceTo(t)
        X_WO = station.GetOutputPort("object.pose").Eval(simulator.get_context()).GetAsMatrix4()
        np.testing.assert_allclose(X_WO, expected.pose(t), atol=2e-3)
    assert np.abs(expected.pose(1.2) - plain.pose(1.2)).max() > 0.02
