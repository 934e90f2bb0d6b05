"""Words that stand for members of an enumeration."""

from enum import StrEnum

import pytest

from feasigrasp.errors import ControlError
from feasigrasp.models.choices import parse_choice


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


def test_a_word_or_a_member_is_taken():
    assert parse_choice(Colour, "red", "colour", ControlError) is Colour.RED
    assert parse_choice(Colour, Colour.BLUE, "colour", ControlError) is Colour.BLUE


@pytest.mark.parametrize("word", ["Red", "", "green", None])
def test_another_word_is_refused_with_those_there_are(word):
    with pytest.raises(ControlError, match="colour is .*; choose one of red, blue"):
        parse_choice(Colour, word, "colour", ControlError)
