"""Writes ``docs/api.md``: public names, scenario keys, command options, metrics; and a schema.

Run ``python tools/make_docs.py`` after a change of any of them; a test compares page and code.
"""

from __future__ import annotations

import argparse
import dataclasses as dc
import json
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from inspect import cleandoc
from pathlib import Path
from types import ModuleType

from feasigrasp import cli
from feasigrasp.models.choices import Span
from feasigrasp.models.sensors.camera_errors import HandEyeError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.runs.metrics.table import METRICS, UNITLESS
from feasigrasp.scenario.cell import BoxConfig, MeshConfig
from feasigrasp.scenario.parts import PartConfig
from feasigrasp.scenario.schema import BezierPath, Scenario
from tools.run_schema import run_schema

ROOT = Path(__file__).resolve().parents[1]
#: Of one run's result file.
SCHEMA = ROOT / "feasigrasp" / "runs" / "run.schema.json"
HEAD = """# Reference

Public names, [scenario keys](#scenario-keys), [command options](#command-options) and
[metrics](#metrics).
`python tools/make_docs.py` writes this page from the code.
"""
NAMES = """## Public names

Names of `feasigrasp` are also in the packages that define them. All other names may change without
notice. Docstrings have shapes, units, frames and errors.
"""
KEYS = """## Scenario keys

Defaults are those of mode `safe`. Keys of Drake's own schemas (`simulator_config`, `plant_config`,
`directives`, entries of `cameras`) are in Drake's documentation.
"""
OPTIONS = """## Command options

`feasigrasp COMMAND --help` has those of all other commands; `sim` takes most options of `run`.
"""
RUNS = """## Metrics

Of one run, from true positions. Samples are 20 ms apart over the whole run, ticks 5 ms. Approach is
the phase before the fingers close. [Result files](results_schema.md#limits) say how limits are
judged. Rows of many runs are `dynamic.<metric>` for the mean, and `dynamic.<row>`; means and shares
count every object once.

| metric | standard term and definition | many runs |
|---|---|---|
"""
#: Structures that stand below a name of the user's own, or that are chosen by a tag.
NESTED = {
    "cell.boxes.*": BoxConfig,
    "cell.meshes.*": MeshConfig,
    "camera_noise.*": (DepthNoise, HandEyeError),
    "motion: !BezierPath": BezierPath,
    "parts.*": PartConfig,
}
#: Sections whose schema is Drake's.
DRAKES = ("simulator_config", "plant_config", "directives", "cameras")
COMMANDS = ("run", "perceive")


def faces() -> list[str]:
    """Packages with public names, models first, in alphabetical order."""
    found = []
    for file in (ROOT / "feasigrasp").rglob("__init__.py"):
        if "__all__" in file.read_text():
            found.append(".".join(file.parent.relative_to(ROOT).parts))
    return sorted(found)


def summary(thing: object) -> str:
    """The first sentence of a docstring, on one line; the entries of a tuple of words."""
    if type(thing) is tuple:
        return ", ".join(str(each) for each in thing)
    text = (getattr(thing, "__doc__", None) or "").split("\n\n")[0]
    return " ".join(text.split())


def public_names() -> Iterator[str]:
    """A section for each package, without what the front door has."""
    front = import_module("feasigrasp").__all__
    for face in faces():
        module = import_module(face)
        rows = []
        for name in module.__all__:
            if name in front and face != "feasigrasp":
                continue
            thing = getattr(module, name)
            module_too = " (module)" if isinstance(thing, ModuleType) else ""
            rows.append(f"| `{name}`{module_too} | {summary(thing)} |\n")
        head = "| name | description |\n|---|---|\n"
        yield f"### `{face}`\n\n{summary(module)}\n\n{head}{''.join(rows)}"


def described(kind: type) -> dict[str, str]:
    """What the ``Attributes:`` of a docstring says of each field."""
    text = cleandoc(kind.__doc__ or "").partition("Attributes:")[2]
    found = re.findall(r"^ {4}(\w+): (.*?)(?=^ {4}\w+: |\Z)", text, re.DOTALL | re.MULTILINE)
    return {name: " ".join(meaning.split()).replace("``", "`") for name, meaning in found}


