"""Grippers by name or file."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from feasigrasp.errors import GraspError
from feasigrasp.models.choices import nearest
from feasigrasp.models.robot.gripper import WSG_50, ParallelGripper

#: The hand of the packaged cell.
PACKAGED = "EZGripper"
#: All that have a name.
GRIPPERS = {PACKAGED: ParallelGripper(), "WSG_50": WSG_50}
_KEYS = [field.name for field in fields(ParallelGripper) if field.init]


def load_gripper(name: str) -> ParallelGripper:
    """A gripper by its name, or from a YAML file with attributes of `ParallelGripper`.

    Attributes that the file does not have are those of the packaged hand.

    Raises:
        GraspError: There is no such gripper or file, or it describes none.
    """
    if name in GRIPPERS:
        return GRIPPERS[name]
    if not Path(name).is_file():
        raise GraspError(
            f"gripper is {name!r}, which is no file; give one, or one of {', '.join(GRIPPERS)}"
            f"{nearest(name, GRIPPERS)}"
        )
    content = _content(name)
    try:
        return ParallelGripper(**content)
    except (TypeError, ValueError) as error:
        raise GraspError(f"{name}: {error}") from error


def _content(name: str) -> dict[str, Any]:
    """What a file says, lists as tuples of numbers."""
    try:
        given = yaml.safe_load(Path(name).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise GraspError(f"{name} is no YAML file: {str(error).splitlines()[0]}") from error
    if not isinstance(given, dict):
        raise GraspError(f"{name} has no keys; it may have {', '.join(_KEYS)}")
    for key, value in given.items():
        if key not in _KEYS:
            raise GraspError(
                f"{name} has {key}; it may have {', '.join(_KEYS)}{nearest(key, _KEYS)}"
            )
        several = isinstance(getattr(GRIPPERS[PACKAGED], key), tuple)
        try:
            given[key] = tuple(map(float, value)) if several else float(value)
        except (TypeError, ValueError) as error:
            what = "three numbers" if several else "a number"
            raise GraspError(f"{name}: {key} is {value!r}; give {what}, in SI units") from error
    return given
