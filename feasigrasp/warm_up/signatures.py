"""Argument types of compiled functions as text in Python syntax, and back.

``(float64, array(float64, 2, 'C'), named('some.module:Load', float64, int64))``
"""

from __future__ import annotations

import ast
from importlib import import_module
from typing import Any

import numpy as np
from numba import from_dtype, types
from numba.np.numpy_support import as_dtype

_INTEGERS = ("int64", "int32", "int16", "int8", "uint64", "uint32", "uint16", "uint8")
_PLAIN = ("float64", "float32", *_INTEGERS, "boolean")


def signature_text(argument_types: tuple[Any, ...]) -> str:
    """The text of numba's types of all arguments.

    Raises:
        ValueError: One of them has none, e.g. because it is a function or a literal.
    """
    return _tuple(argument_types)


def parse_signature(text: str) -> tuple[Any, ...]:
    """Numba's types of all arguments, of their text.

    Raises:
        ValueError: It is no such text.
        ImportError, AttributeError: It names a class that there is not.
    """
    return _parsed_tuple(ast.parse(text, mode="eval").body)


def _text(t: Any) -> str:
    if (name := _plain_name(t)) is not None:
        return name
    if isinstance(t, types.Array):
        flags = {"'readonly'": not t.mutable, "'unaligned'": not t.aligned}
        set_flags = "".join(f", {flag}" for flag, is_set in flags.items() if is_set)
        return f"array({_text(t.dtype)}, {t.ndim}, {t.layout!r}{set_flags})"
    if isinstance(t, (types.NamedTuple, types.NamedUniTuple)):
        its = t.instance_class
        fields = "".join(f", {_text(field)}" for field in t)
        return f"named('{its.__module__}:{its.__qualname__}'{fields})"
    if isinstance(t, types.BaseAnonymousTuple):
        return _tuple(t)
    if isinstance(t, types.Record):
        dtype: Any = as_dtype(t)
        formats = [(name, dtype.fields[name][0].str) for name in dtype.names]
        text = f"record({formats}, {dtype.isalignedstruct})"
        if _parsed(ast.parse(text, mode="eval").body) != t:
            raise ValueError(f"{t} is no record of plain numbers")
        return text
    if isinstance(t, types.Omitted):
        return f"omitted({t.value!r})"
    if isinstance(t, types.NoneType):
        return "none"
    raise ValueError(f"no text for {t}")


def _plain_name(t: Any) -> str | None:
    return next((name for name in _PLAIN if getattr(types, name) == t), None)


def _tuple(of: Any) -> str:
    return f"({''.join(_text(t) + ', ' for t in of)})"


def _parsed_tuple(node: ast.expr) -> tuple[Any, ...]:
    if not isinstance(node, ast.Tuple):
        raise ValueError(f"{ast.unparse(node)} is no tuple of types")
    return tuple(map(_parsed, node.elts))


def _parsed(node: ast.expr) -> Any:
    if isinstance(node, ast.Name) and node.id in (*_PLAIN, "none"):
        return getattr(types, node.id)
    if isinstance(node, ast.Tuple):
        return types.BaseTuple.from_types(_parsed_tuple(node))
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
        raise ValueError(f"{ast.unparse(node)} is no type")
    kind, arguments = node.func.id, node.args
    if kind == "named":
        module, _, name = ast.literal_eval(arguments[0]).partition(":")
        fields = tuple(map(_parsed, arguments[1:]))
        return types.BaseTuple.from_types(fields, getattr(import_module(module), name))
    if kind == "array":
        ndim, layout, *flags = map(ast.literal_eval, arguments[1:])
        readonly, aligned = "readonly" in flags, "unaligned" not in flags
        return types.Array(_parsed(arguments[0]), ndim, layout, readonly=readonly, aligned=aligned)
    if kind == "record":
        formats, aligned = map(ast.literal_eval, arguments)
        return from_dtype(np.dtype(formats, align=aligned))
    if kind == "omitted":
        return types.Omitted(ast.literal_eval(arguments[0]))
    raise ValueError(f"{ast.unparse(node)} is no type")
