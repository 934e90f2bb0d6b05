"""Enumerations for options, with the nearest valid word in the error."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from enum import StrEnum
from typing import TypeVar

from feasigrasp.errors import FeasigraspError

_Choice = TypeVar("_Choice", bound=StrEnum)


def nearest(word: object, known: Iterable[str]) -> str:
    """Hint for a misspelt word; empty without a similar one."""
    like = difflib.get_close_matches(str(word), list(known), 1)
    return f"; do you mean {like[0]}?" if like else ""


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
    return choices(parse_word(choices, value, name, error))


def parse_word(words: Iterable[str], value: str, name: str, error: type[FeasigraspError]) -> str:
    """As `parse_choice`, for words that are no enumeration, such as names of plugins."""
    known = [str(word) for word in words]
    if value in known:
        return str(value)
    hint = nearest(value, known)
    raise error(f"{name} is {value!r}; choose one of {', '.join(known)}{hint}")
