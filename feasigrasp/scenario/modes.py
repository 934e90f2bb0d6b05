"""Control modes that packages add beside ``safe``, the mode of this package."""

from typing import Any, Protocol

from pydrake.systems.framework import LeafSystem

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import SAFE, mode_names, parse_word
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.plugins import load_plugin
from feasigrasp.scenario.schema import Scenario


class Mode(Protocol):
    """A mode that enforces no limits: what it changes, and which systems it has of its own."""

    def fill(self, scenario: Scenario) -> None:
        """Sets the keys that have other values in this mode where a scenario gives none."""

    def check(self, scenario: Scenario) -> None:
        """Raises ScenarioError where ``control.options`` is wrong."""

    def make_controller(self, scenario: Scenario, reachability: Reachability) -> Any:
        """The `GraspController` of ``controller: task`` or ``joint``."""

    def make_drive(self, scenario: Scenario) -> LeafSystem:
        """A system with the ports of `VelocityDrive`."""


def added_mode(name: str) -> Mode | None:
    """The mode that a package adds; None for ``safe``, a ScenarioError for an unknown one."""
    if parse_word(mode_names(), name, "control.mode", ScenarioError) == SAFE:
        return None
    return load_plugin("modes", name)
