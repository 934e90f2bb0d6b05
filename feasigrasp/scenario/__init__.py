"""Scenarios: the YAML format of what is run."""

from feasigrasp.scenario.files import dump_scenario, load_scenario
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.scenario.schema import Scenario

__all__ = ["Scenario", "dump_scenario", "load_scenario", "make_motion"]