def key_rows(kind: type, default: object) -> Iterator[str]:
    """A row for each field of a dataclass."""
    meaning = described(kind)
    for field in dc.fields(kind):
        words = ", ".join(f"`{word}`" for word in field.metadata.get("words", ()))
        span = words or spanned(field.metadata.get("span"))
        value = shown(getattr(default, field.name))
        yield f"| `{field.name}` | {value} | {span} | {meaning.get(field.name, '')} |\n"


def spanned(span: Span | None) -> str:
    """A range with its unit; empty if there is none."""
    if span is None:
        return ""
    return f"{span.low:.4g} to {span.high:.4g} {span.unit}".strip()


def shown(value: object) -> str:
    """A default, as YAML has it."""
    if isinstance(value, list):
        return f"[{', '.join(map(shown, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value) if isinstance(value, int | str) else ""


def keys() -> Iterator[str]:
    """A table for each section of a scenario."""
    scenario = Scenario()
    head = "| key | default | values | meaning |\n|---|---|---|---|\n"
    meaning = described(Scenario)
    sections = {f.name: getattr(scenario, f.name) for f in dc.fields(Scenario)}
    plain = [name for name in sections if not is_section(sections[name]) and name not in DRAKES]
    yield head + "".join(r for r in key_rows(Scenario, scenario) if r.split("`")[1] in plain)
    for name, section in sections.items():
        if is_section(section):
            rows = list(key_rows(type(section), section))
            yield f"### `{name}`\n\n{meaning[name]}\n\n{head}{''.join(rows)}"
        for key, kinds in NESTED.items():
            if re.match(rf"{name}\b", key):
                each = kinds if isinstance(kinds, tuple) else (kinds,)
                rows = [row for kind in each for row in key_rows(kind, kind())]
                yield f"### `{key}`\n\n{head}{''.join(rows)}"


def is_section(value: object) -> bool:
    """Whether a value is a section of the scenario of our own, and not one of Drake's."""
    return dc.is_dataclass(value) and type(value).__module__.startswith("feasigrasp")


def options() -> Iterator[str]:
    """A table for each command."""
    for name in COMMANDS:
        module, purpose = cli.installed_commands().single[name]
        parser = cli.command_parser(f"feasigrasp {name}", purpose)
        import_module(module).add_arguments(parser)
        rows = [f"| {spelled(a)} | {explained(parser, a)} |\n" for a in parser._actions[1:]]
        table = f"\n| option | description |\n|---|---|\n{''.join(rows)}" if rows else ""
        yield f"### `feasigrasp {name}`\n\n{cli.sentence(purpose)}\n{table}"


def spelled(action: argparse.Action) -> str:
    """An option with what it takes."""
    value = action.metavar or ("" if action.nargs == 0 else action.dest.upper())
    value = " ".join(value) if isinstance(value, tuple) else value
    words = "/".join(map(str, action.choices or ())) or value
    return f"`{' '.join([*action.option_strings[:1], words]).strip()}`"


def explained(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """What ``--help`` says of an option."""
    formatter = parser._get_formatter()
    return formatter._expand_help(action).replace("|", "\\|")


def metrics() -> Iterator[str]:
    """A line for each metric of a run."""
    for name, metric in METRICS.items():
        unit = "" if metric.unit in UNITLESS else f" [{metric.unit}]"
        meaning = f"{metric.term}{unit}: {metric.meaning}"
        rows = ["mean"] if metric.averaged else []
        rows += [f"`{row.name}` ({row.over.name.lower()})" for row in metric.rows]
        yield f"| `{name}` | {meaning} | {', '.join(rows)}\n"


def page() -> str:
    """The whole page."""
    parts = [
        HEAD,
        NAMES,
        *public_names(),
        KEYS,
        *keys(),
        OPTIONS,
        *options(),
        RUNS + "".join(metrics()),
    ]
    return "\n".join(parts)


def main() -> int:
    """Writes page and schema."""
    (ROOT / "docs" / "api.md").write_text(page())
    SCHEMA.write_text(json.dumps(run_schema(), indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
