"""Reads and writes scenarios as YAML."""

import copy
import functools
import os
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from feasigrasp.errors import ScenarioError
from feasigrasp.inputs import compose_yaml
from feasigrasp.models.arguments import checked
from feasigrasp.models.choices import SAFE, mode_names, nearest
from feasigrasp.models.objects.rigid_object import builtin_objects
from feasigrasp.models.robot.arm_file import arm_names, load_arm
from feasigrasp.models.robot.gripper_file import GRIPPERS
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.checks import check_scenario
from feasigrasp.scenario.keys import check_keys, find, replace_former_keys
from feasigrasp.scenario.modes import added_mode
from feasigrasp.scenario.schema import Scenario


def with_paths_from(folder: Path, scenario: Scenario) -> Scenario:
    """The scenario with absolute paths, those of the given one starting at a folder.

    Those are the models and directives of ``directives``, ``file`` of ``cell.meshes``, ``arm``,
    ``gripper``, ``object.model`` and ``distractor.model``. A name of ours, a URI such as
    ``package://...``, and an absolute path stay what they are.

    Raises:
        ScenarioError: The directives, or the meshes of the cell, name a file that there is not.
    """
    scenario, folder = copy.deepcopy(scenario), folder.resolve()
    for i, directive in enumerate(scenario.directives):
        for key in ("add_model", "add_directives"):
            part = getattr(directive, key)
            if part is not None and part.file and "://" not in part.file:
                file = _existing(folder, part.file, f"directives[{i}].{key}.file")
                part.file = f"file://{file}"
    for name, mesh in scenario.cell.meshes.items():
        if mesh.file:
            mesh.file = str(_existing(folder, mesh.file, f"cell.meshes.{name}.file"))
    scenario.arm = _from(folder, scenario.arm, arm_names())
    scenario.gripper = _from(folder, scenario.gripper, GRIPPERS)
    for body in (scenario.object, scenario.distractor):
        body.model = _from(folder, body.model, builtin_objects())
    return scenario


def _existing(folder: Path, file: str, key: str) -> Path:
    path = folder / file
    if not path.is_file():
        raise ScenarioError(f"{key} is {file!r}, but there is no file {path}; correct the path")
    return path


def _from(folder: Path, name: str, ours: Collection[str]) -> str:
    """A name of ours, or a word that may be a misspelt one; of anything else the path."""
    path = folder / name
    is_path = "/" in name or path.suffix or os.path.isfile(path)
    return str(path) if name and name not in ours and is_path else name


#: The file of the packaged scenarios.
PACKAGED = "dynamic.scenarios.yaml"


def scenario_names(filename: str | Path) -> list[str]:
    """The names of the scenarios in a file; those that start with ``_`` are shared anchors."""
    return _names(_nodes(filename))


def only_scenario(filename: str | Path) -> str:
    """The name of the scenario of a file; a ScenarioError if it has more than one, or none."""
    names = scenario_names(filename)
    if len(names) != 1:
        has = f"{len(names)} scenarios: {', '.join(names)}; name one" if names else "no scenario"
        raise ScenarioError(f"{filename} has {has}")
    return names[0]


