"""Writes files atomically; the folder is tested before the work begins, and can be locked.

Devices, pipes and other files that are not regular stay what they are: they are written into.
"""

import fcntl
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from feasigrasp.errors import OutputError


def check_outputs(
    options: Mapping[str, Path | None], read: Mapping[str, Path | str | None] | None = None
) -> None:
    """Checks before a computation that outputs can be written and overwrite no input.

    Both are files by the option that names them; None where that is not given.

    Raises:
        OutputError: A file is a folder, its folder cannot be made or not be written to, two
            options name the same file, or one names a file that is read.
    """
    inputs = {Path(file).resolve(): option for option, file in (read or {}).items() if file}
    seen: dict[Path, str] = {}
    for option, filename in options.items():
        if filename is None:
            continue
        if filename.is_dir():
            raise OutputError(f"{option} {filename} is a folder; give a file in it")
        if not _is_special(filename):
            check_folder(option, filename.resolve().parent)
        if filename.exists() and filename.resolve() in inputs:
            source = inputs[filename.resolve()]
            raise OutputError(f"{option} would overwrite {filename}, which {source} reads")
        other = seen.setdefault(filename.resolve(), option)
        if other != option and not _is_special(filename):
            raise OutputError(f"{other} and {option} are both {filename}; give two files")


def check_folder(option: str, folder: Path) -> None:
    """Raises an OutputError if a folder can neither be written to nor made; it is not made yet."""
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(b"feasigrasp")
    except OSError as error:
        raise OutputError(
            f"{option}: nothing can be written to {folder} ({error.strerror}); choose another place"
        ) from error


@contextmanager
def replacing(filename: str | Path) -> Iterator[BinaryIO]:
    """A file to write to that takes its name when it is whole; until then the old one stays.

    A link stays a link: what it names is replaced. The folder is made if need be.

    Raises:
        OutputError: It cannot be written, e.g. because the disk is full.
    """
    filename = Path(filename)
    try:
        if _is_special(filename):
            with filename.open("wb") as file:
                yield file
            return
        filename = filename.resolve()
        partial = filename.with_name(f"{filename.name}.{os.getpid()}.part")
        try:
            filename.parent.mkdir(parents=True, exist_ok=True)
            with partial.open("wb") as file:
                yield file
            partial.replace(filename)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(
            f"{filename} cannot be written ({reason}); make room for it, or choose another place"
        ) from error


def _is_special(filename: Path) -> bool:
    """Whether a file is there that is not regular, such as ``/dev/stdout`` or a pipe."""
    system = Path(os.path.abspath(filename)).parts[1:2]
    return filename.exists() and (system in (("dev",), ("proc",)) or not filename.is_file())


def write_text(filename: str | Path, text: str) -> None:
    """Writes a text, whole or not at all; see `replacing`."""
    with replacing(filename) as file:
        file.write(text.encode())


def save_figure(figure: Any, filename: str | Path, **options: Any) -> None:
    """Writes a figure of Matplotlib in the format that the suffix names; see `replacing`."""
    known = figure.canvas.get_supported_filetypes()
    picture = Path(filename).suffix.removeprefix(".").lower()
    if picture not in known:
        raise OutputError(f"{filename}: end it in .png, or in one of {', '.join(known)}")
    with replacing(filename) as file:
        figure.savefig(file, format=picture, **options)


def write_json(content: dict[str, Any], filename: Path) -> None:
    """Writes JSON, see `replacing`; a ValueError for NaN and infinity, which JSON does not have."""
    write_text(filename, json.dumps(content, indent=2, allow_nan=False) + "\n")


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
