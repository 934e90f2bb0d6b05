"""List of compiled functions and argument types of runs (``kernels.json``).

The file is written by ``tools/make_kernels.py`` from what runs called.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from numba.core.dispatcher import Dispatcher

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import checked

FILE = Path(__file__).with_name("kernels.json")
#: Groups of runs: the space of the controller.
GROUPS = ("task", "joint")


@dataclass(frozen=True)
class Kernel:
    """A function and the types that it is compiled for.

    Attributes:
        module: Its module.
        name: Its name there.
        signature: Types of its arguments, see `feasigrasp.warm_up.signatures`.
    """

    module: str
    name: str
    signature: str

    def function(self) -> Any:
        """The function.

        Raises:
            ImportError, AttributeError: There is none any more.
        """
        return getattr(import_module(self.module), self.name)


@checked()
def load_kernels(groups: Collection[str] = GROUPS) -> list[Kernel]:
    """The functions of these groups.

    Raises:
        ArgumentError: There is no such group.
    """
    if unknown := set(groups) - set(GROUPS):
        raise ArgumentError(f"groups: no {sorted(unknown)}; there are {', '.join(GROUPS)}")
    found = json.loads(FILE.read_text())
    return [
        Kernel(module, name, signature)
        for module, functions in found.items()
        for name, signatures in functions.items()
        for signature, wanted_by in signatures.items()
        if not set(groups).isdisjoint(wanted_by)
    ]


def all_callees(function: Any) -> dict[str, int]:
    """A function and all compiled ones that it calls, directly or not.

    Returns:
        By the name of each the length of its code, which is about what compiling it takes.
    """
    found: dict[str, int] = {}
    to_do = [function]
    while to_do:
        code = to_do.pop().py_func
        name = f"{code.__module__}.{code.__qualname__}"
        if name not in found:
            found[name] = len(code.__code__.co_code)
            to_do += callees(code)
    return found


def callees(code: Any) -> Iterator[Any]:
    """The compiled functions that a Python function names."""
    named = (code.__globals__.get(name) for name in code.__code__.co_names)
    return (value for value in named if isinstance(value, Dispatcher))
