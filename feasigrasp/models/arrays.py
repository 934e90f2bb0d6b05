"""Array types, immutable dataclasses, and values cached with the value they derive from."""

from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
#: In single or double precision.
Floats = NDArray[np.floating]
Float32 = NDArray[np.float32]


class Frozen:
    """Base class of immutable values; a copy is the value itself.

    Drake copies the values of abstract ports and states; these cost nothing to copy. Derive a
    ``@dataclass(frozen=True, eq=False)`` from it.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self

    def _freeze(self, **arrays: NDArray[Any]) -> None:
        """Makes arrays read-only and sets them as attributes; for ``__post_init__``."""
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)


_Value = TypeVar("_Value", bound=Frozen)
_Made = TypeVar("_Made")


def cached_on_value(make: Callable[[_Value], _Made]) -> Callable[[_Value], _Made]:
    """Keeps what is made of a frozen value with that value, to be made once.

    It goes where the value goes, into another process too.
    """

    @wraps(make)
    def kept(value: _Value) -> _Made:
        made: dict[str, _Made] = value.__dict__.setdefault("_made", {})
        if make.__name__ not in made:
            made[make.__name__] = make(value)
        return made[make.__name__]

    return kept


def record(options: Any) -> NDArray[np.void]:
    """The numbers of a dataclass as a structured array, shape (1,), for kernels.

    A kernel reads ``options[0].name``; unlike a NamedTuple, an array costs next to nothing to pass.
    """
    names = [f.name for f in fields(options) if isinstance(getattr(options, f.name), int | float)]
    values = tuple(float(getattr(options, name)) for name in names)
    return np.array([values], dtype=[(name, float) for name in names])
