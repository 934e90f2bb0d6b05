"""Runs a scenario in a process of its own.

A diagram with Python systems is never freed (11 MB each), and a crash in compiled code takes its
process along: one process per run costs a few seconds of start-up and settles both.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from typing import Any

from feasigrasp.evaluation.result_files import write_json
from feasigrasp.evaluation.run import crash_record, run, write_result
from feasigrasp.scenario import Scenario, dump_scenario, parse_scenario

#: Libraries that would start one thread per processor in each of the processes.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)


def run_isolated(
    scenario: Scenario, name: str, filename: Path, *, replay: Path | None = None
) -> dict[str, Any]:
    """Runs a scenario in its own single-threaded process and writes its record.

    However the process ends, there is a record: one that did not finish has its ``error``, and its
    grasp counts as not held.

    Args:
        scenario: What to run.
        name: Its name, for the record.
        filename: Where the record goes, as JSON.
        replay: Where a self-contained HTML replay goes; None for none.

    Returns:
        The record, as `feasigrasp.evaluation.run.run` makes it.
    """
    filename.unlink(missing_ok=True)
    order = {
        "name": name,
        "scenario": dump_scenario(scenario),
        "filename": str(filename),
        "replay": str(replay) if replay else None,
    }
    environment = os.environ | dict.fromkeys(_THREAD_VARIABLES, "1")
    with tempfile.TemporaryFile("w+") as messages:
        process = subprocess.Popen(
            [sys.executable, "-m", "feasigrasp.evaluation.isolated"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            env=environment,
            text=True,
            start_new_session=True,  # Ctrl-C is for the parent alone; see _end_with_parent
        )
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError), process.stdin as pipe:
            pipe.write(json.dumps(order) + "\n")
            pipe.flush()
            process.wait()  # with the pipe open: the process ends itself when it closes
        status = process.wait()
        if filename.exists():
            record: dict[str, Any] = json.loads(filename.read_text())
            return record
        messages.seek(0)
        error = f"the process ended with status {status}: {messages.read()[-2000:].strip()}"
    record = crash_record(scenario, name, error)
    write_json(record, filename)
    return record


def _end_with_parent() -> None:
    """Ends the process when its standard input closes, however the parent went."""
    sys.stdin.read()
    os._exit(1)


def main() -> int:
    """The process: reads its order from the first line of standard input."""
    order = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    scenario = parse_scenario(order["scenario"])
    filename, replay = Path(order["filename"]), order["replay"]
    try:
        result = run(scenario, order["name"], replay=Path(replay) if replay else None)
        write_result(result, filename)
    except Exception as error:
        traceback.print_exc()
        text = f"{type(error).__name__}: {error}"
        write_json(crash_record(scenario, order["name"], text), filename)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
