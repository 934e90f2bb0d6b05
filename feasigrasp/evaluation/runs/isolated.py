"""Runs a scenario in a process of its own.

A diagram with Python systems is never freed (11 MB each), and a crash in compiled code takes its
process along: one process per run settles both. The processes are forked from one server that has
imported everything and built a diagram before, which saves each of them several seconds.
"""

from __future__ import annotations

import json
import multiprocessing
import multiprocessing.connection
import os
import signal
import tempfile
import threading
import traceback
from functools import cache
from pathlib import Path
from typing import Any

from feasigrasp.evaluation.runs.run import crash_record, run, write_result
from feasigrasp.results.rows import write_json
from feasigrasp.scenario.files import dump_scenario, parse_scenario
from feasigrasp.scenario.schema import Scenario


def run_isolated(
    scenario: Scenario, name: str, filename: Path, *, replay: Path | None = None
) -> dict[str, Any]:
    """Runs a scenario in its own single-threaded process and writes its record.

    However the process ends, there is a record: one that did not finish has its ``error``, and its
    grasp counts as not held. All processes run the code, and name the revision, that was there when
    the first of them started.

    Args:
        scenario: What to run.
        name: Its name, for the record.
        filename: Where the record goes, as JSON.
        replay: Where a self-contained HTML replay goes; None for none.

    Returns:
        The record, as `feasigrasp.evaluation.runs.run.run` makes it.
    """
    filename = filename.resolve()  # the server may be in another folder
    replay = None if replay is None else replay.resolve()
    filename.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory(prefix="feasigrasp-run-") as scratch:
        messages = Path(scratch) / "messages.txt"
        process = _server().Process(
            target=_run_to_file,
            args=(dump_scenario(scenario), name, filename, replay, messages),
            daemon=True,
        )
        process.start()
        process.join()
        if filename.exists():
            record: dict[str, Any] = json.loads(filename.read_text())
            return record
        last = messages.read_text(errors="replace")[-2000:].strip() if messages.exists() else ""
    error = f"the process ended with status {process.exitcode}: {last}"
    record = crash_record(scenario, name, error)
    write_json(record, filename)
    return record


@cache
def _server() -> multiprocessing.context.ForkServerContext:
    """Starts processes from one that has loaded `feasigrasp.evaluation.runs.isolated_server`."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["feasigrasp.evaluation.runs.isolated_server"])
    return context


def _run_to_file(
    scenario_text: str, name: str, filename: Path, replay: Path | None, messages: Path
) -> None:
    """The process: runs a scenario and writes its record; file ``messages`` gets what it prints."""
    stdout, stderr = 1, 2
    os.dup2(os.open(os.devnull, os.O_WRONLY), stdout)
    os.dup2(os.open(messages, os.O_WRONLY | os.O_CREAT), stderr)
    tempfile.tempdir = str(messages.parent)  # forked processes do not tidy up: the parent does
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, see the next line
    threading.Thread(target=_end_with_parent, daemon=True).start()
    scenario = parse_scenario(scenario_text)
    try:
        write_result(run(scenario, name, replay=replay), filename)
    except Exception as error:
        traceback.print_exc()
        write_json(crash_record(scenario, name, f"{type(error).__name__}: {error}"), filename)


def _end_with_parent() -> None:
    """Ends the process as soon as its parent is gone, however that went."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