@checked(ScenarioError)
def load_scenario(
    scenario: str | Path, *texts: str | None, base: Scenario | None = None
) -> Scenario:
    """Reads one scenario; keys that it does not give have the defaults of its control mode.

    A packaged one by its name, or one of a file::

        load_scenario("ReachLinear")
        load_scenario("ReachLinear", "{object: {model: mug}}")
        load_scenario("own.scenarios.yaml", "Mine", "{object: {model: mug}}")

    Paths in it start at the file, those in ``overrides`` at the working directory. A scenario of a
    file may say ``based_on:`` with the name of a packaged one, which holds where it gives no value.
    Motions of packaged ones shrink for an arm of less reach than the iiwa 7's.

    Args:
        scenario: Name of a packaged scenario, as ``feasigrasp scenarios`` lists them. Or a YAML
            file that maps names to scenarios: a ``Path``, or a text that ends in .yaml or .yml.
        *texts: Behind a file the name of the scenario. Then YAML texts that are applied on top, one
            after the other; None for none. Maps are merged; ``"{camera_noise: {}}"`` empties one.
        base: What holds where the file gives no value; the defaults of the schema if None.

    Raises:
        ScenarioError: Unknown file, scenario, key or value.
    """
    filename, name, *overrides = _place(scenario, *texts)
    nodes = _nodes(filename)
    names = _names(nodes)
    if name not in names:
        raise ScenarioError(
            f"no scenario {name!r} in {filename}; it has {', '.join(names)}"
            f"{'; give a file by --scenario-file' if _is_file(name) else nearest(name, names)}"
        )
    changed = [f"scenario {name!r} as changed by {_shortened(text)}" for text in overrides]
    changes: list[yaml.Node] = []
    for what, text in zip(changed, overrides, strict=True):
        with _named(what):
            changes.append(compose_yaml(text, ScenarioError))
    with _named(what := f"scenario {name!r} in {filename}"):
        node = copy.deepcopy(nodes[name])
        packaged = _taken_base(node, base)
        first = _load(node, _defaults([node, *changes], packaged or base or Scenario()))
        stages = [(what, with_paths_from(Path(filename).parent, first))]
    for what, change in zip(changed, changes, strict=True):
        with _named(what):
            stages.append((what, with_paths_from(Path(), _load(change, stages[-1][1]))))
    wrong = _wrong_with(stages[-1][1])
    if wrong is not None:
        # The first to say so is named: what came after may have nothing to do with it.
        what = next(stage for stage, scenario in stages if _wrong_with(scenario) == wrong)
        raise ScenarioError(f"{what}: {wrong}")
    if Path(filename) == diagram_path(PACKAGED):
        packaged = stages[0][1]
    if packaged is not None:
        _shrink_motion(stages[-1][1], packaged)
    return stages[-1][1]


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Puts what is read in front of errors."""
    try:
        yield
    except ScenarioError as error:
        raise ScenarioError(f"{what}: {error}") from error


def _taken_base(node: yaml.Node, base: Scenario | None) -> Scenario | None:
    """The packaged scenario that ``based_on`` names, itself on ``base``; the key is taken out."""
    named = find(node, "based_on")
    if named is None:
        return None
    check_keys(named, str, ("based_on",))
    _drop(node, named)
    return load_scenario(str(named.value), base=base)


def _drop(root: yaml.Node, dropped: yaml.Node) -> None:
    """Takes a value out of a tree, and out of what is merged into it."""
    root.value = [(key, value) for key, value in root.value if value is not dropped]
    for key, value in root.value:
        if key.value == "<<":
            _drop(value, dropped)


def _shrink_motion(scenario: Scenario, first: Scenario) -> None:
    """Shrinks what a packaged scenario says of the motion, for an arm of less reach than its own.

    Values that were given on top stay.
    """
    share = min(1.0, load_arm(scenario.arm).reach / IIWA_7.reach)
    for name in ("center", "amplitude", "size", "spread") if share < 1.0 else ():
        value = getattr(scenario.motion, name, None)
        if value is not None and value == getattr(first.motion, name, None):
            height = value[2] if name == "center" else share * value[2]
            setattr(scenario.motion, name, [share * value[0], share * value[1], height])


@checked(ScenarioError)
def dump_scenario(scenario: Scenario) -> str:
    """The scenario as YAML text, with every value in force; `parse_scenario` reads it."""
    return str(yaml_dump_typed(scenario, schema=Scenario))


def parse_scenario(text: str) -> Scenario:
    """Reads what `dump_scenario` wrote, e.g. the ``scenario_yaml`` of a result file."""
    with _named("not a scenario"):
        root = compose_yaml(text, ScenarioError)
        scenario = _load(root, _defaults([root], Scenario()))
        check_scenario(scenario)
    return scenario


def _place(scenario: str | Path, *texts: str | None) -> tuple[str, ...]:
    """File and name of a scenario, and what is applied on top; arguments as `load_scenario`."""
    if not _is_file(scenario):
        return (str(diagram_path(PACKAGED)), str(scenario), *filter(None, texts))
    name = only_scenario(scenario) if not texts else str(texts[0])
    return (str(scenario), name, *filter(None, texts[1:]))


def _is_file(scenario: str | Path) -> bool:
    return isinstance(scenario, Path) or str(scenario).endswith((".yaml", ".yml"))


def _wrong_with(scenario: Scenario) -> str | None:
    """What is wrong with the values of a scenario."""
    try:
        check_scenario(scenario)
    except ScenarioError as error:
        return str(error)
    return None


def _names(nodes: Iterable[str]) -> list[str]:
    return [name for name in nodes if not name.startswith("_")]


def _nodes(filename: str | Path) -> dict[str, yaml.Node]:
    """What a file has under each name."""
    try:
        text = Path(filename).read_text()
    except FileNotFoundError as error:
        raise ScenarioError(f"no scenario file {filename}; check --scenario-file") from error
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{filename} cannot be read: {error}") from error
    try:
        return _composed(text)
    except ScenarioError as error:
        raise ScenarioError(f"{filename} is {error}") from error


@functools.lru_cache(maxsize=4)
def _composed(text: str) -> dict[str, yaml.Node]:
    """What a text has under each name, read-only: the next call returns the same."""
    nodes = {key.value: value for key, value in compose_yaml(text, ScenarioError).value}
    for key in nodes.keys() & {"based_on", *Scenario.__dataclass_fields__}:
        raise ScenarioError(
            f"no map of names to scenarios: {key} is a key of one; give a name above it, as in "
            f"Mine: {{{key}: ...}}"
        )
    return nodes


def _defaults(nodes: Iterable[yaml.Node], base: Scenario) -> Scenario:
    """``base`` with the defaults of the control mode, that of the last tree that gives one."""
    given = [found for node in nodes if (found := find(node, "control", "mode")) is not None]
    mode = str(given[-1].value) if given else SAFE
    added = added_mode(mode) if mode in mode_names() else None  # refused when all is read
    if added is None:
        return base
    filled = copy.deepcopy(base)
    added.fill(filled)
    return filled


def _load(node: yaml.Node, defaults: Scenario) -> Scenario:
    """Reads the tree of a scenario, or of changes of ``defaults``."""
    replace_former_keys(node, defaults)
    motion = find(node, "motion")  # without a tag it changes that of the defaults
    if motion is not None and motion.tag == "tag:yaml.org,2002:map":
        motion.tag = f"!{type(defaults.motion).__name__}"
    check_keys(node, Scenario)
    text = yaml.serialize(node, Dumper=yaml.SafeDumper)
    try:
        # Drake merges maps, so that an empty one would change nothing.
        defaults = copy.deepcopy(defaults)
        _empty(defaults, yaml.load(text, Loader=yaml.BaseLoader))
        return yaml_load_typed(schema=Scenario, data=text, defaults=defaults)
    except Exception as error:  # Drake's reader takes much for granted
        raise ScenarioError(str(error) or type(error).__name__) from error


def _empty(value: Any, given: Any) -> None:
    """Empties the maps of a part of a scenario for which an empty one is given."""
    inner = value if isinstance(value, dict) else getattr(value, "__dict__", {})
    for key, each in given.items() if isinstance(given, dict) else ():
        part = inner.get(key)
        # Not an entry of ``camera_noise``: a camera without changes keeps the errors it has.
        if each == {} and isinstance(part, dict) and inner is not value:
            part.clear()
        _empty(part, each)


def _shortened(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 60 else f"{line[:60]}..."
