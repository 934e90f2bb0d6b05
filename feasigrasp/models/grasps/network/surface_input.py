"""Input of a grasp network: surface points, normals and invariant scalars, chords above all.

Surface that was seen is best known by the observed points, the rest by the completed surface, so
the input is a choice of both that covers the object evenly. The scalars do not change with the
object's pose; they give a network the estimates of the distance field: certainty of the surface,
and what a finger opposite would meet.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array, Float32, Frozen, Mask
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.numerics.fast_math import wide_vectors
from feasigrasp.models.quantities import ArrayOf
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf, surface_deviation, unit_normals
from feasigrasp.models.shape.gpdf_kernels import newton_step
from feasigrasp.models.shape.node_sums import make_workspace, value_and_gradient_at

#: A face that meets the ray at a flatter cosine than this is not an exit. Source: guessed.
_MIN_SLOPE = 0.15
#: A surface point farther from the ray than this says nothing about its exit [m]. Source: guessed.
_REACH = 0.012
#: Newton steps along the ray, how close they have to come, and how far they may lead [m]. Source:
#: guessed.
_STEPS, _CONVERGED, _ACCEPTED, _STRAYS = 4, 1e-4, 1e-3, 8e-3
#: More than any length [m]. Source: numerical.
_NO_EXIT = 1e9


@compiled(forceinline=True, fastmath=True)
def _exit_costs(
    planes: Array, x: float, y: float, z: float, u: float, v: float, w: float, out: Array
) -> float:
    """Length from (x, y, z) along (u, v, w) to every plane, raised by the offset; the least.

    `_NO_EXIT` where a plane faces the ray, is met too soon or too far from its own point.
    """
    wide_vectors()
    least = _NO_EXIT
    for j in range(planes.shape[1]):
        dx, dy, dz = planes[0, j] - x, planes[1, j] - y, planes[2, j] - z
        a, b, c = planes[3, j], planes[4, j], planes[5, j]
        slope = a * u + b * v + c * w
        t = (dx * a + dy * b + dz * c) / max(slope, _MIN_SLOPE)
        a, b, c = t * u - dx, t * v - dy, t * w - dz
        square = a * a + b * b + c * c
        # Walls thinner than this have no chord [m].
        usable = (slope > _MIN_SLOPE) & (square < _REACH * _REACH) & (t > 1.5e-3)
        cost = t + np.sqrt(square) if usable else _NO_EXIT
        out[j] = cost
        least = min(least, cost)
    return least


@compiled(nogil=True)
def _crossing(planes: Array, i: int, j: int) -> float:
    """Length along the inward normal of point i to the tangent plane of point j."""
    a, b, c = planes[3:, j]
    dx, dy, dz = (
        planes[0, j] - planes[0, i],
        planes[1, j] - planes[1, i],
        planes[2, j] - planes[2, i],
    )
    slope = -planes[3, i] * a - planes[4, i] * b - planes[5, i] * c
    return (dx * a + dy * b + dz * c) / slope


@compiled(nogil=True)
def _outermost(planes: Array, i: int, costs: Array, least: float, longest: float) -> int:
    """The plane that the ray of point i leaves through last, no farther than ``longest``.

    Offsets count against a plane, as they do against the first. -1 if that is the first itself.
    """
    best, most = -1, least + _REACH
    for j in range(len(costs)):
        if costs[j] < _NO_EXIT and costs[j] > most:
            t = _crossing(planes, i, j)
            if t <= longest and 2.0 * t - costs[j] > most:
                best, most = j, 2.0 * t - costs[j]
    return best


@compiled(forceinline=True)
def _exact_exit(
    tiles: Array, work: Array, length_scale: float, ray: Array, guess: float
) -> tuple[float, float, float, float]:
    """Newton steps along a ray (point, then inward direction) to where the field says it leaves.

    Returns:
        Length and outward unit normal there; a negative length where they do not lead to an exit.
    """
    px, py, pz, u, v, w = ray
    t = guess
    for _ in range(_STEPS):
        x, y, z = px + t * u, py + t * v, pz + t * w
        d, gx, gy, gz = value_and_gradient_at(tiles, work, length_scale, x, y, z)
        slope = gx * u + gy * v + gz * w
        if abs(d) < _CONVERGED or slope <= 0.0:
            break
        t -= newton_step(d, slope)
    size = max(np.sqrt(gx * gx + gy * gy + gz * gz), 1e-12)
    found = abs(d) < _ACCEPTED and slope > _MIN_SLOPE * size and abs(t - guess) < _STRAYS
    return (t if found else -1.0), gx / size, gy / size, gz / size


@compiled(nogil=True)
def chords(
    tiles: Array, length_scale: float, points: Array, normals: Array, longest: float, opening: float
) -> tuple[Array, Array, Array]:
    """Chords from surface points along their inward normals to where they leave the object.

    To the outermost face if that is within the hand's opening, else to the first: a cup that fits
    between the pads is held by its outside, a larger one by its wall.

    A first guess is the tangent plane, of the points themselves, that the ray leaves through: many
    times quicker than marching through the field. Newton steps along the ray make it exact. Where
    they fail in a thin wall, in which the field may have the wrong sign, it stays.

    Args:
        tiles: Of the field.
        length_scale: Of the field [m].
        points: On the surface, relative to the field's centre, shape (n, 3) [m].
        normals: Outward unit normals there, shape (n, 3).
        longest: Longest chord [m].
        opening: Longest chord beyond a first exit [m].

    Returns:
        Lengths (n,), -1 where there is none; far ends (n, 3); outward unit normals there (n, 3).
    """
    # In walls thinner than this the field is not trusted more than the points [m].
    wall = 0.01
    wide_vectors()
    n = len(points)
    lengths, ends, outward = np.full(n, -1.0), np.zeros((n, 3)), np.zeros((n, 3))
    planes = np.empty((6, n))
    for i in range(n):
        for k in range(3):
            planes[k, i], planes[3 + k, i] = points[i, k], normals[i, k]
    work, costs, ray = make_workspace(), np.empty(n), np.empty(6)
    for i in range(n):
        ray[:3], ray[3:] = points[i], -normals[i]
        least = _exit_costs(planes, ray[0], ray[1], ray[2], ray[3], ray[4], ray[5], costs)
        if least >= _NO_EXIT:
            continue
        t, a, b, c = -1.0, 0.0, 0.0, 0.0
        j = _outermost(planes, i, costs, least, opening)
        if j >= 0:
            guess = _crossing(planes, i, j)
            t, a, b, c = _exact_exit(tiles, work, length_scale, ray, guess)
            if t > opening:
                t = -1.0
        if t < 0.0:
            j = 0
            while j < n - 1 and costs[j] != least:
                j += 1
            guess = _crossing(planes, i, j)
            if guess - _STRAYS > longest and guess >= wall:
                continue  # wherever Newton steps led, it would be too far
            t, a, b, c = _exact_exit(tiles, work, length_scale, ray, guess)
            if t < 0.0 and guess < wall:
                t, a, b, c = guess, planes[3, j], planes[4, j], planes[5, j]
        if 0.0 <= t <= longest:
            lengths[i] = t
            ends[i] = ray[:3] + t * ray[3:]
            outward[i, 0], outward[i, 1], outward[i, 2] = a, b, c
    return lengths, ends, outward


#: Names of the invariant features of a point, in the order of `GraspInput.scalars`.
SCALARS = ("deviation", "chord", "chord_cosine", "chord_deviation")
_ROWS = ArrayOf(("n", 3), dtype=np.float32)
#: Longest chord that is handed on, for the default hand [m]. Source: guessed.
MAX_CHORD = ParallelGripper().max_opening + 0.02
#: Longest chord to an outermost face: what fits between the pads with a little room [m]. Source:
#: guessed.
MAX_GRASP = MAX_CHORD - 0.024


@dataclass(frozen=True, eq=False)
class GraspInput(Frozen):
    """Points on the surface of an object, in its frame O.

    Attributes:
        points: Shape (n, 3) [m].
        normals: Outward unit normals, shape (n, 3).
        scalars: Invariant features by the names in `SCALARS`, shape (n, 4): expected distance of
            this surface from the true one [m]; length of the chord from here along the inward
            normal to where it leaves the object for the last time within the hand's opening, else
            for the first time [m], 0 if it does not within reach; cosine between the outward
            normals at its ends, -1 for parallel faces; expected deviation at its far end [m]. The
            last two are 0 as well where there is no chord.
    """

    points: Annotated[Float32, _ROWS]
    normals: Annotated[Float32, _ROWS]
    scalars: Annotated[Float32, ArrayOf(("n", len(SCALARS)), dtype=np.float32)]

    def __post_init__(self) -> None:
        check_fields(self, GraspError)
        self._freeze(**{name: array.copy() for name, array in vars(self).items()})

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)


def grasp_input(field: Gpdf, n_points: int) -> GraspInput:
    """An even choice of points on a completed surface, with normals and invariant features, in O.

    The same field gives the same points; a small object seen once may have fewer than wanted.

    Raises:
        GraspError: If nothing of the surface is known.
    """
    points, normals, smoothed = _candidates(field, n_points)
    if len(points) == 0:
        raise GraspError("the field has no surface; fit it to more points")
    chosen = farthest_points(points, min(n_points, len(points)))
    points, normals = np.ascontiguousarray(points[chosen]), normals[chosen]
    observed = np.flatnonzero(smoothed[chosen])
    normals[observed] = _combined(field.normals(points[observed]), normals[observed])
    from_center = points - field.center
    length, ends, end_normals = chords(
        field.tiles, field.length_scale, from_center, normals, MAX_CHORD, MAX_GRASP
    )
    hit = length > 0.0
    scalars = np.zeros((len(points), len(SCALARS)))
    scalars[:, 0] = surface_deviation(field, points)
    scalars[hit, 1] = length[hit]
    scalars[hit, 2] = np.einsum("ij,ij->i", normals[hit], end_normals[hit])
    scalars[hit, 3] = surface_deviation(field, ends[hit] + field.center)
    return GraspInput(points, normals, scalars)  # type: ignore[arg-type]


def _candidates(field: Gpdf, n_points: int) -> tuple[Array, Array, Mask]:
    """Points of the surface, their normals, and which of these are smoothed or missing yet.

    The others are the field's own, known from when the surface was completed.
    """
    completed = field.completion
    cloud, normals = field.seen()
    # Points per wanted point to which a cloud is thinned before the even choice.
    most = 2 * n_points
    if len(cloud) > most:
        even = np.linspace(0, len(cloud) - 1, most).astype(int)
        cloud, normals = cloud[even], normals[even]
    return (
        np.concatenate([cloud, completed.points]),
        np.concatenate([normals, completed.normals]),
        np.arange(len(cloud) + len(completed)) < len(cloud),
    )


def _combined(of_field: Array, smoothed: Array) -> Array:
    """Means of the field's and the smoothed normals where both exist and agree.

    Between the two faces of a wall the field's gradient may point to either side; there the
    smoothed normal, made from the points of one face, is right.
    """
    known = np.einsum("ij,ij->i", smoothed, smoothed) > 0.5
    # Smoothed and field normals that differ by more than this cosine: the field's is a thin wall's.
    agree = np.einsum("ij,ij->i", of_field, smoothed) > 0.5
    mean = smoothed + np.where(known & ~agree, 0.0, 1.0)[:, None] * of_field
    return unit_normals(mean)
