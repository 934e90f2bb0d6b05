"""Annotations of arguments with shape, unit and range, and their checks.

`feasigrasp.models.arguments` holds callers to them. In the signature they read as
``q: Annotated[ArrayLike, JOINTS]``, and ``horizon: NotNegative`` for numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite, pi
from numbers import Real
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from feasigrasp.errors import FeasigraspError
from feasigrasp.models.compiled import compiled

#: Rotations that differ by less are left as they are: rounding errors of double precision add up to
#: 1e-13 over a hundred products. Source: numerical.
_EXACT = 1e-9
_FLOAT64 = np.dtype(float)
_KINDS = {float: "fiu", np.float32: "f", np.int64: "iu", np.bool_: "b"}
_KINDS |= {np.uint16: "u", np.uint8: "u"}
_WORDS = {np.int64: "whole numbers", np.bool_: "truth values"}
_WORDS |= {np.uint16: "numbers of 16 bits", np.uint8: "numbers of 8 bits"}


class Refusal(FeasigraspError):
    """An invalid value; the catcher adds the name of the argument."""


@dataclass(slots=True)
class Call:
    """The arguments of one call.

    Attributes:
        argument: Which is being checked.
        lengths: By letter in the shapes how long it is, and which argument showed it.
    """

    argument: str = ""
    lengths: dict[str, tuple[int, str]] = field(default_factory=dict)


def shown(value: Any) -> str:
    """A value in a message: itself if it is short, else its type."""
    text = repr(value)
    short = len(text) <= 40 and isinstance(value, Real | str | None)
    return text if short else f"a {type(value).__name__}"


@dataclass(frozen=True)
class ArrayOf:
    """An array, handed on contiguous.

    Attributes:
        shape: Lengths of its axes: numbers, letters, which stand for one length in all arguments of
            a call, and ``...`` in front for any leading axes.
        unit: Of its entries, for messages.
        dtype: Of its entries; others that convert without loss are converted.
        finite: Whether NaN and infinity are refused.
        most: Largest absolute value where all are finite, and what a larger one suggests.
        rotation: Whether the last two axes are rotations (3, 3) or poses (4, 4).
        order: Of the entries in memory; ``K`` for the one that they have.
    """

    shape: tuple[int | str, ...]
    unit: str = ""
    dtype: type[Any] = float
    finite: bool = True
    most: tuple[float, str] = (inf, "")
    rotation: bool = False
    order: Literal["C", "K"] = "C"
    #: What comes after any leading axes, if that is all there is to be seen.
    _tail: tuple[int | str, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Finds what the shape of most arrays is compared with, at once."""
        leading = self.shape[:1] == ("...",) and len(self.shape) > 1
        object.__setattr__(self, "_tail", self.shape[1:] if leading else ("",))

    def check(self, value: Any, call: Call) -> NDArray[Any]:
        """The array; raises `Refusal` where it is none of this shape, kind or range."""
        array = value if isinstance(value, np.ndarray) else self._array(value)
        if array.shape != self.shape and array.shape[-len(self._tail) :] != self._tail:
            self._check_shape(array.shape, call)
        if array.dtype is not _FLOAT64 or self.dtype is not float or not array.flags.c_contiguous:
            array = self._converted(array)
        if self.dtype not in _WORDS and (self.finite or self.most[1]):
            self._check_range(array.ravel(order="K"))
        return self._projected(array) if self.rotation else array

    def _converted(self, array: NDArray[Any]) -> NDArray[Any]:
        empty = array.size == 0 and array.dtype.kind == "f"  # as of []
        wide = array.dtype.itemsize > np.dtype(self.dtype).itemsize and array.dtype.kind == "u"
        wrong = wide or array.dtype.kind not in _KINDS[self.dtype]
        if array.dtype != self.dtype and not empty and wrong:
            raise Refusal(f"holds {array.dtype}; give {self}")
        return np.asarray(array, dtype=self.dtype, order=self.order)

    def _check_range(self, entries: NDArray[Any]) -> None:
        square = entries.dot(entries)  # finite and small, unless an entry is not
        if square < inf and square <= self.most[0] ** 2:
            return
        finite = bool(np.isfinite(entries).all())
        if self.finite and not finite:
            raise Refusal(f"holds NaN or infinity; give finite {self}")
        largest = np.abs(entries).max(initial=0.0)
        if finite and largest > self.most[0]:
            raise Refusal(f"holds {largest:g}{self.most[1]}")

    def _array(self, value: Any) -> NDArray[Any]:
        if value is None or isinstance(value, str | bytes | Mapping):
            raise Refusal(f"is {shown(value)}; give {self}")
        try:
            return np.asarray(value)
        except (ValueError, TypeError) as error:  # rows of different lengths, most often
            raise Refusal(f"is no array ({error}); give {self}") from None

    def _check_shape(self, shape: tuple[int, ...], call: Call) -> None:
        wanted, given = self.shape, shape
        if wanted[:1] == ("...",):
            wanted = wanted[1:]
            given = given[max(0, len(given) - len(wanted)) :]
        fits = len(given) == len(wanted)
        for n, want in zip(given, wanted, strict=False):
            if isinstance(want, str):
                want, _ = call.lengths.setdefault(want, (n, call.argument))
            fits = fits and n == want
        if not fits:
            known = ((w, *call.lengths[w]) for w in wanted if w in call.lengths)
            others = [f"; {w} = {n} as in {a}" for w, n, a in known if a != call.argument]
            raise Refusal(f"has shape {shape}; give {self}{''.join(others)}")

    def _projected(self, array: NDArray[Any]) -> NDArray[Any]:
        """With rotations that are slightly off replaced by the nearest ones."""
        # Rotations whose ``R R^T`` differs from the identity by less, in every entry, are projected
        # onto SO(3); others are refused. Four printed digits differ by 2e-4, single precision by
        # 4e-7.
        rotation_tolerance = 1e-3
        poses = array[None] if array.ndim == 2 else array.reshape(-1, *array.shape[-2:])
        k, error = _worst_rotation(poses)
        if error <= _EXACT:
            return array
        if error > rotation_tolerance:
            off = f"R R^T - I = {error:.1e}, limit {rotation_tolerance:g}"
            if error == inf:
                off = "left-handed, or its last row not 0 0 0 1"
            raise Refusal(
                f"[{k}] is no rotation or pose ({off}); make its columns orthonormal and "
                "right-handed"
            )
        poses = poses.copy()
        known = np.isfinite(poses).all(axis=(1, 2))
        U, _, Vt = np.linalg.svd(poses[known, :3, :3])
        poses[known, :3, :3] = U @ Vt
        return poses.reshape(array.shape)

    def __str__(self) -> str:
        shape = ", ".join(map(str, self.shape)) + ("," if len(self.shape) == 1 else "")
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{_WORDS.get(self.dtype, 'numbers')} of shape ({shape}){unit}"


