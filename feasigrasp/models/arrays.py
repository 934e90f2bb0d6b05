"""Array types, immutable dataclasses, and values cached with the value they derive from."""

from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

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
        """The value itself."""
        return self

    def _freeze(self, **arrays: NDArray[Any]) -> None:
        """Makes arrays read-only and sets them as attributes; for ``__post_init__``."""
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)


_Value = TypeVar("_Value", bound=Frozen)
_Options = ParamSpec("_Options")
_Made = TypeVar("_Made")


def cached_on_value(
    make: Callable[Concatenate[_Value, _Options], _Made],
) -> Callable[Concatenate[_Value, _Options], _Made]:
    """Keeps what is made of a frozen value with that value, to be made once.

    It goes where the value goes, into another process too. Options are given by name.
    """

    @wraps(make)
    def kept(value: _Value, /, *args: _Options.args, **options: _Options.kwargs) -> _Made:
        made: dict[Any, _Made] = value.__dict__.setdefault("_made", {})
        key = (make.__name__, *sorted(options.items()))
        if key not in made:
            made[key] = make(value, *args, **options)
        return made[key]

    return kept


def record(options: Any) -> NDArray[np.void]:
    """The numbers of a dataclass as a structured array, shape (1,), for kernels.

    A kernel reads ``options[0].name``; unlike a NamedTuple, an array costs next to nothing to pass.
    """
    names = [f.name for f in fields(options) if isinstance(getattr(options, f.name), int | float)]
    values = tuple(float(getattr(options, name)) for name in names)
    return np.array([values], dtype=[(name, float) for name in names])
