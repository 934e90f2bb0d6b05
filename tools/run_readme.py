"""Runs what README shows, verbatim: its commands and its code, in the folder it is called from.

Each in a process of its own, with the interpreter and the path of the caller: to be tried in an
environment that has the wheel, and in an empty folder. ``feasigrasp run`` has to hold its object.
Commands of the checkout (``make``) are left out.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """Language, empty for none, and text of every fenced block of a page."""
    yield from re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)


def commands(text: str) -> list[str]:
    """The lines of a block that call ``feasigrasp``, continued lines joined."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line for line in lines if re.match(r"(\w+=\S+ )*feasigrasp ", line)]


def main() -> int:
    """Runs everything; 1 if something failed, or if there was nothing."""
    tried = [
        ["bash", "-c", line]
        for language, text in blocks(README)
        if language == ""
        for line in commands(text)
    ]
    tried += [[sys.executable, "-c", text] for lang, text in blocks(README) if lang == "python"]
    failed = 0
    for command in tried:
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True)
        held = "feasigrasp run" not in command[-1] or re.search("^held", done.stdout, re.MULTILINE)
        what = "ran" if done.returncode == 0 and held else f"FAILED with {done.returncode}"
        first = command[-1].strip().splitlines()[0]
        print(f"{what} in {time.monotonic() - began:.0f} s: {first}", flush=True)
        if what != "ran":
            failed += 1
            print(done.stdout[-2000:], done.stderr[-2000:], sep="\n")
    return int(failed > 0 or not tried)


if __name__ == "__main__":
    sys.exit(main())
