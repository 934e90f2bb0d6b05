"""A compiling process: ``python -m feasigrasp.warm_up.worker``.

It reads one kernel a line (module, name and signature, with tabs between them), and answers each
with a line: nothing, or why it could not be compiled. It ends when its answers have no reader.
"""

import gc
import os
import signal
import sys
from contextlib import suppress

from feasigrasp.warm_up.kernels import Kernel, parse_signature


def main() -> None:
    """Answers until there is no more to read."""
    gc.disable()  # numba makes many objects and little garbage; 8 % of the time to compile
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever has started this
    answers = sys.stdout.fileno()
    sys.stdout = sys.stderr  # nothing else may be written among the answers
    with suppress(BrokenPipeError):
        for line in sys.stdin:
            answer = _compile(Kernel(*line.rstrip("\n").split("\t")))
            os.write(answers, f"{answer}\n".encode())


def _compile(kernel: Kernel) -> str:
    try:
        kernel.function().compile(parse_signature(kernel.signature))
    except Exception as error:  # of a kernel that has changed; it is compiled when it is called
        return f"{type(error).__name__}: {error}".splitlines()[0]
    return ""


if __name__ == "__main__":
    main()
