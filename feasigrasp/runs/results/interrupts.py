"""Handling of Ctrl-C: partial results are kept."""

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

from feasigrasp.errors import FeasigraspError

#: Exit status of a command that Ctrl-C ended, as shells have it. Source: definition: shells.
STATUS = 130


class Unfinished(FeasigraspError):
    """Work that was broken off, by Ctrl-C or because its results cannot be written.

    Attributes:
        records: What was computed until then.
        status: Exit status of the command.
    """

    def __init__(self, message: str, records: Sequence[dict[str, Any]], status: int) -> None:
        super().__init__(message)
        self.records = list(records)
        self.status = status


@contextmanager
def postponed_interrupt() -> Iterator[threading.Event]:
    """Ctrl-C sets the event instead of raising ``KeyboardInterrupt``; a second one raises.

    For work that looks at the event and comes to an orderly end. Where Ctrl-C means something else
    already, or in another thread than the main one, nothing is changed.
    """
    asked = threading.Event()
    before = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if not main or before is not signal.default_int_handler:
        yield asked
        return

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)
        print("interrupted: ending with what there is; once more to drop it", file=sys.stderr)

    signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)
