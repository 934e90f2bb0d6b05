"""Checks of public arguments: type, shape, unit and range, with the name in the message.

`checked` holds every call of a function to its annotations, `check_fields` a dataclass::

    @checked()
    def manipulability(q: Annotated[ArrayLike, JOINTS]) -> Array:

Arrays arrive in the function contiguous and in double precision. What is annotated with a class has
to be an instance of it; a ``float`` has to be finite, an ``int`` whole. See
`feasigrasp.models.quantities` for shapes and ranges.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import fields
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Integral
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from feasigrasp.errors import ArgumentError, FeasigraspError
from feasigrasp.models.choices import nearest
from feasigrasp.models.quantities import ArrayOf, Call, Number, Refusal, shown

_P = ParamSpec("_P")
_R = TypeVar("_R")
#: Returns the value as a function takes it, or raises `Refusal`.
Check = Callable[[Any, Call], Any]


def checked(
    error: type[FeasigraspError] = ArgumentError, title: str | None = None
) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Decorator of a function whose arguments are checked by their annotations.

    Args:
        error: What is raised for a wrong one.
        title: What the message begins with; the function's name by default.
    """

    def decorate(function: Callable[_P, _R]) -> Callable[_P, _R]:
        own = function.__qualname__.removesuffix(".__init__").removesuffix(".__call__")
        parameters = signature(function).parameters.values()
        names = [p.name for p in parameters if p.kind <= Parameter.POSITIONAL_OR_KEYWORD]
        rest = [p.name for p in parameters if p.kind is Parameter.VAR_POSITIONAL]
        found: list[dict[str, Check]] = []

        @wraps(function)
        def call(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            if not found:  # at the first call: annotations may name what is defined later
                found.append(_checks(function))
            checks, values, made = found[0], list(args), Call()
            try:
                given = names + rest * (len(values) - len(names))
                for i, name in enumerate(given[: len(values)]):
                    if name in checks:
                        made.argument = name
                        values[i] = checks[name](values[i], made)
                for name in kwargs:
                    if name in checks:
                        made.argument = name
                        kwargs[name] = checks[name](kwargs[name], made)
            except Refusal as refusal:
                raise error(f"{title or own}: {made.argument} {refusal}") from None
            return function(*values, **kwargs)  # type: ignore[arg-type]

        return call

    return decorate


def check_fields(value: Any, error: type[FeasigraspError] = ArgumentError) -> None:
    """Checks the fields of a dataclass by their annotations, and converts its arrays.

    Args:
        value: The instance, in its ``__post_init__``.
        error: What is raised for a wrong field.
    """
    made = Call()
    cls: Any = type(value)
    for name, check in _field_checks(cls):
        made.argument, given = name, getattr(value, name)
        try:
            right = check(given, made)
        except Refusal as refusal:
            raise error(f"{type(value).__name__}.{name} {refusal}") from None
        if right is not given:
            object.__setattr__(value, name, right)


@cache
def _field_checks(cls: Any) -> list[tuple[str, Check]]:
    checks = _checks(cls)
    return [(f.name, checks[f.name]) for f in fields(cls) if f.init and f.name in checks]


def _checks(thing: Any) -> dict[str, Check]:
    """By name what the annotations of a function or class ask for."""
    hints = get_type_hints(thing, include_extras=True)
    found = {n: check_of(hint) for n, hint in hints.items() if n != "return"}
    return {name: check for name, check in found.items() if check is not None}


def check_of(hint: Any) -> Check | None:
    """The check of an annotation, of a list of one, or of some by key; None without one."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint in (Any, object) or isinstance(hint, TypeVar) or origin is ClassVar:
        return None
    if (alias := getattr(origin or hint, "__value__", None)) is not None:
        return check_of(alias)  # of a ``type`` statement, as in NumPy from 2.5 on
    if isinstance(hint, dict):
        return _keys({key: check_of(each) for key, each in hint.items()})
    if isinstance(hint, list):
        return _container(list, [check_of(hint[0])])
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    if origin is Annotated:
        quantity: ArrayOf | Number = parts[1]
        if parts[0] is not int:
            return quantity.check
        return lambda value, made: quantity.check(_SIMPLE[int](value, made), made)
    if origin in (Union, UnionType):
        return _one_of([check_of(part) for part in parts if part is not NoneType], parts)
    if origin is Callable:
        return _required(callable, "a function")
    if origin is tuple and parts[-1:] != (...,):
        return _items([check_of(part) for part in parts])
    if origin in (type, np.ndarray) or origin is None or not issubclass(origin, Collection):
        return _instance(origin or hint)
    return _container(origin, [check_of(part) for part in parts if part is not ...])


def _required(test: Callable[[Any], bool], what: str) -> Check:
    def check(value: Any, _: Call) -> Any:
        if not test(value):
            raise Refusal(f"is {shown(value)}; give {what}")
        return value

    return check


def _instance(cls: Any) -> Check:
    if getattr(cls, "_is_protocol", False):
        methods = [name for name in vars(cls) if not name.startswith("_")]
        return _required(lambda v: all(hasattr(v, m) for m in methods), f"a {cls.__name__}")
    other = (str, bytes) if cls is Iterable else ()  # letters are no items
    return _required(
        lambda value: isinstance(value, cls) and not isinstance(value, other), f"a {cls.__name__}"
    )


def _one_of(checks: list[Check | None], parts: tuple[Any, ...]) -> Check | None:
    """The first of several that a value passes; what is wrong with it by the one nearest to it."""
    known = [check for check in checks if check is not None]
    if len(known) < len(checks):
        return None
    optional = NoneType in parts
    if optional and len(known) == 1:
        return lambda value, made: None if value is None else known[0](value, made)

    def check(value: Any, made: Call) -> Any:
        if value is None and optional:
            return None
        reasons = []
        for one in known:
            try:
                return one(value, made)
            except Refusal as refusal:
                reasons.append(str(refusal))
        gives = [reason.rpartition("; give ")[2] for reason in reasons]
        if optional:
            gives.append("None")
        raise Refusal(f"{reasons[0].rpartition('; give ')[0]}; give {' or '.join(gives)}")

    return check


def _items(checks: list[Check | None]) -> Check:
    """A row of as many values."""

    def check(value: Any, made: Call) -> Any:
        if not isinstance(value, Sequence | np.ndarray) or len(value) != len(checks):
            raise Refusal(f"is {value!r}; give {len(checks)} entries")
        for i, (item, one) in enumerate(zip(value, checks, strict=True)):
            _of_part(one, item, made, i)
        return value

    return check


def _container(cls: type, checks: list[Check | None]) -> Check:
    """A collection or mapping whose items, and keys, pass."""

    def check(value: Any, made: Call) -> Any:
        sequence = isinstance(value, cls) or (cls is not dict and isinstance(value, np.ndarray))
        if not sequence or isinstance(value, str | bytes):
            raise Refusal(f"is {shown(value)}; give a {cls.__name__.lower()}")
        for i, item in enumerate(value):
            _of_part(checks[0] if checks else None, item, made, i)
            if len(checks) == 2:
                _of_part(checks[1], value[item], made, item)
        return value

    return check


def _keys(checks: dict[str, Check | None]) -> Check:
    """A mapping with these keys, whose values pass."""

    def check(value: Any, made: Call) -> Any:
        if not isinstance(value, dict):
            raise Refusal(f"is {shown(value)}; give {', '.join(checks)}")
        for key in {**value, **checks}:
            if key not in checks:
                hint = nearest(key, checks)
                raise Refusal(f"has {key}; it may have {', '.join(checks)}{hint}")
            if key not in value:
                raise Refusal(f"has no {key}; give it")
            _of_part(checks[key], value[key], made, key)
        return value

    return check


def _of_part(check: Check | None, item: Any, made: Call, place: Any) -> None:
    if check is not None:
        try:
            check(item, made)
        except Refusal as refusal:
            at = place if isinstance(place, str) else f"[{place!r}]"
            raise Refusal(f"{at} {refusal}") from None


_SIMPLE: dict[Any, Check] = {
    float: Number().check,
    int: _required(lambda v: isinstance(v, Integral) and not isinstance(v, bool), "a whole number"),
    bool: _required(lambda v: isinstance(v, bool | np.bool_), "True or False"),
    NoneType: _required(lambda v: v is None, "None"),
}
