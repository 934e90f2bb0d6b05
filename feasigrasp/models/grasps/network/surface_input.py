"""Input of a grasp network: surface points, normals and invariant scalars.

Surface that was seen is best known by the observed points, the rest by the completed surface, so
the input is a choice of both that covers the object evenly. The scalars do not change with the
object's pose; they give a network the estimates of the distance field: certainty of the surface,
and what a finger opposite would meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array, Float32, Frozen, Mask
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.grasps.network.chords import chords
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf, unit_normals
from feasigrasp.models.shape.surface_error import surface_deviation

#: Names of the invariant features of a point, in the order of `GraspInput.scalars`.
SCALARS = ("deviation", "chord", "chord_cosine", "chord_deviation")
#: Chords are followed this far beyond the opening of the hand [m].
BEYOND_OPENING = 0.02
#: Chords to an outermost face are shorter than the longest by at least this: what fits between the
#: pads with a little room [m].
BEYOND_GRASPS = BEYOND_OPENING + 0.004
#: Longest chord that is handed on, for the default hand [m].
MAX_CHORD = ParallelGripper().max_opening + BEYOND_OPENING
#: A cloud is thinned to so many points for each one wanted, before the even choice.
_CANDIDATES = 2
#: Smoothed and field normals that differ by more than this cosine: the field's is a thin wall's.
_AGREE = 0.5


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

    points: Float32
    normals: Float32
    scalars: Float32

    def __post_init__(self) -> None:
        """Makes the arrays read-only float32 and checks that they agree.

        Raises:
            GraspError: If the shapes do not match, or there is NaN or infinity.
        """
        shapes = {"points": 3, "normals": 3, "scalars": len(SCALARS)}
        for name, columns in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float32)
            if array.ndim != 2 or array.shape != (len(self.points), columns):
                raise GraspError(
                    f"GraspInput.{name} has shape {array.shape}; give ({len(self.points)}, "
                    f"{columns}), one row per point"
                )
            if not np.isfinite(array).all():
                raise GraspError(f"GraspInput.{name} holds NaN or infinity; drop those points")
            self._freeze(**{name: array})

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)


def grasp_input(field: Gpdf, n_points: int = 512, max_chord: float = MAX_CHORD) -> GraspInput:
    """An even choice of points on a completed surface, with normals and invariant features.

    Args:
        field: The distance field, in O.
        n_points: Points wanted. A small object seen once may have fewer.
        max_chord: Longest chord that is followed [m].

    Returns:
        The input, in O; the same field gives the same points.

    Raises:
        GraspError: If ``n_points`` is less than 1, or nothing of the surface is known.
    """
    if n_points < 1:
        raise GraspError(f"n_points = {n_points}; give 1 or more")
    points, normals, smoothed = _candidates(field, n_points)
    if len(points) == 0:
        raise GraspError("the field has no surface; fit it to more points")
    chosen = farthest_points(points, min(n_points, len(points)))
    points, normals = np.ascontiguousarray(points[chosen]), normals[chosen]
    observed = np.flatnonzero(smoothed[chosen])
    normals[observed] = _combined(field.normals(points[observed]), normals[observed])
    length, ends, end_normals = chords(
        field.tiles,
        field.length_scale,
        points - field.center,
        normals,
        max_chord,
        max_chord - BEYOND_GRASPS,
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
    most = _CANDIDATES * n_points
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
    agree = np.einsum("ij,ij->i", of_field, smoothed) > _AGREE
    mean = smoothed + np.where(known & ~agree, 0.0, 1.0)[:, None] * of_field
    return unit_normals(mean)
