"""Finished work units, for the resumption of a command."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from feasigrasp.errors import InputError
from feasigrasp.inputs import read_arrays, read_json
from feasigrasp.outputs import replacing, write_json
from feasigrasp.runs.results.provenance import git_revision
from feasigrasp_lab.results.workers import in_processes, made_with

Record = dict[str, Any]


def read_finished(filename: Path, wanted: Mapping[str, Any]) -> dict[str, Any] | None:
    """What a JSON file holds, if it has the entries that are wanted; else None."""
    try:
        content = read_json(filename)
    except InputError:
        return None
    same = isinstance(content, dict) and all(
        key in content and content[key] == value
        for key, value in json.loads(json.dumps(wanted)).items()
    )
    return content if same else None


def finish_all(
    items: Mapping[str, Any],
    folder: Path,
    settings: Mapping[str, Any],
    measure: Callable[..., Sequence[Record]],
    *,
    jobs: int,
    desc: str,
) -> list[Record]:
    """The records of items, in their order; made in processes, with a bar, a file for each item.

    Args:
        items: What is measured, by name.
        folder: Where the files are.
        settings: Further arguments of ``measure``.
        measure: Makes the records of one item, ``measure(name, item, **settings)``; a number that
            is not finite is null in the file.
        jobs: Processes at a time.
        desc: What the bar is called.
    """
    keys = {name: {**made_with(), **settings, "item": item} for name, item in items.items()}
    files = {name: folder / f"{name}.json" for name in items}
    missing = [name for name in items if read_finished(files[name], {"key": keys[name]}) is None]
    report_reuse(len(items) - len(missing), len(items), folder)
    tasks = [(files[n], keys[n], partial(measure, n, items[n], **settings)) for n in missing]
    with tqdm(total=len(items), initial=len(items) - len(missing), desc=desc) as bar:
        for _ in in_processes(_finish, tasks, jobs):
            bar.update()
    return [record for name in items for record in read_json(files[name])["records"]]


def _finish(filename: Path, key: Mapping[str, Any], make: Callable[[], Sequence[Record]]) -> None:
    records = [{name: _plain(value) for name, value in r.items()} for r in make()]
    write_json({"key": key, "records": records}, filename)


def write_arrays(filename: str | Path, arrays: Mapping[str, Any]) -> None:
    """Writes an ``npz`` file: one of its name is a whole one."""
    with replacing(filename) as file:
        np.savez_compressed(file, **arrays)


def read_shard(filename: Path, names: Iterable[str]) -> dict[str, Any]:
    """Arrays of a file that `write_arrays` wrote, in the order of their names.

    Raises:
        InputError: It is cut off, or holds something else.
    """
    try:
        content = read_arrays(filename)
        return {name: content[name] for name in names}
    except (InputError, KeyError) as error:
        raise InputError(
            f"{filename} is no shard of this version ({error}); delete it, and the same command "
            "makes it again"
        ) from error


def read_shards(files: Iterable[Path], names: Sequence[str]) -> dict[str, Any]:
    """The arrays of several files one after the other, see `read_shard`."""
    shards = [read_shard(file, names) for file in files]
    return {name: np.concatenate([shard[name] for shard in shards]) for name in names}


def make_shards(
    files: Sequence[Path], make: Callable[[Path, int], None], *, jobs: int, desc: str
) -> list[Path]:
    """Makes the shards that are not there yet, with a progress bar.

    Args:
        files: Where they are, in the order of their numbers.
        make: Makes one, from its file and number, unless there is nothing to put into it.
        jobs: Processes at a time.
        desc: What the bar is called.

    Returns:
        Those that are there in the end.
    """
    missing = [(file, number) for number, file in enumerate(files) if not file.exists()]
    there = len(files) - len(missing)
    with tqdm(total=len(files), initial=there, desc=desc, unit="shard") as bar:
        for _ in in_processes(make, missing, jobs):
            bar.update()
    return [file for file in files if file.exists()]


def report_reuse(kept: int, total: int, folder: Path) -> None:
    """Says how much of the work is there already."""
    if kept:
        print(f"{kept} of {total} are finished already in {folder}")
        if (git_revision() or "").endswith("-dirty"):
            print(
                "  uncommitted changes cannot be distinguished: use a new --out after changing code"
            )


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
