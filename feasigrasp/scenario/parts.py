"""Custom parts of a scenario: ``package.module:Name``, with keyword arguments."""

import dataclasses as dc
import importlib
import os
import sys
import typing
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import nearest, parse_word


class Part(StrEnum):
    """Replaceable parts, with the arguments of their constructors."""

    SAMPLER = "sampler"  # the gripper
    CONTROLLER = "controller"  # the reachability
    TRACKER = "tracker"  # the scenario's tracker
    PREDICTOR = "predictor"  # the scenario's tracker
    PERCEPTION = "perception"  # the scenario's perception
    SEGMENTATION = "segmentation"  # the camera that is looked through
    MOTION = "motion"  # the motion that the scenario describes


#: Settings by name.
Options = dict[str, typing.Union[bool, int, float, str]]  # noqa: UP007 - Drake's YAML


@dc.dataclass
class PartConfig:
    """A custom part.

    Attributes:
        name: Where its class or function is: ``package.module:Name``, importable from where the
            command runs.
        options: Keyword arguments of it.
    """

    name: str = ""
    options: Options = dc.field(default_factory=dict)


def check_parts(parts: Mapping[str, PartConfig]) -> None:
    """Raises a ScenarioError if a part is none that can be replaced, or names nothing.

    Nothing is imported: reading a scenario runs no code of others. `make_named` does, for a run.
    """
    for key, part in parts.items():
        parse_word(Part, key, "parts", ScenarioError)
        _split(_where(key, part), part.name)


def load_part(key: str, part: PartConfig) -> Callable[..., Any]:
    """The class or function that a part names, see `load_named`; ``key`` says which part."""
    return load_named(_where(key, part), part.name)


def load_named(where: str, given: str) -> Callable[..., Any]:
    """The class or function that ``package.module:Name`` names; ``where``, for messages.

    Raises:
        ScenarioError: There is no such module, or nothing of that name in it that can be called.
    """
    module_name, name = _split(where, given)
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # behind all that is installed
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ScenarioError(
            f"{where} cannot be imported: {error}; run from the folder that holds it, or install it"
        ) from error
    found = getattr(module, name, None)
    if not callable(found):
        known = [each for each in vars(module) if not each.startswith("_")]
        raise ScenarioError(f"{where}: {module_name} has no such class{nearest(name, known)}")
    return typing.cast(Callable[..., Any], found)


def _where(key: str, part: PartConfig) -> str:
    return f"parts.{key}.name: {part.name!r}"


def _split(where: str, given: str) -> tuple[str, str]:
    """Module and name of ``package.module:Name``."""
    module_name, colon, name = given.partition(":")
    if not (colon and module_name and name) or module_name.startswith("."):
        raise ScenarioError(f"{where} is not of the form package.module:Name")
    return module_name, name


def make_named(key: str, part: PartConfig, given: Any) -> Any:
    """Result of a part's class or function for ``given`` and its options, or a ScenarioError."""
    try:
        return load_part(key, part)(given, **part.options)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"parts.{key}: {part.name} cannot be made: {error}") from error
