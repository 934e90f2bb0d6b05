"""The friction that is told is the one that the plant resolves contact with."""

import pytest

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.contact_friction import contact_friction

PADS = 0.8  # models/iiwa/gripper.urdf


@pytest.mark.parametrize("friction", [0.6, 0.05])
def test_it_is_that_of_both_surfaces(friction):
    """As Drake combines two coefficients: twice their product over their sum."""
    text = f"{{object: {{friction: {friction}}}}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinear", text)
    scenario.cameras = {}
    expected = 2.0 * friction * PADS / (friction + PADS)
    assert contact_friction(make_station(scenario)) == pytest.approx(expected)