@compiled
def _worst_rotation(X):
    """Which rotation (n, 3, 3) or pose (n, 4, 4) is farthest from being one, and how far.

    The largest entry of ``R R^T - I``; infinite where it is left-handed or the last row is wrong.
    What is not finite does not count.
    """
    worst, which = 0.0, 0
    for k in range(len(X)):
        R, error = X[k], 0.0
        for i in range(3):
            for j in range(i + 1):
                product = R[i, 0] * R[j, 0] + R[i, 1] * R[j, 1] + R[i, 2] * R[j, 2]
                error = max(error, abs(product - (1.0 if i == j else 0.0)))
        z = R[0, 0] * R[1, 1] - R[0, 1] * R[1, 0]
        x = R[0, 1] * R[1, 2] - R[0, 2] * R[1, 1]
        y = R[0, 2] * R[1, 0] - R[0, 0] * R[1, 2]
        if x * R[2, 0] + y * R[2, 1] + z * R[2, 2] < 0.0:
            error = np.inf
        if X.shape[1] == 4:
            last = abs(R[3, 0]) + abs(R[3, 1]) + abs(R[3, 2]) + abs(R[3, 3] - 1.0)
            if last > _EXACT:
                error = np.inf
        if error > worst and np.isfinite(X[k].sum()):
            worst, which = error, k
    return which, worst


