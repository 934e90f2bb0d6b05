"""Words that stand for members of an enumeration."""

from enum import StrEnum

import pytest

from feasigrasp.errors import ControlError
from feasigrasp.models.choices import parse_word


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


def test_a_word_or_a_member_is_taken():
    assert parse_word(Colour, "red", "colour", ControlError) == Colour.RED
    assert parse_word(Colour, Colour.BLUE, "colour", ControlError) == Colour.BLUE


@pytest.mark.parametrize("word", ["Red", "", "green", None])
def test_another_word_is_refused_with_those_there_are(word):
    with pytest.raises(ControlError, match="colour is .*; choose one of red, blue"):
        parse_word(Colour, word, "colour", ControlError)
