"""A set of grasps of one object, in the object frame, and the loads on the hand in them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.quantities import POSES, ArrayOf, Whole
from feasigrasp.models.shape.gpdf import Gpdf

#: The ``id`` of a grasp that has not been compared with an earlier set. Source: layout.
UNKNOWN = -1
#: So many grasps are enough to choose from. Source: guessed.
ENOUGH = 10
#: Standard deviation of the logarithm of what pads bear: of friction, and of patches on a surface
#: that is a millimetre off. Source: guessed.
GRIP_SPREAD = 0.4
#: Half a turn about the approach direction: the same grasp, another pose of the hand. Source:
#: definition.
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])

_NUMBERS, _NUMBERS_OF_ALL = (ArrayOf((m,), dtype=np.int64) for m in "km")
#: Attributes of a `GraspSet` with one entry for each grasp, or None.
_PER_GRASP = ("X_OG", "width", "score", "id", "payload_score")


class Rejection(StrEnum):
    """Why a candidate is no grasp of an object; the words in `GraspSet.rejected`."""

    TOO_WIDE = "too wide"
    HITS_TABLE = "hits the table"
    OFF_SURFACE = "off the surface"
    NOTHING_BETWEEN = "nothing between the pads"
    NOT_ANTIPODAL = "not antipodal"
    NOT_FLAT = "not flat enough for the cup"
    COLLIDES = "gripper collides"
    HITS_SCENE = "hits the scene"
    UNOBSERVED = "in space that was never seen"
    UNKNOWN_POSE = "the object's pose is unknown"
    NEAR_COPY = "near copy"
    UNCERTAIN = "uncertain"
    TOO_HEAVY = "too heavy there"


@dataclass(frozen=True, eq=False)
class MassEstimate(Frozen):
    """A mass with a log-normal error, and a centre of mass with a normal one.

    Attributes:
        mass: Median [kg].
        spread: Standard deviation of its logarithm.
        p_OC: Expected centre of mass, in the frame of the field, shape (3,) [m].
        centre_error: Standard deviation of the centre of mass along each axis [m].
    """

    mass: float
    spread: float
    p_OC: Array
    centre_error: float

    def __post_init__(self) -> None:
        self._freeze(p_OC=np.array(self.p_OC, dtype=float).reshape(3))


@dataclass(frozen=True, eq=False)
class Load(Frozen, ABC):
    """Loads on a hand in n grasps of one object.

    Attributes:
        R_OG: Axes of the grasp frames, in O, shape (n, 3, 3).
        lever: From the contact to the centre of mass, in O, shape (n, 3) [m].
        body: Mass and centre of mass of the object, and their errors.
    """

    R_OG: Array
    lever: Array
    body: MassEstimate
    _per_grasp: ClassVar[tuple[str, ...]] = ("R_OG", "lever")

    def __post_init__(self) -> None:
        self._freeze(**{k: np.array(getattr(self, k), dtype=float) for k in self._per_grasp})

    def select(self, keep: NDArray[np.generic]) -> Self:
        """The loads of the grasps that ``keep`` (mask or indices) names."""
        parts: dict[str, Any] = {k: getattr(self, k)[keep] for k in self._per_grasp}
        return replace(self, **parts)

    def joined(self, other: "Load") -> Self:
        """Concatenation of two loads of the same object."""
        pairs = {k: (getattr(self, k), getattr(other, k)) for k in self._per_grasp}
        parts: dict[str, Any] = {k: np.concatenate(pair) for k, pair in pairs.items()}
        return replace(self, **parts)

    @abstractmethod
    def per_kilogram(self, down: ArrayLike | None = None) -> Array:
        """Share of what the hand bears that one kilogram of the object takes, shape (n,).

        The direction of gravity ``down`` is in O, shape (3,); None for the worst one.
        """

    def probability(self, down: ArrayLike | None = None, best: float | None = None) -> Array:
        """Probability that the hand bears weight and inertial load, shape (n,).

        Args:
            down: Direction of gravity in O, shape (3,); None for the worst one for each grasp.
            best: The object is no heavier than one of the grasps carries so likely; without it, as
                heavy as estimated.
        """
        share = self.body.mass * self.per_kilogram(down)
        spread = np.hypot(self.body.spread, GRIP_SPREAD)
        margin = -np.log(share) / spread
        if best is not None and np.isfinite(margin.max()):  # else none bears anything
            margin += max(0.0, ndtri(best) - margin.max())
        return np.asarray(ndtr(margin))


@dataclass(frozen=True, eq=False)
class GraspSet(Frozen):
    """Grasps of one object, in the object frame O.

    Frame G of a grasp has its origin midway between the two contacts; ``x`` is the closing
    direction, ``z`` the approach direction and ``y = z x x``. For a suction cup the origin is the
    middle of its lip, and the width its diameter. The arrays are read-only and a deep
    copy is the object itself, so that a set can travel through Drake's abstract ports for free.

    Attributes:
        X_OG: Grasp poses in the object frame, shape (n, 4, 4) [m].
        width: Distance between the two contact points, shape (n,) [m].
        score: Higher is better, in [0, 1], shape (n,).
        rejected: How many candidates each filter removed, by reason (`Rejection`, or a word of
            your own).
        id: Identity in successive sets of one object, shape (n,): a grasp and its flip keep one
            number as long as they are found again (see `GraspHistory`); `UNKNOWN` before that.
        load: What the hand would have to bear (see `feasigrasp.models.grasps.payload`); None if
            unrated.
        payload_score: How sure they are to bear it as the object is turned now, 1 and more for sure
            (see `feasigrasp.models.grasps.payload`), shape (n,); None if unrated.
        on_object: The ids of all grasps of the object, in reach at present or not, shape (m,); None
            if unrated, as before the reachability filter.
    """

    X_OG: Annotated[Array, POSES]
    width: Annotated[Array, ArrayOf(("n",), "m")]
    score: Annotated[Array, ArrayOf(("n",))]
    rejected: Mapping[str, Whole] = field(default_factory=dict)
    id: Annotated[Indices, _NUMBERS] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    load: Load | None = None
    payload_score: Annotated[Array, ArrayOf(("n",))] | None = None
    on_object: Annotated[Indices, _NUMBERS_OF_ALL] | None = None

    def __post_init__(self) -> None:
        if np.ndim(self.X_OG) == 2:  # one grasp
            object.__setattr__(self, "X_OG", np.asarray(self.X_OG)[None])
            for name in ("width", "score"):
                object.__setattr__(self, name, np.atleast_1d(getattr(self, name)))
        check_fields(self, GraspError)
        arrays = {k: v.copy() for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        if len(self.id) == 0:
            arrays["id"] = np.full(len(self), UNKNOWN, dtype=np.int64)
        elif len(self.id) != len(self):
            raise GraspError(
                f"GraspSet: {len(self)} grasps and {len(self.id)} numbers in id; give one each."
            )
        self._freeze(**arrays)
        words = {str(reason): count for reason, count in self.rejected.items()}
        object.__setattr__(self, "rejected", MappingProxyType(words))

    @classmethod
    @checked(GraspError)
    def empty(cls, rejected: Mapping[str, Whole] | None = None) -> Self:
        """A set without grasps."""
        return cls(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0), rejected or {})

    def __len__(self) -> int:
        """Number of grasps."""
        return len(self.width)

    @checked(GraspError)
    def select(self, keep: NDArray[Any] | Sequence[int], reason: str | None = None) -> Self:
        """The grasps that ``keep`` (mask or indices) names; the others counted under ``reason``."""
        keep = np.asarray(keep) if len(keep) else np.zeros(0, dtype=int)
        is_mask = keep.dtype == bool and keep.shape == self.width.shape
        places = keep if keep.dtype.kind in "iu" and keep.ndim == 1 else np.array([len(self)])
        if not (is_mask or ((places >= -len(self)) & (places < len(self))).all()):
            raise GraspError(
                f"GraspSet.select: keep is no mask of {len(self)} grasps, nor indices of such"
            )
        parts = {n: a[keep] for n in _PER_GRASP if (a := getattr(self, n)) is not None}
        load = None if self.load is None else self.load.select(keep)
        chosen = replace(self, **parts, load=load)
        dropped = len(self) - len(chosen)
        return chosen if reason is None else chosen.counted({reason: max(dropped, 0)})

    @checked(GraspError)
    def counted(self, dropped: Mapping[str, Whole]) -> Self:
        """The grasps with further candidates counted as rejected, by reason."""
        counts = dict(self.rejected)
        for reason, number in dropped.items():
            if number:
                counts[reason] = counts.get(reason, 0) + number
        return replace(self, rejected=counts)

    def with_symmetric(self) -> Self:
        """Adds the 180-degree flip about z of every grasp: the same grasp, another hand pose."""
        return self.joined(replace(self, X_OG=self.X_OG @ FLIP))

    @checked(GraspError)
    def joined(self, other: "GraspSet") -> Self:
        """This set and another one behind it; what was rejected is that of this one."""
        parts: dict[str, Any] = {}
        for name in _PER_GRASP:
            pair = getattr(self, name), getattr(other, name)
            parts[name] = None if any(a is None for a in pair) else np.concatenate(pair)
        load = self.load.joined(other.load) if self.load and other.load else None
        return replace(self, **parts, load=load)


#: Any grasp sampler, model-free or learned: a distance field in, filtered grasps out.
GraspSamplerFn = Callable[[Gpdf], GraspSet]


def contacts(grasps: GraspSet) -> tuple[Array, Array]:
    """The two contact points ``c1`` and ``c2 = c1 + w b`` of each grasp, shapes (n, 3), in O."""
    half = 0.5 * grasps.width[:, None] * grasps.X_OG[:, :3, 0]
    middle = grasps.X_OG[:, :3, 3]
    return middle - half, middle + half


def grasp_frames(middle: Array, b: Array, z: Array) -> Array:
    """Grasp frames [b, z x b, z], (n, m, 4, 4), in the middles (n, 3) of closing lines.

    These are along b (n, 3); approach directions z (n, m, 3) are perpendicular to it, all unit.
    """
    X_OG = np.tile(np.eye(4), (*z.shape[:2], 1, 1))
    x = np.broadcast_to(b[:, None], z.shape)
    X_OG[..., :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    X_OG[..., :3, 3] = middle[:, None]
    return X_OG
