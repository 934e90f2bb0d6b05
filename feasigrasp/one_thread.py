"""Limits numerical libraries to one thread."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

#: How many threads a library starts that is loaded from now on.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def one_thread() -> Iterator[None]:
    """Numerical libraries compute with one thread inside, and so do those that are loaded there.

    The pipeline's matrices are small: a second thread costs more than it brings. And two threads
    round otherwise than one, so that a run would depend on what was loaded before it. A library
    that is loaded inside keeps its one thread.
    """
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
