"""Words that a user may choose from, as enumerations."""

from __future__ import annotations

from enum import StrEnum
from typing import TypeVar

from feasigrasp.errors import FeasigraspError

_Choice = TypeVar("_Choice", bound=StrEnum)


def parse_choice(
    choices: type[_Choice], value: str, name: str, error: type[FeasigraspError]
) -> _Choice:
    """The member of an enumeration that a word stands for.

    Args:
        choices: The enumeration.
        value: The word, or the member itself.
        name: What is chosen, for the message.
        error: What to raise.

    Raises:
        FeasigraspError: Of the type ``error``: no such word; the message lists those there are.
    """
    try:
        return choices(value)
    except ValueError:
        valid = ", ".join(choices)
        raise error(f"{name} is {value!r}; choose one of {valid}") from None
