"""A worker process, and the thread that communicates with it."""

import multiprocessing
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from pydrake.systems.framework import System

from feasigrasp.errors import WorkerError
from feasigrasp.systems.remote.served import packed, unpacked

#: A worker that takes longer hangs: to start and compile, and for one piece of work [s]. Source:
#: guessed.
START_PATIENCE, PATIENCE = 300.0, 10.0
#: Distinguishes a worker from other processes, in a list of what they run.
SERVING = "feasigrasp.systems.remote.served"
#: What the process runs: modules are looked for where this one finds them.
_SERVE = f"import sys; sys.path[:] = {{path!r}}; from {SERVING} import main; main({{descriptor}})"


class Worker:
    """A stage in a separate process.

    Nothing here waits but `next_answer` and `wait_until_ready`. A process that dies is started
    anew, as soon as something is asked of it, and takes over the state of the one before it, at
    most half a second before it last answered. One that hangs has to be looked for, by
    `end_if_stuck`. It ends with this process, however that ends.

    Attributes:
        ready: Set while the process is there to work.
    """

    def __init__(self, make: Callable[[], System]) -> None:
        """Starts the process; ``make``, which travels by its name, builds the stage there."""
        self.ready = threading.Event()
        self._make = make
        self._state: bytes | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._closed, self._waiting, self._since = False, 0, time.monotonic()
        self._requests: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        threading.Thread(target=self._talk, daemon=True).start()

    @property
    def busy(self) -> bool:
        """Whether it has something to do, or is not there."""
        return self._waiting > 0 or not self.ready.is_set()

    @property
    def pid(self) -> int:
        """Process id; -1 before its start."""
        return -1 if self._process is None else self._process.pid

    def post(self, time_: float, inputs: dict[str, Any]) -> None:
        """Asks for what is due at a time [s], with inputs by name; each post has one answer."""
        if self._waiting == 0:
            self._since = time.monotonic()
        self._waiting += 1
        self._requests.put(packed((time_, inputs)))  # now: Drake's values change

    def answers(self) -> list[dict[str, Any] | None]:
        """The new outputs of every post that was answered; None of one that was lost."""
        found = []
        while not self._answers.empty():
            found.append(self._answers.get())
            self._answered()
        return found

    def next_answer(self) -> dict[str, Any]:
        """Waits for the next answer.

        Raises:
            WorkerError: The process has died, or hangs.
        """
        answer = None
        with suppress(queue.Empty):
            answer = self._answers.get(timeout=START_PATIENCE)
        self._answered()
        if answer is None:
            raise WorkerError(
                "the process that perception runs in has died, or hangs; what it said stands above "
                "(perception: {execution: inline} runs it in this one)"
            )
        return answer

    def wait_until_ready(self) -> None:
        """Waits for the process to be there.

        Raises:
            WorkerError: It does not start.
        """
        deadline = time.monotonic() + START_PATIENCE
        while not self.ready.wait(0.1):
            ended = self._process is not None and self._process.poll() is not None
            if ended or time.monotonic() > deadline:
                raise WorkerError("the process that perception runs in does not start")

    def end_if_stuck(self) -> None:
        """Ends a process that has taken too long: another one takes its place."""
        allowed = PATIENCE if self.ready.is_set() else START_PATIENCE
        if self._waiting and self._process and time.monotonic() - self._since > allowed:
            self._since = time.monotonic()
            self._process.kill()

    def close(self) -> None:
        """Ends the process."""
        self._closed = True
        self._requests.put(None)
        self._kill()

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _answered(self) -> None:
        self._waiting, self._since = self._waiting - 1, time.monotonic()

    def _talk(self) -> None:
        """Puts every request to the process, and what it answers among the answers."""
        connection = self._started()
        while (request := self._requests.get()) is not None and not self._closed:
            try:
                connection.send_bytes(request)
                answer, state = unpacked(connection.recv_bytes())
            except (EOFError, OSError):
                self.ready.clear()
                connection.close()
                self._kill()
                self._answers.put(None)
                if not self._closed:
                    connection = self._started()
                continue
            self._state = state or self._state
            self._answers.put(answer)

    def _started(self) -> Connection:
        """A new process, and the connection to it; one that does not start shows at a request."""
        mine, other = multiprocessing.Pipe()
        # Not as multiprocessing does: runs of a study are daemonic, and could not.
        code = _SERVE.format(path=sys.path, descriptor=other.fileno())
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-c", code], pass_fds=[other.fileno()], stdin=subprocess.DEVNULL
            )
        if self._closed:
            self._process.kill()
        with suppress(EOFError, OSError):
            mine.send_bytes(packed((self._make, self._state)))
            mine.recv_bytes()
            self.ready.set()
        return mine
