"""Main loop of a `Worker` process."""

from __future__ import annotations

import signal
from contextlib import suppress
from multiprocessing.connection import Connection

import numpy as np

from feasigrasp.one_thread import one_thread
from feasigrasp.systems.remote.packing import packed, unpacked
from feasigrasp.systems.remote.served import Served

#: What is said when the stage is built and compiled.
READY = b"ready"
#: What is remembered is handed over, for whoever takes its place, no more often than this [s].
HANDED_OVER = 0.5


def main(descriptor: int) -> None:
    """Works until the other side closes the connection of that descriptor, or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever has started this
    connection = Connection(descriptor)
    with suppress(EOFError, ConnectionError):
        _serve(connection)


def _serve(connection: Connection) -> None:
    make, state = unpacked(connection.recv_bytes())
    with one_thread():
        served = Served(make())
        if state is not None:
            served.remember(state)
        connection.send_bytes(READY)
        handed_over = -np.inf
        while True:
            time, inputs = unpacked(connection.recv_bytes())
            new, state = served.looked(time, inputs), None
            if new and time >= handed_over + HANDED_OVER:
                handed_over, state = time, served.state()
            connection.send_bytes(packed((new, state)))
