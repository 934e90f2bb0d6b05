"""Keys of a scenario's YAML: what a field of a dataclass may be, stated beside its default."""

from __future__ import annotations

import dataclasses as dc
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple


class Span(NamedTuple):
    """Least and greatest value of a number, of each entry of a vector, and their unit."""

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""


#: Seeds of NumPy's generators.
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
