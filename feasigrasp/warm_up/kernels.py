"""List of compiled functions and argument types of runs (``kernels.json``).

The file is written by ``tools/make_kernels.py`` from what runs called. Types are text in Python
syntax: ``(float64, array(float64, 2, 'C'), named('some.module:Load', float64, int64), )``.
"""

import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numba import from_dtype, types
from numba.core.dispatcher import Dispatcher
from numba.np.numpy_support import as_dtype

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import checked

FILE = Path(__file__).with_name("kernels.json")
#: Groups of runs: the space of the controller.
GROUPS = ("task", "joint")


@dataclass(frozen=True)
class Kernel:
    """A function of a module, and the types that it is compiled for, see `signature_text`."""

    module: str
    name: str
    signature: str

    def function(self) -> Any:
        """The function; an ImportError or AttributeError if there is none any more."""
        return getattr(import_module(self.module), self.name)


@checked()
def load_kernels(groups: Collection[str] = GROUPS) -> list[Kernel]:
    """The functions of these groups."""
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


def signature_text(of: Any) -> str:
    """The text of a numba type, or of a tuple of those of all arguments.

    Raises:
        ValueError: One of them has none, e.g. because it is a function or a literal.
    """
    if isinstance(of, types.Array):
        flags = {"readonly": not of.mutable, "unaligned": not of.aligned}
        parts = [signature_text(of.dtype), *map(repr, (of.ndim, of.layout))]
        return f"array({', '.join([*parts, *(repr(flag) for flag in flags if flags[flag])])})"
    if isinstance(of, (types.NamedTuple, types.NamedUniTuple)):
        named = f"{of.instance_class.__module__}:{of.instance_class.__qualname__}"
        return f"named({', '.join([repr(named), *map(signature_text, of)])})"
    if isinstance(of, (tuple, types.BaseAnonymousTuple)):
        members: Any = of
        return f"({''.join(signature_text(each) + ', ' for each in members)})"
    if isinstance(of, types.Record):
        dtype: Any = as_dtype(of)
        text = f"record({[(n, dtype.fields[n][0].str) for n in dtype.names]}, {of.aligned})"
    else:
        plain = (name for name, known in _PLAIN.items() if known == of)
        text = f"omitted({of.value!r})" if isinstance(of, types.Omitted) else next(plain, "")
    if not text or parse_signature(f"({text}, )") != (of,):
        raise ValueError(f"no text for {of}")
    return text


def parse_signature(text: str) -> tuple[Any, ...]:
    """The types of all arguments, of a text of the package's own that names existing classes."""
    return tuple(map(_type, eval(text, {"__builtins__": {}}, _WORDS)))


def _type(of: Any) -> Any:
    return types.BaseTuple.from_types(tuple(map(_type, of))) if isinstance(of, tuple) else of


def _array(dtype: Any, ndim: int, layout: Any, *flags: str) -> Any:
    readonly, aligned = "readonly" in flags, "unaligned" not in flags
    return types.Array(dtype, ndim, layout, readonly=readonly, aligned=aligned)


def _named(of: str, *fields: Any) -> Any:
    module, _, name = of.partition(":")
    its = getattr(import_module(module), name)
    return types.BaseTuple.from_types(tuple(map(_type, fields)), its)


def _record(formats: list[tuple[str, str]], aligned: bool) -> Any:
    return from_dtype(np.dtype(formats, align=aligned))


_INTEGERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (64, 32, 16, 8)]
_PLAIN = {n: getattr(types, n) for n in ("float64", "float32", *_INTEGERS, "boolean", "none")}
_WORDS = {
    **_PLAIN,
    **{"array": _array, "named": _named, "record": _record, "omitted": types.Omitted},
}
