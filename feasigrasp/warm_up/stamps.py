"""Stamp files beside the compiled code that record what is compiled."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Collection
from functools import cache
from pathlib import Path

import numba
from numba.core.codegen import get_host_cpu_features

from feasigrasp.models.arguments import checked
from feasigrasp.outputs import write_text
from feasigrasp.warm_up.kernels import FILE

_MODELS = Path(__file__).parents[1] / "models"


def cache_folder() -> Path:
    """Cache folder of numba for one function, found in this order.

    ``NUMBA_CACHE_DIR``, the folder of the source, and the user's cache (``~/.cache/numba``).

    Raises:
        RuntimeError: None of them can be written to.
    """
    from feasigrasp.models.geometry.se3_kernels import inverse_kernel

    path = inverse_kernel.stats.cache_path
    assert path is not None  # it is one that is kept
    return Path(path)


@checked()
def is_warm(groups: Collection[str]) -> bool:
    """Whether all that these runs call is compiled, for this processor and of these sources."""
    return all(_is_this(_stamp(group)) for group in groups)


def write_stamps(groups: Collection[str]) -> None:
    """Notes that it is."""
    for group in groups:
        write_text(_stamp(group), _key())


def _stamp(group: str) -> Path:
    return cache_folder() / f"warm-up-{group}.stamp"


def _is_this(stamp: Path) -> bool:
    return stamp.is_file() and stamp.read_text() == _key()


@cache
def _key() -> str:
    machine = f"{sys.version} {numba.__version__} {get_host_cpu_features()}"
    known = hashlib.sha256(machine.encode())
    for source in [FILE, *sorted(_MODELS.rglob("*.py"))]:
        known.update(source.read_bytes())
    return known.hexdigest()
