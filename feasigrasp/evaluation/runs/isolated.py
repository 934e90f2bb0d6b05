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
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import joblib
from tqdm import tqdm

from feasigrasp.evaluation.runs.plan import PlannedRun
from feasigrasp.evaluation.runs.run import crash_record, run
from feasigrasp.results.finished import Record, made_with, read_finished, report_reuse
from feasigrasp.results.rows import write_json
from feasigrasp.scenario.files import dump_scenario, parse_scenario
from feasigrasp.scenario.schema import Scenario


def run_all(
    runs: Sequence[PlannedRun], folder: Path, jobs: int, *, desc: str, replays: bool = False
) -> list[Record]:
    """Runs what is not finished, each in a process of its own, and returns all records in order.

    A record in the folder counts if it came from the same scenario (object, seed, controller and
    mode included), revision and versions, and if its process did not crash. The threads only wait
    for the processes; joblib's ``parallel_config`` can send the runs to a cluster instead.

    Args:
        runs: What to run.
        folder: Where the records are, ``<id>.json``.
        jobs: Processes at a time.
        desc: What the progress bar is called.
        replays: Whether every run leaves a replay ``<id>.html`` as well.
    """
    code = made_with()
    folder.mkdir(parents=True, exist_ok=True)

    def is_finished(planned: PlannedRun) -> bool:
        text = dump_scenario(planned.scenario)
        wanted = code | {"scenario": planned.name, "scenario_yaml": text}
        record = read_finished(folder / f"{planned.id}.json", wanted)
        if record is None or (replays and not (folder / f"{planned.id}.html").exists()):
            return False
        return record.get("timings", {}).get("wall_s") is not None

    missing = [planned for planned in runs if not is_finished(planned)]
    outdated = sum((folder / f"{planned.id}.json").exists() for planned in missing)
    if outdated:
        print(f"{outdated} results are from another revision or setting, or crashed: run again")
    report_reuse(len(runs) - len(missing), len(runs), folder)
    work = joblib.Parallel(jobs, prefer="threads", return_as="generator_unordered")(
        joblib.delayed(run_isolated)(
            planned.scenario,
            planned.name,
            folder / f"{planned.id}.json",
            replay=folder / f"{planned.id}.html" if replays else None,
        )
        for planned in missing
    )
    with tqdm(total=len(runs), initial=len(runs) - len(missing), unit="run", desc=desc) as bar:
        for record in work:
            bar.update()
            if record["error"]:
                bar.write(f"{record['scenario']}, {record['object']}: {record['error'][:200]}")
    # From the files: they are what a later command finds too.
    return [json.loads((folder / f"{planned.id}.json").read_text()) for planned in runs]


def run_isolated(
    scenario: Scenario, name: str, filename: Path, *, replay: Path | None = None
) -> Record:
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
            record: Record = json.loads(filename.read_text())
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
        write_json(run(scenario, name, replay=replay).record, filename)
    except Exception as error:
        traceback.print_exc()
        write_json(crash_record(scenario, name, f"{type(error).__name__}: {error}"), filename)


def _end_with_parent() -> None:
    """Ends the process as soon as its parent is gone, however that went."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
