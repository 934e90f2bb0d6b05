"""What an option may be: words, ranges of keys, names of controllers and of control modes."""

import dataclasses as dc
import difflib
import math
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any, NamedTuple

from feasigrasp.errors import FeasigraspError
from feasigrasp.plugins import plugins


def nearest(word: object, known: Iterable[str]) -> str:
    """Hint for a misspelt word; empty without a similar one."""
    like = difflib.get_close_matches(str(word), list(known), 1)
    return f"; do you mean {like[0]}?" if like else ""


def parse_word(words: Iterable[str], value: str, name: str, error: type[FeasigraspError]) -> str:
    """One of some words, such as the members of a `StrEnum` or the names of plugins.

    Raises an ``error`` where it is none; the message says what ``name`` may be.
    """
    known = [str(word) for word in words]
    if value in known:
        return str(value)
    hint = nearest(value, known)
    raise error(f"{name} is {value!r}; choose one of {', '.join(known)}{hint}")


#: The mode of this package: limits and clearances are enforced.
SAFE = "safe"


class ControlSpace(StrEnum):
    """Space of a controller: hand poses or joint configurations."""

    TASK = "task"
    JOINT = "joint"


def controller_names() -> list[str]:
    """Valid values of ``control.controller``, plugins included."""
    return [*map(str, ControlSpace), *plugins("controllers")]


def mode_names() -> list[str]:
    """Valid values of ``control.mode``, plugins included."""
    return [SAFE, *plugins("modes")]


class Span(NamedTuple):
    """Least and greatest value of a number, of each entry of a vector, and their unit."""

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""


#: Seeds of NumPy's generators. Source: definition: NumPy's `SeedSequence`.
SEED = Span(0, 2**32 - 1)
#: Angles, up to ten turns either way.
TURN = Span(-3600.0, 3600.0, "deg")
#: Places in a cell.
PLACE = Span(-10.0, 10.0, "m")


def key(default: Any, low: float, high: float, unit: str = "") -> Any:
    """A field of numbers, or of one that may be None; a list is copied for every instance.

    Beyond the range a value is a slip (a unit, a sign), or nothing that a cell could be run with.
    """
    metadata = {"span": Span(low, high, unit)}
    if isinstance(default, list):
        return dc.field(default_factory=lambda: list(default), metadata=metadata)
    return dc.field(default=default, metadata=metadata)


def word(default: str, words: Iterable[str]) -> Any:
    """A field that is one of some words."""
    return dc.field(default=str(default), metadata={"words": tuple(map(str, words))})


def metadata_of(kind: Any) -> dict[str, Mapping[str, Any]]:
    """What `key` and `word` state of the fields of a dataclass, by name; empty for other kinds."""
    fields = dc.fields(kind) if dc.is_dataclass(kind) else ()
    return {field.name: field.metadata for field in fields}
