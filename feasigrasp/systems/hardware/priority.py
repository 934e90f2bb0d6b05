"""Real-time priority of time-critical processes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum

import psutil


class Priority(IntEnum):
    """Priorities of real time, which come before all other work.

    A controller's, and that of whoever answers the arm's driver or carries messages.
    """

    CONTROL = 1
    DRIVER = 2


@contextmanager
def real_time(priority: Priority, *, main: bool = True) -> Iterator[None]:
    """Context with real-time priority for the threads of this process, the ``main`` one or not.

    For those that there are: the one in which a message bus receives begins with the first
    subscription. What they start themselves, such as a process that perceives, has no priority.
    Where it is not granted, nothing changes.
    """
    threads = {thread.id for thread in psutil.Process().threads()}
    before = {}
    for thread in threads - (set() if main else {os.getpid()}):
        # Not there on every system, not granted to everybody, and a thread may have ended.
        with suppress(AttributeError, PermissionError, ProcessLookupError):
            usual = os.sched_getscheduler(thread), os.sched_getparam(thread)
            if usual[1].sched_priority >= priority:
                continue
            _set(thread, os.SCHED_FIFO, os.sched_param(priority))
            before[thread] = usual
    try:
        yield
    finally:
        for thread, (policy, parameter) in before.items():
            with suppress(PermissionError, ProcessLookupError):
                _set(thread, policy, parameter)


def _set(thread: int, policy: int, parameter: os.sched_param) -> None:
    # Whoever may ask for a priority may not take the flag back, so that it stays.
    os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, parameter)
