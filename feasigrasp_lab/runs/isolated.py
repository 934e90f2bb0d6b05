"""Runs a scenario in an isolated process.

A diagram with Python systems is never freed (11 MB each), and a crash in compiled code takes its
process along: one process per run settles both. The processes are forked from one server that has
imported everything and built a diagram before, which saves each of them several seconds.
"""

import json
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path

import joblib
from tqdm import tqdm

from feasigrasp.errors import OutputError
from feasigrasp.outputs import check_folder, write_json
from feasigrasp.runs.results.interrupts import STATUS, Unfinished
from feasigrasp.runs.results.provenance import own_files
from feasigrasp.runs.run import crash_record, run
from feasigrasp.scenario.files import dump_scenario, parse_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.results.finished import Record, read_finished, report_reuse
from feasigrasp_lab.results.workers import made_with
from feasigrasp_lab.runs.plan import PlannedRun


def run_all(
    runs: Sequence[PlannedRun],
    folder: Path,
    jobs: int,
    *,
    desc: str,
    replays: bool = False,
    elsewhere: Sequence[Path] = (),
) -> list[Record]:
    """Runs what is not finished, each in a process of its own, and returns all records in order.

    A record in the folder counts if it came from the same scenario (object, seed, controller and
    mode included), files of the user's, revision and versions, and if its process did not crash. A
    run depends on its scenario and these files alone: the records are the same, but for times,
    whatever the number of processes.

    Args:
        runs: What to run.
        folder: Where the records are, ``<id>.json``.
        jobs: Processes at a time.
        desc: What the progress bar is called.
        replays: Whether every run leaves a replay ``<id>.html`` as well.
        elsewhere: Further folders whose records count, those of shards; they are copied.

    Raises:
        Unfinished: Ctrl-C, or a full disk; with the records of all runs that came to their end.
    """
    code = made_with()
    check_folder("--out", folder)
    folder.mkdir(parents=True, exist_ok=True)

    def finished(planned: PlannedRun) -> Record | None:
        text = dump_scenario(planned.scenario)
        wanted = code | {"scenario": planned.name, "scenario_yaml": text}
        wanted["files"] = own_files(planned.scenario)
        if replays and not (folder / f"{planned.id}.html").exists():
            return None
        for place in (folder, *elsewhere):
            record = read_finished(place / f"{planned.id}.json", wanted)
            if record and _is_whole(record, crash_record(planned.scenario, planned.name, "")):
                if place is not folder:
                    write_json(record, folder / f"{planned.id}.json")
                return record
        return None

    records = {planned.id: finished(planned) for planned in runs}
    missing = [planned for planned in runs if records[planned.id] is None]
    outdated = sum((folder / f"{planned.id}.json").exists() for planned in missing)
    if outdated:
        print(f"{outdated} results are from another revision or setting, or crashed: run again")
    report_reuse(len(runs) - len(missing), len(runs), folder)

    def here(planned: PlannedRun) -> tuple[str, Record]:
        replay = folder / f"{planned.id}.html" if replays else None
        file = folder / f"{planned.id}.json"
        return planned.id, run_isolated(planned.scenario, planned.name, file, replay=replay)

    # Threads are enough: they wait for processes.
    parallel = joblib.Parallel(jobs, prefer="threads", return_as="generator_unordered")

    with tqdm(total=len(runs), initial=len(runs) - len(missing), unit="run", desc=desc) as bar:
        try:
            for id_, record in parallel(joblib.delayed(here)(planned) for planned in missing):
                records[id_] = record
                bar.set_postfix_str(_held_so_far(records.values()), refresh=False)
                bar.update()
                if record["error"]:
                    bar.write(f"{record['scenario']}, {record['object']}: {record['error'][:200]}")
                if replays and not (folder / f"{id_}.html").exists():
                    bar.write(f"{id_}: there is no replay; is the disk full?")
        except (KeyboardInterrupt, Unfinished) as stopped:
            for process in multiprocessing.active_children():
                process.terminate()
            there = [record for record in records.values() if record is not None]
            raise _unfinished(stopped, there, len(runs)) from None
    found = (records[planned.id] for planned in runs)
    return [record for record in found if record is not None]


def _unfinished(
    stopped: KeyboardInterrupt | Unfinished, there: list[Record], total: int
) -> Unfinished:
    """What is said after Ctrl-C, or when a record could not be written."""
    reason, status = "interrupted", STATUS
    if isinstance(stopped, Unfinished):
        reason, status, there = str(stopped), stopped.status, there + stopped.records
    return Unfinished(
        f"{reason}; {len(there)} of {total} runs came to their end, and the same command goes on "
        "with the others",
        there,
        status,
    )


