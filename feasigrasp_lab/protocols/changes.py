"""Changes of scenarios, for protocols and studies."""

from __future__ import annotations

from collections.abc import Callable

from feasigrasp.scenario.schema import Scenario

#: Changes a scenario, whose seed is set by then.
Change = Callable[[Scenario], None]


def unchanged(scenario: Scenario) -> None:
    """Leaves a scenario as its file has it."""


def both(first: Change, second: Change) -> Change:
    """One change after the other."""

    def change(scenario: Scenario) -> None:
        first(scenario)
        second(scenario)

    return change
