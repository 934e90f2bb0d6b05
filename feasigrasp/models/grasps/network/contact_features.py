"""Features of contacts for the grasp networks: equivariant vectors and invariant scalars.

All of it moves with the object: translations leave it as it is, rotations turn the vectors, another
order of the points gives the same rows in that order.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Floats
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.grasps.network.surroundings import hand_room, neighbourhoods
from feasigrasp.models.robot.gripper import ParallelGripper

#: Lengths enter the network in this unit [m]. Source: layout: input of the network.
LENGTH_SCALE = 0.05
#: Room for the hand enters in this unit [m]. Source: layout: input of the network.
ROOM_SCALE = 0.01
#: Approach directions that are looked at round a contact. Source: layout: input of the network.
DIRECTIONS = 16
#: Channels of `ContactFeatures.vectors` and `ContactFeatures.numbers`. Source: layout: input of the
#: network.
VECTORS, NUMBERS = 13, 20
#: Surface is half as sure when it is expected to be this far off [m]. Source: layout: input of the
#: network.
_DEVIATION_SCALE = 0.004


@dataclass(frozen=True, eq=False)
class ContactFeatures:
    """Geometric features of n contacts.

    Attributes:
        axes: Inward unit normals, shape (n, 3).
        across: Reference directions across them, unit, shape (n, 3).
        chords: Lengths of the chords [m], zero where there is none, shape (n,).
        vectors: Equivariant vectors, shape (3, `VECTORS`, n): from the centre, the outward normal,
            the chord, the first two weighted by how sure the point is, and means over the
            neighbourhoods of both ends of the chord.
        numbers: Invariant, shape (`NUMBERS`, n).
        room: Room for the hand, shape (ROOM, `DIRECTIONS`, n), in units of `ROOM_SCALE`.
    """

    axes: Floats
    across: Floats
    chords: Floats
    vectors: Floats
    numbers: Floats
    room: Floats


def contact_features(
    points: ArrayLike,
    normals: ArrayLike,
    scalars: ArrayLike,
    gripper: ParallelGripper | None = None,
) -> ContactFeatures:
    """Features of contacts, in the precision of the points, for a hand; by default the usual one.

    Points [m], outward unit normals and scalars are those of a `GraspInput`, n > 0 of them.

    Raises:
        GraspError: Without points, or if a normal is not of unit length.
    """
    # Radii of the neighbourhoods of a contact, the last one among the points that stand for the
    # object, and of the contact opposite [m].
    near_radii, wide_radius, far_radius = (0.012, 0.024), 0.048, 0.02
    # Points that neighbourhoods are counted as if there were.
    count = 512
    points = np.asarray(points)
    kind = points.dtype if points.dtype == np.float32 else np.dtype(np.float64)
    points, normals, scalars = (
        np.ascontiguousarray(array, dtype=kind) for array in (points, normals, scalars)
    )
    if len(points) == 0:
        raise GraspError("a grasp network needs points; the input has none")
    if np.abs(np.einsum("ni,ni->n", normals, normals) - 1.0).max() > 1e-3:
        raise GraspError("the normals of a grasp input must have unit length")
    centred = points - points.mean(0)
    axes, across = -normals, np.empty_like(normals)
    confidence = kind.type(_DEVIATION_SCALE) / (scalars[:, 0] + kind.type(_DEVIATION_SCALE))
    # Points of the object that stand for it when the room for the hand is measured.
    chosen = farthest_points(centred.astype(float), min(128, len(centred)))
    cloud = (centred[chosen], normals[chosen], confidence[chosen])
    _reference_directions(centred, axes, across)
    chord = scalars[:, 1].copy()
    ends, facing = centred + chord[:, None] * axes, (chord > 0.0)[:, None] * axes
    vectors = np.empty((3, VECTORS, len(points)), dtype=kind)
    numbers = np.empty((NUMBERS, len(points)), dtype=kind)
    around = (
        neighbourhoods(centred, normals, centred, normals, confidence, near_radii),
        neighbourhoods(centred, normals, *cloud, (wide_radius,)),
        neighbourhoods(ends, facing, centred, normals, confidence, (far_radius,)),
    )
    counts = kind.type(count / len(centred)), kind.type(count / len(chosen))
    _assemble(centred, normals, scalars, confidence, around, counts, vectors, numbers)
    # The contact opposite is looked for here where no chord is known [m].
    widths, hand = np.where(chord > 0.0, chord, kind.type(0.06)), gripper or ParallelGripper()
    room = hand_room(centred, axes, across, widths, cloud[0], cloud[2], hand, DIRECTIONS)
    room *= kind.type(1.0 / ROOM_SCALE)
    return ContactFeatures(axes, across, chord, vectors, numbers, room)


@compiled(nogil=True)
def _assemble(centred, normals, scalars, confidence, around, counts, vectors, numbers):
    """Writes vectors and numbers; numbers are logarithms where magnitudes differ widely."""
    (near, wide, far), (count, wide_count) = around, counts
    kind = centred.dtype.type
    scale, scale_of_deviation, least, zero = (
        kind(1.0 / LENGTH_SCALE),
        kind(_DEVIATION_SCALE),
        kind(1e-3),
        kind(0.0),
    )
    largest, six = zero, kind(6.0)
    for i in range(len(centred)):
        square = centred[i, 0] ** 2 + centred[i, 1] ** 2 + centred[i, 2] ** 2
        largest = max(largest, square)
    size = np.sqrt(largest) * scale
    for i in range(len(centred)):
        chord, far_deviation = scalars[i, 1], scalars[i, 3]
        for axis in range(3):
            p, n = centred[i, axis] * scale, normals[i, axis]
            vectors[axis, 0, i], vectors[axis, 1, i] = p, n
            vectors[axis, 2, i] = -chord * scale * n
            vectors[axis, 3, i], vectors[axis, 4, i] = p * confidence[i], n * confidence[i]
            for s in range(2):
                vectors[axis, 5 + s, i] = near[i, s, 1 + axis]
                vectors[axis, 7 + s, i] = near[i, s, 4 + axis]
            vectors[axis, 9, i], vectors[axis, 10, i] = wide[i, 0, 1 + axis], wide[i, 0, 4 + axis]
            vectors[axis, 11, i], vectors[axis, 12, i] = far[i, 0, 1 + axis], far[i, 0, 4 + axis]
        hit = chord > zero
        numbers[0, i] = confidence[i]
        numbers[1, i] = np.log(scalars[i, 0] + least) + six
        numbers[2, i] = chord * scale
        numbers[3, i] = kind(1.0) if hit else zero
        numbers[4, i] = scalars[i, 2]
        numbers[5, i] = scale_of_deviation / (far_deviation + scale_of_deviation) if hit else zero
        numbers[6, i] = np.log(far_deviation + least) + six if hit else zero
        numbers[7, i] = size
        for s in range(2):
            _describe(near[i, s], count, numbers[8 + s :: 2, i])
        _describe(wide[i, 0], wide_count, numbers[14:, i])
        _describe(far[i, 0], count, numbers[17:, i])


@compiled(nogil=True)
def _describe(mean, count, out):
    """The invariants of a neighbourhood: its weight, how flat it is, how sure."""
    out[0] = np.log1p(mean[0] * count)
    out[1] = np.sqrt(mean[1] ** 2 + mean[2] ** 2 + mean[3] ** 2)
    out[2] = mean[7]


@compiled(nogil=True)
def _reference_directions(centred, axes, across):
    """Writes unit directions across the axes that move with the cloud.

    Towards the centroid, or along the cloud's skewness, whichever lies more across the axis. Only
    where both lie along it, as on a perfect solid of revolution, is the direction arbitrary; then
    the cloud looks the same from all of them.
    """
    skewness, largest = np.zeros(3, dtype=centred.dtype), centred.dtype.type(0.0)
    for i in range(len(centred)):
        p = centred[i]
        square = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
        largest = max(largest, square)
        for k in range(3):
            skewness[k] += square * p[k]
    if largest > 0.0:
        skewness /= largest
    sx, sy, sz = np.float64(skewness[0]), np.float64(skewness[1]), np.float64(skewness[2])
    for i in range(len(centred)):
        axis, p = axes[i], centred[i].astype(np.float64)
        length, towards = _across(axis, -p[0], -p[1], -p[2])
        of_skewness, along_skewness = _across(axis, sx, sy, sz)
        if of_skewness > max(length, 1e-9):
            length, towards = of_skewness, along_skewness
        if not length > 1e-9:
            flattest = np.argmin(np.abs(axis))
            x, y = 1.0 if flattest == 0 else 0.0, 1.0 if flattest == 1 else 0.0
            length, towards = _across(axis, x, y, 1.0 - x - y)
        for k in range(3):
            across[i, k] = towards[k] / length


@compiled(nogil=True)
def _across(axis, x, y, z):
    """Length and components of the part of a vector across a unit axis."""
    # Twice: what rounding has left along the axis is not small beside a short direction.
    for _ in range(2):
        along = x * axis[0] + y * axis[1] + z * axis[2]
        x, y, z = x - along * axis[0], y - along * axis[1], z - along * axis[2]
    return np.sqrt(x * x + y * y + z * z), (x, y, z)
