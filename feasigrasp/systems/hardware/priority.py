"""The priority of what must not wait for other work."""

import os
from contextlib import suppress

#: Of the priorities of real time, which come before all other work, the lowest is enough.
_LOWEST = 1


def ask_for_real_time() -> None:
    """Asks the system for a priority of real time; where it is not granted nothing changes.

    It is that of the calling thread, and of those that it starts from then on: call it before a
    message bus is opened, which receives in a thread of its own.
    """
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_LOWEST))
