"""Console output of a run: a progress line, and a table of the outcome."""

import math
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, TextIO

from feasigrasp.models.control.status import Status
from feasigrasp.runs.metrics.cause import Cause
from feasigrasp.runs.metrics.table import METRICS, UNITLESS, Subject

#: Timings of a record, with their units; they stand before the computing times.
TIMINGS = {"simulated_s": "s", "build_s": "s", "wall_s": "s", "real_time_factor": "1"}
#: Details of a cause.
_DETAILS = {
    Cause.SLIPPED: "slip {slip_mm:.0f} mm, turned {turn_deg:.0f} deg",
    Cause.DROPPED: "slip {slip_mm:.0f} mm",
    Cause.PUSHED_AWAY: "by {pushed_mm:.0f} mm",
}


class StatusLine:
    """A line of a terminal that is written over; nothing is written to anything else.

    A text that stays for seconds counts them, until something else is shown or the line cleared.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        """A line of a stream, the standard output if None."""
        self._stream = sys.stdout if stream is None else stream
        self._visible = self._stream.isatty()
        self._text, self._since, self._shown_at = "", 0.0, -math.inf
        self._lock, self._over = threading.Lock(), threading.Event()
        self._counting: threading.Thread | None = None

    def show(self, text: str, *, patient: bool = False) -> None:
        """Shows a text, as much of it as there is room for.

        A ``patient`` one is dropped if the line has changed in the last tenth of a second.
        """
        now = time.monotonic()
        if not self._visible or (patient and now < self._shown_at + 0.1):
            return
        with self._lock:
            self._text, self._since, self._shown_at = text, now, now
            self._write(text)
        if self._counting is None:
            self._over.clear()
            self._counting = threading.Thread(target=self._count, daemon=True)
            self._counting.start()

    def clear(self) -> None:
        """Takes the text away, so that something else can be printed."""
        if self._counting is not None:
            self._over.set()
            self._counting.join()
            self._counting = None
            self._write("")

    def _count(self) -> None:
        while not self._over.wait(0.5):
            with self._lock:
                seconds = time.monotonic() - self._since
                if seconds >= 1.0:
                    self._write(self._text, f"  ({seconds:.0f} s)")

    def _write(self, text: str, more: str = "") -> None:
        room = shutil.get_terminal_size().columns - 1 - len(more)
        print(f"\r{text[:room]}{more}\x1b[K", end="", file=self._stream, flush=True)


def progress(simulated: float, wall: float, status: Status) -> str:
    """Progress of a simulation on one line: simulated and wall time [s], and what goes on."""
    factor = simulated / wall if wall > 0.0 else 0.0
    shown = _status(status.code, status.detail)
    return f"simulating {simulated:5.1f} s  {factor:4.2f} x real time  {shown}"


def verdict(record: Mapping[str, Any]) -> str:
    """Whether the object was held, and if not, why not."""
    if record.get("on_hardware"):
        last = "".join(_status(code, detail) for _, code, detail in record["status"][-1:])
        return f"broke off ({record['error']})" if record["error"] else f"ended: {last}"
    held, tracked = record["metrics"]["grasp_held"], record["metrics"]["tracked_percent"]
    if held:
        return "held"
    if held is None and record["error"]:
        return f"broke off ({record['error']})"
    if held is None:
        share = "" if tracked is None else f" (at a grasp {tracked:.0f} % of the time)"
        return f"followed, with an open gripper{share}"
    return f"not held: {cause_in_words(record)}"


def cause_in_words(record: Mapping[str, Any]) -> str | None:
    """Why an object was not held; None if it was, or was not to be."""
    if record["metrics"]["cause"] is None:
        return None
    cause = Cause(record["metrics"]["cause"])
    why = [f"last: {_status(code, detail)}" for _, code, detail in record["status"][-1:]]
    if record["error"]:
        why = [record["error"]]
    elif cause in _DETAILS:
        known = {name: value for name, value in record["metrics"].items() if value is not None}
        why = []
        with suppress(KeyError):  # a figure that is not known
            why = [_DETAILS[cause].format(**known)]
    return _words(cause) + "".join(f" ({each})" for each in why)


def summary(record: Mapping[str, Any]) -> Iterator[str]:
    """Outcome of a run, line by line: verdict, history, metrics."""
    yield verdict(record)
    parts = (f"{record['controller']} space", record["mode"], record["object"])
    yield f"  {', '.join((record['scenario'], *parts))}, seed {record['seed']}"
    if record["status"]:
        yield "what went on"
    for since, code, detail in record["status"]:
        yield f"  {since:7.2f} s  {_status(code, detail)}"
    values = record["metrics"] | record["timings"]
    for subject in Subject:
        yield subject
        units = TIMINGS if subject is Subject.TIME else {}
        units = units | {name: m.unit for name, m in METRICS.items() if m.subject is subject}
        for name, unit in units.items():
            yield f"  {name:38s} {_figure(values[name], unit)}"


def _figure(value: Any, unit: str) -> str:
    """A figure with its unit; a dash for what does not apply."""
    if value is None:
        return f"{'-':>9s}"
    if isinstance(value, bool):
        return f"{'yes' if value else 'no':>9s}"
    if isinstance(value, str):
        return f"{_words(value):>9s}"
    return f"{value:9.4g} {'' if unit in UNITLESS else unit}".rstrip()


def _status(code: str, detail: str) -> str:
    return _words(code) + (f": {detail}" if detail else "")


def _words(name: str) -> str:
    return str(name).replace("_", " ")