def report_crashes(records: Sequence[Record]) -> int:
    """Says how many runs broke off; the exit status of a command that evaluates them.

    Returns:
        0 if none did, else 1.
    """
    broken = [record for record in records if record["error"] is not None]
    for error, count in Counter(str(record["error"])[:200] for record in broken).most_common(3):
        print(f"{count} of {len(records)} runs broke off: {error}", file=sys.stderr)
    return int(bool(broken))


def run_isolated(
    scenario: Scenario, name: str, filename: Path, *, replay: Path | None = None
) -> Record:
    """Runs a scenario in its own single-threaded process and writes its record.

    However the process ends, there is a record, unless it was terminated (SIGTERM): one that did
    not finish has its ``error``, and its grasp counts as not held. All processes run the code, and
    name the revision, that was there when the first of them started.

    Args:
        scenario: What to run.
        name: Its name, for the record.
        filename: Where the record goes, as JSON.
        replay: Where a self-contained HTML replay goes; None for none.

    Returns:
        The record, as `feasigrasp.runs.run.run` makes it.

    Raises:
        Unfinished: The record, which comes with it, cannot be written; or the process was asked to
            end.
    """
    replay = None if replay is None else replay.resolve()  # the server may be in another folder
    receiver, sender = _server().Pipe(duplex=False)
    with receiver, tempfile.TemporaryDirectory(prefix="feasigrasp-run-") as scratch:
        messages = Path(scratch) / "messages.txt"
        process = _server().Process(
            target=_run_to_file,
            args=(dump_scenario(scenario), name, sender, replay, messages),
            daemon=True,
        )
        process.start()
        sender.close()
        try:
            record: Record | None = json.loads(receiver.recv())
        except EOFError:
            record = None
        process.join()
        if record is None and process.exitcode == -signal.SIGTERM:
            raise Unfinished("a run was terminated", [], STATUS)
        if record is None:
            last = messages.read_text(errors="replace") if messages.exists() else ""
            error = f"the process ended with status {process.exitcode}: {last[-2000:].strip()}"
            record = crash_record(scenario, name, error)
    try:
        write_json(record, filename)
    except OutputError as unwritten:
        raise Unfinished(str(unwritten), [record], 2) from unwritten
    return record


def _held_so_far(records: Iterable[Record | None]) -> str:
    """How many of the finished runs held their object, for the progress bar."""
    held = [r["metrics"]["grasp_held"] for r in records if r is not None]
    held = [each for each in held if each is not None]
    return f"held {sum(held)} of {len(held)}" if held else ""


def _is_whole(record: Record, form: Record) -> bool:
    """Whether a record has the parts of its form, is of its run, and came to its end."""
    figures = [(record.get(part), form[part]) for part in ("metrics", "timings")]
    return (
        record.keys() >= form.keys()
        and all(isinstance(found, dict) and found.keys() >= of.keys() for found, of in figures)
        and all(record[k] == form[k] for k in ("scenario", "object", "controller", "mode", "seed"))
        and isinstance(record["error"], str | None)
        and record["timings"]["wall_s"] is not None
    )


@cache
def _server() -> multiprocessing.context.ForkServerContext:
    """Starts processes from one that has loaded `feasigrasp_lab.runs.isolated_server`."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["feasigrasp_lab.runs.isolated_server"])
    return context


def _run_to_file(
    scenario_text: str, name: str, sender: Connection, replay: Path | None, messages: Path
) -> None:
    """The process: runs a scenario and sends its record; file ``messages`` gets what it prints."""
    stdout, stderr = 1, 2
    os.dup2(os.open(os.devnull, os.O_WRONLY), stdout)
    os.dup2(os.open(messages, os.O_WRONLY | os.O_CREAT), stderr)
    tempfile.tempdir = str(messages.parent)  # forked processes do not tidy up: the parent does
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, see the next line
    threading.Thread(target=_end_with_parent, daemon=True).start()
    scenario = parse_scenario(scenario_text)
    sent = []

    def send(record: Record) -> None:
        sent.append(json.dumps(record, allow_nan=False))  # as it will be read again
        sender.send(sent[0])

    try:
        run(scenario, name, log=False, replay=replay, keep=send)
    except Exception as error:
        traceback.print_exc()
        if not sent:
            send(crash_record(scenario, name, f"{type(error).__name__}: {error}"))


def _end_with_parent() -> None:
    """Ends the process as soon as its parent is gone, however that went."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)
