"""Runs that constants were chosen on, apart from those that none was chosen on."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from feasigrasp.models.objects.rigid_object import builtin_objects
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.results.statistics import grouped

#: Where both kinds are in one summary, the presets of runs that constants were chosen on begin so.
TUNED = "tuned:"


def is_tuned(run_name: str, model: str, seed: int) -> bool:
    """Whether constants were chosen on a run, by ``tuned.yaml``.

    Args:
        run_name: Name of its scenario, with the suffix of a study.
        model: Its object, a name or a file.
        seed: Its seed.
    """
    entry = next(each for each in _entries() if fnmatch(run_name, each["runs"]))
    inside = any(first <= seed <= last for first, last in entry["seeds"])
    return inside and Path(model).stem in entry["objects"]


@cache
def _entries() -> list[dict[str, Any]]:
    text = resources.files("feasigrasp_lab.protocols").joinpath("tuned.yaml").read_text()
    entries: list[dict[str, Any]] = yaml.safe_load(text)
    for entry in entries:
        names = [entry["objects"]] if isinstance(entry["objects"], str) else entry["objects"]
        builtin = builtin_objects() if "builtin" in names else []
        entry["objects"] = {*builtin, *names} - {"builtin"}
    return entries


def rows_apart(
    records: Sequence[dict[str, Any]], make: Callable[[Sequence[dict[str, Any]]], list[Row]]
) -> list[Row]:
    """Rows of both kinds of runs, with `Row.tuned`; no row is of both.

    If there are both kinds, the presets of one begin with `TUNED`.
    """
    parts = grouped(records, lambda run: is_tuned(run["scenario"], run["object"], run["seed"]))
    rows = []
    for tuned, part in sorted(parts.items()):
        prefix = TUNED if tuned and len(parts) > 1 else ""
        rows += [replace(row, preset=prefix + row.preset, tuned=tuned) for row in make(part)]
    return rows
