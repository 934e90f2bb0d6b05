"""Files of trained weights: ``.npz`` without pickles, with a header in JSON beside the arrays."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from feasigrasp.errors import FeasigraspError, InputError
from feasigrasp.inputs import read_arrays
from feasigrasp.outputs import replacing

#: Where the weights that come with the package are.
WEIGHTS = Path(__file__).resolve().parent / "weights"
#: What `WeightsFormat.load` hands to whoever builds a network from it.
WeightArrays = dict[str, NDArray[np.float32]]
_Network = TypeVar("_Network")


class WeightsError(FeasigraspError, ValueError):
    """A file of weights that is missing, broken, or of another network."""


@dataclass(frozen=True)
class WeightsFormat:
    """One kind of weights file.

    Attributes:
        name: What messages call the network.
        format: Written into every file; another layout gets another number.
        command: Trains such a network.
    """

    name: str
    format: str
    command: str

    def save(self, path: str | Path, header: Mapping[str, Any], arrays: WeightArrays) -> None:
        """Writes header and arrays into one file, whole or not at all."""
        text = np.array(json.dumps({"format": self.format, **header}))
        with replacing(path) as file:
            np.savez_compressed(file, header=text, **arrays)  # type: ignore[arg-type]

    def load(
        self, path: str | Path, build: Callable[[dict[str, Any], WeightArrays], _Network]
    ) -> _Network:
        """Reads what `save` wrote, and makes the network of header and arrays by ``build``.

        That raises a KeyError, TypeError or ValueError where these are not its own.

        Raises:
            WeightsError: The file is missing, broken, or of another network.
        """
        mend = f"train it with `{self.command}`, or reinstall feasigrasp"
        if not Path(path).exists():
            raise WeightsError(f"there are no {self.name} weights at {path}; {mend}")
        try:
            arrays = read_arrays(path)
        except InputError as error:
            raise WeightsError(f"{error}; {mend}") from error
        try:
            header = json.loads(str(arrays.pop("header")))
            if header["format"] != self.format:
                raise ValueError(f"its format is {header['format']!r}, not {self.format!r}")
            return build(header, arrays)
        except (KeyError, TypeError, ValueError) as error:
            raise WeightsError(
                f"{path} does not hold {self.name} weights of this version: {error}; {mend}"
            ) from None


def check_arrays(arrays: WeightArrays, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raises ValueError where arrays are not finite float32 of these names and shapes."""
    if set(arrays) != set(shapes):
        missing, surplus = sorted(set(shapes) - set(arrays)), sorted(set(arrays) - set(shapes))
        raise ValueError(f"arrays missing: {missing or 'none'}, unknown: {surplus or 'none'}")
    for name, array in arrays.items():
        if array.shape != shapes[name] or array.dtype != np.float32:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, not float32 {shapes[name]}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