@dataclass(frozen=True)
class Number:
    """A number.

    Attributes:
        least: Smallest value.
        most: Largest value.
        above: Every value is larger than this.
        unbounded: Whether infinity is a value, for no bound.
        unit: For messages.
    """

    least: float = -inf
    most: float = inf
    above: float = -inf
    unbounded: bool = False
    unit: str = ""

    def check(self, value: Any, call: Call) -> Any:
        """The number; raises `Refusal` where it is none, or outside the range."""
        if type(value) is not float and (isinstance(value, bool) or not isinstance(value, Real)):
            raise Refusal(f"is {shown(value)}; give {self}")
        x = float(value)
        inside = self.least <= x <= self.most and (self.above == -inf or x > self.above)
        if not inside or not (self.unbounded or isfinite(x)):
            raise Refusal(f"= {value}; give {self}")
        return value

    def __str__(self) -> str:
        low = f" above {self.above:g}" if self.above > -inf else ""
        low += f" of at least {self.least:g}" if self.least > -inf else ""
        high = f" of at most {self.most:g}" if self.most < inf else ""
        unit = f" {self.unit}" if self.unit else ""
        return f"a{'' if self.unbounded else ' finite'} number{low}{high}{unit}"


# A UR's joints go to a whole turn either way, and drives without limits far beyond.
_DEGREES = (5.0 * pi, ", more than 2.5 turns: are these degrees? Give radians")
#: Joint positions of an arm; those of one instant, those measured, which are of many turns where no
#: limit is kept, and one that is chosen; and velocities. Not finite where the state is unknown.
JOINTS = ArrayOf(("...", "joints"), "rad", finite=False, most=_DEGREES)
JOINT_POSITIONS = ArrayOf(("joints",), "rad", finite=False, most=_DEGREES)
MEASURED_POSITIONS = ArrayOf(("joints",), "rad", finite=False)
CONFIGURATION = ArrayOf(("joints",), "rad", most=_DEGREES)
JOINT_RATES = ArrayOf(("joints",), "rad/s", finite=False)
JACOBIAN = ArrayOf((6, "joints"), finite=False)
POINTS = ArrayOf(("n", 3), "m")
POINT = ArrayOf((3,), "m", most=(1e8, " m, more than the Earth is wide; give metres"))
#: Points of a cloud, some of which may be without depth: whoever takes them counts those.
CLOUD = ArrayOf(("n", 3), "m", finite=False)
#: Where a camera was, or the directions from points to their cameras.
VIEW = ArrayOf(("...", 3), "m", most=POINT.most)
#: Rigid motions; those that may be unknown, not finite; and these with any leading axes.
POSE = ArrayOf((4, 4), "m", rotation=True)
POSES = ArrayOf(("n", 4, 4), "m", rotation=True)
UNKNOWN_POSE = ArrayOf((4, 4), "m", finite=False, rotation=True)
UNKNOWN_POSES = ArrayOf(("n", 4, 4), "m", finite=False, rotation=True)
ANY_POSES = ArrayOf(("...", 4, 4), "m", finite=False, rotation=True)
TWIST = ArrayOf((6,), "rad/s; m/s", finite=False)

Positive = Annotated[float, Number(above=0.0)]
NotNegative = Annotated[float, Number(least=0.0)]
#: Of a whole.
Share = Annotated[float, Number(least=0.0, most=1.0)]
PositiveShare = Annotated[float, Number(above=0.0, most=1.0)]
#: A length, time or speed; infinite for no bound.
Bound = Annotated[float, Number(least=0.0, unbounded=True)]
#: A time; infinite for never.
Instant = Annotated[float, Number(unbounded=True)]
Count = Annotated[int, Number(least=1)]
#: A seed, or a number of what may be missing.
Whole = Annotated[int, Number(least=0)]
