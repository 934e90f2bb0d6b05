"""Runs of an earlier command that need not be repeated."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from feasigrasp.evaluation.runs.plan import PlannedRun
from feasigrasp.results.provenance import versions
from feasigrasp.scenario.files import dump_scenario

Record = dict[str, Any]


def finished_records(
    runs: Sequence[PlannedRun], folder: Path, revision: str | None
) -> dict[str, Record]:
    """The records in a folder that need no repetition, by id of the run.

    A record counts if it came from the same scenario (object, seed, controller and mode included),
    the same revision of the code and the same versions, and if its process did not crash.
    """
    expected = {"git": revision, "versions": versions()}
    finished = {}
    for planned in runs:
        try:
            record = json.loads((folder / f"{planned.id}.json").read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            continue
        wanted = expected | {
            "scenario": planned.name,
            "scenario_yaml": dump_scenario(planned.scenario),
        }
        crashed = record.get("timings", {}).get("wall_s") is None
        if not crashed and all(record.get(key) == value for key, value in wanted.items()):
            finished[planned.id] = record
    return finished
