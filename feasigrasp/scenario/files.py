"""Reading scenarios from YAML, and writing them."""

import dataclasses as dc
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from feasigrasp.errors import ScenarioError
from feasigrasp.scenario.checks import check_scenario
from feasigrasp.scenario.presets import resolve
from feasigrasp.scenario.schema import Scenario

_YAML_ERRORS = (RuntimeError, ValueError, TypeError, KeyError, yaml.YAMLError)


def scenario_names(filename: str | Path) -> list[str]:
    """The names of the scenarios in a file; those that start with ``_`` are shared anchors.

    Raises:
        ScenarioError: There is no such file, or it is not YAML.
    """
    try:
        content = yaml.load(Path(filename).read_text(), Loader=yaml.BaseLoader)
    except FileNotFoundError as error:
        raise ScenarioError(f"no scenario file {filename}; check --scenario_file") from error
    except yaml.YAMLError as error:
        raise ScenarioError(f"{filename} is not valid YAML: {error}") from error
    return [name for name in content or {} if not name.startswith("_")]


def load_scenario(filename: str | Path, name: str, *overrides: str | None) -> Scenario:
    """Reads one scenario of a file; what it leaves to the control mode is filled in.

    Args:
        filename: YAML file that maps names to scenarios.
        name: Which one.
        *overrides: YAML texts that are applied on top, one after the other, e.g.
            ``"{object: {model: mug}}"``. Maps are merged; ``"{camera_noise: {}}"`` empties one.

    Raises:
        ScenarioError: Unknown file, scenario, key or value.
    """
    names = scenario_names(filename)
    if name not in names:
        raise ScenarioError(f"no scenario {name!r} in {filename}; it has {', '.join(names)}")
    what = f"scenario {name!r} in {filename}"
    scenario = _load(what, Scenario(), filename=str(filename), child_name=name)
    for text in filter(None, overrides):
        scenario = _load(what, scenario, data=text)
    scenario = resolve(scenario)
    check_scenario(scenario)
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """The scenario as YAML text, with every value in force; `parse_scenario` reads it.

    Raises:
        ScenarioError: There is no such control mode or controller.
    """
    return str(yaml_dump_typed(resolve(scenario), schema=Scenario))


def parse_scenario(text: str) -> Scenario:
    """Reads what `dump_scenario` wrote, e.g. the ``scenario_yaml`` of a result file.

    Raises:
        ScenarioError: Unknown key or value.
    """
    scenario = resolve(_load("not a scenario", Scenario(), data=text))
    check_scenario(scenario)
    return scenario


def _load(what: str, defaults: Scenario, **source: str) -> Scenario:
    try:
        # Drake merges maps, so that an empty one would change nothing.
        given = yaml.load(source.get("data", ""), Loader=yaml.BaseLoader)
        empty = {key for key, value in dict(given or {}).items() if value == {}}
        changes: dict[str, Any] = {
            key: {} for key, value in vars(defaults).items() if key in empty and type(value) is dict
        }
        defaults = dc.replace(defaults, **changes)
        return yaml_load_typed(schema=Scenario, defaults=defaults, **source)
    except _YAML_ERRORS as error:
        raise ScenarioError(f"{what}: {error}") from error
