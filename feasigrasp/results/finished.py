"""Parts of an evaluation that need not be done again when its command is repeated."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.rows import Row, write_json


def finish_part(
    filename: Path, settings: dict[str, Any], measure: Callable[[], Sequence[Row]]
) -> list[Row]:
    """The rows of one part, from its file if that was made with the same settings and code.

    Args:
        filename: JSON file of the part.
        settings: What the rows depend on, e.g. the seed.
        measure: Makes the rows.
    """
    key = {"git": git_revision(), "versions": versions(), **settings}
    try:
        content = json.loads(filename.read_text())
        if content["key"] == json.loads(json.dumps(key)):
            rows = [Row(**row) for row in content["rows"]]
            dirty = ": uncommitted changes cannot be told apart" if _is_dirty(key["git"]) else ""
            print(f"{filename} is finished already{dirty}")
            return rows
    except (FileNotFoundError, json.JSONDecodeError, KeyError, TypeError):
        pass  # not there, or not one of ours: measure
    rows = list(measure())
    write_json({"key": key, "rows": [asdict(row) for row in rows]}, filename)
    return rows


def finished_records(filename: Path, key: dict[str, Any]) -> list[dict[str, Any]] | None:
    """The records in a file, if the same code made them in the same way.

    Args:
        filename: JSON file with the entries ``key`` and ``records``.
        key: What the records depend on: revision, versions and settings.

    Returns:
        The records; None if there is no such file, if it was made with another key, or if it is not
        one of ours.
    """
    try:
        content = json.loads(filename.read_text())
        if content["key"] != json.loads(json.dumps(key)):
            return None
        records: list[dict[str, Any]] = content["records"]
    except (FileNotFoundError, json.JSONDecodeError, KeyError, TypeError):
        return None
    return records


def _is_dirty(revision: str | None) -> bool:
    return (revision or "").endswith("-dirty")
