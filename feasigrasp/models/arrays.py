"""What every module says of its arrays, and values that never change."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
#: In single or double precision.
Floats = NDArray[np.floating]
Float32 = NDArray[np.float32]


class Frozen:
    """A value that nobody changes, so that a copy of it is itself.

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
