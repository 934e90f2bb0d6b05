"""Types of arguments survive being written and read; what has no text is refused."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import typeof, types

from feasigrasp.warm_up.kernels import parse_signature, signature_text


class Pair(NamedTuple):
    """A named tuple of two types."""

    first: float
    second: int


class Alike(NamedTuple):
    """A named tuple of one type."""

    first: float
    second: float


def frozen(array):
    array.flags.writeable = False
    return array


RECORD = np.zeros(1, [("a", "f8"), ("b", "i4")])
ARGUMENTS = [
    *(1.5, 3, True, None, np.float32(1.0), np.uint8(3)),
    *(np.eye(3), np.eye(4).T, np.eye(4)[:2, :2], frozen(np.zeros((2, 3, 4), np.float32))),
    *((1, 2), (1.0, 2), ((1.0,), np.eye(2)), ()),
    *(Pair(1.0, 2), Alike(1.0, 2.0), (Pair(1.0, 2), Alike(1.0, 2.0))),
    *(RECORD, RECORD[0], np.zeros(1, np.dtype([("a", "i4"), ("b", "f8")], align=True))),
]


@pytest.mark.parametrize("argument", ARGUMENTS, ids=str)
def test_a_type_survives(argument):
    signature = (typeof(argument), types.Omitted(0), types.float64)
    assert parse_signature(signature_text(signature)) == signature


@pytest.mark.parametrize("kind", [types.literal(1), types.unicode_type, types.intp(types.intp)])
def test_what_has_no_text_is_refused(kind):
    with pytest.raises(ValueError, match="no text for"):
        signature_text((kind,))
