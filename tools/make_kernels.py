"""Writes ``feasigrasp/warm_up/kernels.json``: what runs call, as `feasigrasp warm-up` compiles it.

    python tools/make_kernels.py

Each run is a process of its own; tests/warm_up says when it has to be done again. All are done
twice: where nothing is compiled any more, every function that Python calls is seen to be called.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from typing import Any

from numba.core.dispatcher import Dispatcher

from feasigrasp import cli
from feasigrasp.warm_up.kernels import FILE, GROUPS, signature_text

#: What is run with every controller: by the camera alone, and with the pose given.
RUNS = [
    f"run {name} --object mustard_bottle --seed 1"
    for name in ("ReachCircular", "ReachCircularMocap")
]
_CALLED = "\ncalled "


def run_and_record(arguments: list[str]) -> int:
    """Runs a command in this process; prints what Python called: modules, names and signatures."""
    called: set[tuple[str, str, str]] = set()
    compile_or_load, depth = Dispatcher.compile, 0

    def noted(function: Any, signature: Any) -> Any:
        nonlocal depth
        module = function.py_func.__module__
        if depth == 0 and module.startswith("feasigrasp."):
            called.add((module, function.py_func.__qualname__, signature_text(signature)))
        depth += 1
        try:
            return compile_or_load(function, signature)
        finally:
            depth -= 1

    Dispatcher.compile = noted  # type: ignore[method-assign, assignment]
    status = cli.main(arguments)
    print(_CALLED + json.dumps(sorted(called)))
    return status


def called_by(arguments: list[str]) -> list[list[str]]:
    """What Python calls in a run of a command in a process of its own."""
    command = [sys.executable, __file__, *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    found: list[list[str]] = json.loads(done.stdout.rpartition(_CALLED)[2])
    return found


def main() -> int:
    """Does all runs, and writes the file."""
    kernels: dict[str, Any] = {}
    for group, run in itertools.product(GROUPS, RUNS):
        arguments = [*run.split(), "--controller", group]
        called_by(arguments)
        for module, name, signature in called_by(arguments):
            signatures = kernels.setdefault(module, {}).setdefault(name, {})
            groups = signatures.setdefault(signature, [])
            groups += [group] if group not in groups else []
    FILE.write_text(json.dumps(kernels, indent=1, sort_keys=True) + "\n")
    print(f"wrote {FILE}")
    return 0


if __name__ == "__main__":
    sys.exit(run_and_record(sys.argv[1:]) if len(sys.argv) > 1 else main())
