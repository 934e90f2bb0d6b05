"""A compiling process: ``python -m feasigrasp.warm_up.worker``.

It reads one kernel a line (module, name and signature, with tabs between them), and answers each
with a line: nothing, or why it could not be compiled.
"""

from __future__ import annotations

import gc
import sys

from feasigrasp.warm_up.kernels import Kernel
from feasigrasp.warm_up.signatures import parse_signature


def main() -> None:
    """Answers until there is no more to read."""
    gc.disable()  # numba makes many objects and little garbage; 8 % of the time to compile
    answers, sys.stdout = sys.stdout, sys.stderr  # nothing else may be written among the answers
    for line in sys.stdin:
        print(_compile(Kernel(*line.rstrip("\n").split("\t"))), file=answers, flush=True)


def _compile(kernel: Kernel) -> str:
    try:
        kernel.function().compile(parse_signature(kernel.signature))
    except Exception as error:  # of a kernel that has changed; it is compiled when it is called
        return f"{type(error).__name__}: {error}".splitlines()[0]
    return ""


if __name__ == "__main__":
    main()
