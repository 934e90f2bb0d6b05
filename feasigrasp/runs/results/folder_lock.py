"""Lock of a result folder: one command at a time."""

import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: The file that is locked; it holds the process id of who did.
LOCK = ".lock"


@contextmanager
def only_one_in(folder: Path) -> Iterator[None]:
    """Waits for the lock of a folder, with a message.

    The lock is the kernel's: it ends with its process, however that ends, so none is left behind.
    """
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            who = file.read().strip() or "unknown"
            print(
                f"another command (process {who}) works in {folder}; waiting for its end, Ctrl-C "
                "gives up, another --out need not wait",
                file=sys.stderr,
                flush=True,
            )
            fcntl.flock(file, fcntl.LOCK_EX)
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        try:
            yield
        finally:
            file.truncate(0)
            if new and [path.name for path in folder.iterdir()] == [LOCK]:
                (folder / LOCK).unlink()  # nothing came of it
                folder.rmdir()
