"""Reads npz, JSON and YAML; a broken, truncated or foreign file is one kind of error."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from feasigrasp.errors import FeasigraspError, InputError


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
    """The content of a JSON file; an InputError if there is no such file, or it is none."""
    try:
        return json.loads(Path(path).read_text("utf-8-sig"))  # with a byte order mark, too
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is no whole JSON file ({_reported(error)})") from error


def _reported(error: Exception) -> str:
    return str(error).split("\n")[0] or type(error).__name__


class _Loader(yaml.SafeLoader):
    """Takes a word that is a number for one, such as 1e-3, which is none to YAML 1.1."""

    def number_or_word(self, node: yaml.ScalarNode) -> float | str:
        try:
            return float(node.value)
        except ValueError:
            return str(node.value)


_Loader.add_constructor("tag:yaml.org,2002:str", _Loader.number_or_word)


def read_yaml(text: str, error: type[FeasigraspError]) -> dict[str, Any]:
    """The content of a YAML text whose root maps keys to values, each of them given once.

    Raises:
        FeasigraspError: Of the type ``error``: it is not YAML, or no such thing.
    """
    root = compose_yaml(text, error)
    try:
        content: dict[str, Any] = _Loader("").construct_document(root)
    except (yaml.YAMLError, ValueError) as broken:
        raise error(f"not valid YAML: {' '.join(str(broken).split())}") from broken
    return content


def compose_yaml(text: str, error: type[FeasigraspError]) -> yaml.MappingNode:
    """The tree of a YAML text as `read_yaml` takes it."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError, ValueError) as broken:
        raise error(f"not valid YAML: {' '.join(str(broken).split())}") from broken
    if not isinstance(root, yaml.MappingNode):
        raise error("not a mapping; give keys with values")
    _check_once(root, set(), error)
    return root


def _check_once(node: yaml.Node, seen: set[int], error: type[FeasigraspError]) -> None:
    """Refuses keys given twice in one mapping, merged lists of mappings, and numbers like 010.

    Of a key that several of a list give, PyYAML takes the first one's value until 6.0.3, as YAML
    says, and from then on the last one's.
    """
    if isinstance(node, yaml.ScalarNode):
        if (read := _read_as(node)) is not None:
            raise error(
                f"line {node.start_mark.line + 1} has {node.value}, which YAML reads as {read:g}; "
                "give a decimal number without zeros in front"
            )
        return
    if id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for value in node.value:
            _check_once(value, seen, error)
        return
    lines: dict[str, int] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise error(f"a key in line {line} is no word; give a name")
        if key.value in lines:
            raise error(
                f"the key {key.value!r} is given twice, in line {lines[key.value]} and in line "
                f"{line}; leave one"
            )
        lines[key.value] = line
        if key.tag == "tag:yaml.org,2002:merge" and isinstance(value, yaml.SequenceNode):
            raise error(
                f"line {line} merges a list; which of it wins depends on the release of PyYAML. "
                "Merge one mapping, and let that one merge the next"
            )
        _check_once(value, seen, error)


def _read_as(node: yaml.ScalarNode) -> float | None:
    """What YAML makes of a number that it reads as no decimal one, e.g. 8 of 010; else None."""
    if not node.tag.endswith((":int", ":float")):
        return None
    read: float = yaml.safe_load(node.value)
    try:
        decimal = float(node.value)
    except ValueError:  # .inf and .nan are as they look
        return read if np.isfinite(read) else None
    return read if decimal != read else None
