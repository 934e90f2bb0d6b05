"""Reads npz and JSON files; a broken, truncated or foreign file is one kind of error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feasigrasp.errors import InputError


def read_arrays(path: str | Path) -> dict[str, NDArray[Any]]:
    """The arrays of an ``npz`` file by name, or that of an ``npy`` file; no pickled objects.

    Raises:
        InputError: There is no such file, or it is none, e.g. because it is cut off.
    """
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"arr_0": loaded}
        with loaded as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except Exception as error:  # zip, zlib and NumPy raise whatever they stumble over
        raise InputError(f"{path} is no whole npz file ({_reported(error)})") from error


def read_json(path: str | Path) -> Any:
    """The content of a JSON file.

    Raises:
        InputError: There is no such file, or it is none.
    """
    try:
        return json.loads(Path(path).read_text("utf-8-sig"))  # with a byte order mark, too
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is no whole JSON file ({_reported(error)})") from error


def _reported(error: Exception) -> str:
    return str(error).split("\n")[0] or type(error).__name__
