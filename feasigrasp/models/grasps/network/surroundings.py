"""Geometric features of the neighborhood of each contact, without learned parameters.

Two things about point i that no layer acting on single points can compute, both in one pass over
pairs of points:

- `neighbourhoods`: how the surface bends, as equivariant vectors. Over the points j round a place p
  that face the way f, within each radius s,
  ``sum_j w_j n_j / W`` and ``sum_j w_j (p_j - p) / (s W)`` with
  ``w_j = (1 - |p_j - p|^2 / s^2)_+^2 (f . n_j)_+`` and ``W = sum_j w_j``.
- `hand_room`: how far the open hand would be inside the cloud if it closed on the chord of point i,
  for approach directions all round the closing axis. For each of the boxes that make up the hand,

      room = (mean_j q_j (REACH - d_ij)_+^4)^(1/4),

  d the signed Chebyshev distance of p_j from the box: nearly the deepest penetration, but smooth
  and carried by all points that come near. It depends on the hand, which is an argument.

Both are equivariant: rotating the cloud rotates the vectors; the approach directions are counted
from a reference direction that rotates along. The kernels take float32, to run, and float64, to
prove it to rounding.
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Floats
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import wide_vectors
from feasigrasp.models.robot.gripper import ParallelGripper


class HandSizes(NamedTuple):
    """Boxes of the open hand in its grasp frame, for `room_kernel` [m].

    Attributes:
        finger_x: From the middle to the middle of a finger, along the closing axis.
        finger_half_x: Half the size of a finger along it; the others likewise.
        finger_z: Of the middle of a finger, along the approach; it is symmetric in y.
        heel: Where the palm ends.
        camera_y: Of the middle of the camera.
        camera_top: Where it ends, in z.
        clearance: Between the pads and a contact: points nearer than this are not in the way.
    """

    finger_x: float
    finger_half_x: float
    finger_half_y: float
    finger_z: float
    finger_half_z: float
    palm_half_x: float
    palm_half_y: float
    heel: float
    camera_half_x: float
    camera_y: float
    camera_half_y: float
    camera_top: float
    clearance: float


class Profile(NamedTuple):
    """The cloud across a closing axis, and its distances along the axis from the hand's parts."""

    p: Floats
    q: Floats
    finger: Floats
    way: Floats
    palm: Floats
    camera: Floats


@compiled(nogil=True, fastmath=True)
def neighbourhood_kernel(centers, facing, cloud, radii, axis, means):
    """Writes `neighbourhoods` (n, r, 8); the cloud (7, c) is sorted along an axis."""
    wide_vectors()
    one, zero = cloud.dtype.type(1.0), cloud.dtype.type(0.0)
    for i in range(len(centers)):
        p, n = centers[i], facing[i]
        for s in range(len(radii)):
            mean, radius = means[i, s], radii[s]
            inverse = one / (radius * radius)
            start = np.searchsorted(cloud[axis], p[axis] - radius)
            stop = np.searchsorted(cloud[axis], p[axis] + radius)
            at, facing_there = (p[0], p[1], p[2]), (n[0], n[1], n[2])
            _neighbourhood(at, facing_there, cloud, (start, stop), inverse, mean)
            if mean[0] > zero:
                share = one / mean[0]
                for c in range(1, 8):
                    mean[c] *= share
                for c in range(4, 7):
                    mean[c] /= radius


@compiled(forceinline=True, fastmath=True)
def _neighbourhood(at, facing, cloud, span, inverse, out):
    wide_vectors()
    (x, y, z), (u, v, w), (start, stop) = at, facing, span
    one, zero = cloud.dtype.type(1.0), cloud.dtype.type(0.0)
    xs, ys, zs = cloud[0, start:stop], cloud[1, start:stop], cloud[2, start:stop]
    us, vs, ws = cloud[3, start:stop], cloud[4, start:stop], cloud[5, start:stop]
    confidence = cloud[6, start:stop]
    total, su, sv, sw, sx, sy, sz, sq = zero, zero, zero, zero, zero, zero, zero, zero
    for j in range(len(xs)):
        a, b, c = xs[j] - x, ys[j] - y, zs[j] - z
        near = max(one - (a * a + b * b + c * c) * inverse, zero)
        weight = near * near * max(u * us[j] + v * vs[j] + w * ws[j], zero)
        total += weight
        su += weight * us[j]
        sv += weight * vs[j]
        sw += weight * ws[j]
        sx += weight * a
        sy += weight * b
        sz += weight * c
        sq += weight * confidence[j]
    out[0], out[1], out[2], out[3] = total, su, sv, sw
    out[4], out[5], out[6], out[7] = sx, sy, sz, sq


@compiled(nogil=True, fastmath=True)
def room_kernel(contacts, surface, turns, hand, reach, share, room):
    """Writes `hand_room` (ROOM, K, n); contacts and surface are its first four and next two."""
    (points, axes, across, half_widths), (cloud, confidence) = contacts, surface
    wide_vectors()
    sums = np.empty((len(turns), room.shape[0]), dtype=points.dtype)
    rows = np.empty((6, cloud.shape[1]), dtype=points.dtype)
    profile = Profile(rows[0], rows[1], rows[2], rows[3], rows[4], rows[5])
    opposite = len(turns) // 2
    for i in range(len(points)):
        b, u, half = axes[i], across[i], half_widths[i]
        v = (b[1] * u[2] - b[2] * u[1], b[2] * u[0] - b[0] * u[2], b[0] * u[1] - b[1] * u[0])
        x, y, z = points[i, 0] + half * b[0], points[i, 1] + half * b[1], points[i, 2] + half * b[2]
        u, b = (u[0], u[1], u[2]), (b[0], b[1], b[2])
        _project((x, y, z), (b, u, v), half, cloud, hand, profile)
        for k in range(opposite):
            cos, sin = turns[k, 0], turns[k, 1]
            _directions(cos, sin, profile, confidence, hand, reach, sums[k], sums[k + opposite])
        for f in range(room.shape[0]):
            for k in range(len(turns)):
                room[f, k, i] = np.sqrt(np.sqrt(sums[k, f] * share))


@compiled(forceinline=True, fastmath=True)
def _project(middle, axes, half, cloud, hand, profile):
    """Writes the profile of the cloud (3, c) about the axis b through (x, y, z)."""
    wide_vectors()
    xs, ys, zs = cloud[0], cloud[1], cloud[2]
    p, q, finger, way, palm, camera = profile
    (x, y, z), (b, u, v) = middle, axes
    b0, b1, b2 = b
    u0, u1, u2 = u
    v0, v1, v2 = v
    inner, outer = half + hand.clearance, hand.finger_x + hand.finger_half_x
    for j in range(len(xs)):
        a, b, c = xs[j] - x, ys[j] - y, zs[j] - z
        h = abs(a * b0 + b * b1 + c * b2)
        p[j] = a * u0 + b * u1 + c * u2
        q[j] = a * v0 + b * v1 + c * v2
        finger[j] = abs(h - hand.finger_x) - hand.finger_half_x
        way[j] = max(inner - h, h - outer)
        palm[j] = h - hand.palm_half_x
        camera[j] = h - hand.camera_half_x


@compiled(forceinline=True, fastmath=True)
def _directions(cos, sin, profile, confidence, hand, reach, out, opposite):
    """Sums of the fourth powers for an approach direction and its opposite.

    z lies along the approach and y across; for the opposite one both change sign.
    """
    wide_vectors()
    p, q, finger, way, palm, camera = profile
    zero = reach - reach
    a0, a1, a2, a3, a4, a5, a6 = zero, zero, zero, zero, zero, zero, zero
    b0, b1, b2, b3, b4, b5, b6 = zero, zero, zero, zero, zero, zero, zero
    for j in range(len(confidence)):
        z = cos * p[j] + sin * q[j]
        y = sin * p[j] - cos * q[j]
        beside = abs(y)
        finger_y, palm_xy = beside - hand.finger_half_y, max(palm[j], beside - hand.palm_half_y)
        left = max(camera[j], abs(y - hand.camera_y) - hand.camera_half_y)
        right = max(camera[j], abs(y + hand.camera_y) - hand.camera_half_y)

        shape = (finger[j], finger_y, way[j], palm_xy, left, right)
        f, p4, w, l4, r4 = _one_way(z, shape, hand, reach, zero)
        a0, a1, a2, a3 = a0 + f, a1 + f * confidence[j], a2 + p4, a3 + p4 * confidence[j]
        a4, a5, a6 = a4 + w, a5 + l4, a6 + r4
        f, p4, w, l4, r4 = _one_way(-z, shape, hand, reach, zero)
        b0, b1, b2, b3 = b0 + f, b1 + f * confidence[j], b2 + p4, b3 + p4 * confidence[j]
        b4, b5, b6 = b4 + w, b5 + l4, b6 + r4
    out[0], out[1], out[2], out[3], out[4], out[5] = a0, a1, a2, a3, a4, min(a5, a6)
    opposite[0], opposite[1], opposite[2] = b0, b1, b2
    opposite[3], opposite[4], opposite[5] = b3, b4, min(b5, b6)


@compiled(forceinline=True, fastmath=True)
def _one_way(z, across, hand, reach, zero):
    """Fourth powers of how deep a point is in fingers, palm, their way, and cameras either side."""
    finger, finger_y, way, palm, left, right = across
    fingers = max(finger_y, abs(z - hand.finger_z) - hand.finger_half_z)
    above_camera = z - hand.camera_top
    return (
        _fourth_power(reach - max(finger, fingers), zero),
        _fourth_power(reach - max(palm, z - hand.heel), zero),
        _fourth_power(reach - max(way, fingers), zero),
        _fourth_power(reach - max(left, above_camera), zero),
        _fourth_power(reach - max(right, above_camera), zero),
    )


@compiled(forceinline=True, fastmath=True)
def _fourth_power(d, zero):
    d = max(d, zero)
    d *= d
    return d * d


#: Numbers that `hand_room` gives for a direction: fingers and palm, of all points and of those that
#: are sure; the way the fingers close; the camera, on the side where it has more room. Source:
#: layout: input of the network.
ROOM = 6


def neighbourhoods(
    centers: Floats,
    facing: Floats,
    points: Floats,
    normals: Floats,
    confidence: Floats,
    radii: tuple[float, ...],
) -> Floats:
    """Local curvature features of a surface about places near it.

    Given are the places and where the surface that counts faces there, unit, (n, 3) each; points of
    the surface [m] and their unit normals, (c, 3) each; how sure each point is, (c,), in [0, 1];
    and the radii of the neighbourhoods [m].

    Returns:
        For every place and radius, (n, len(radii), 8): the weight of the neighbourhood, about the
        number of points in it; and means over it: normal (3), offset in units of the radius (3),
        how sure. All zero where it is empty.
    """
    means = np.empty((len(centers), len(radii), 8), dtype=points.dtype)
    # Sorted along the longest side, so that most of the surface can be passed over.
    axis = int(np.argmax(points.max(0) - points.min(0)))
    cloud = np.concatenate([points, normals, confidence[:, None]], axis=1)
    cloud = np.ascontiguousarray(cloud[np.argsort(points[:, axis])].T)
    neighbourhood_kernel(centers, facing, cloud, np.array(radii, dtype=points.dtype), axis, means)
    return means


def hand_room(
    points: Floats,
    axes: Floats,
    across: Floats,
    widths: Floats,
    cloud: Floats,
    confidence: Floats,
    gripper: ParallelGripper,
    directions: int,
) -> Floats:
    """Penetration of the open hand into the cloud, for directions about each closing axis.

    Of contacts (n, 3) [m] with closing directions into the object and, across these, the approach
    direction of angle zero, unit, (n, 3) each, at distances (n,) [m] from the contacts opposite;
    and of the surface of the object (c, 3) [m], with how sure each of its points is, (c,), in
    [0, 1]. Of K directions, an even number, k lies at the angle 2 pi k / K about the axis.

    Returns:
        Shape (`ROOM`, K, n) [m].
    """
    kind = points.dtype.type
    angle = 2.0 * np.pi * np.arange(directions) / directions
    turns = np.stack([np.cos(angle), np.sin(angle)], 1).astype(kind)
    room = np.empty((ROOM, directions, len(points)), dtype=kind)
    # Points farther than this from a box of the hand do not count [m].
    room_kernel(
        (points, axes, across, kind(0.5) * widths),
        (np.ascontiguousarray(cloud.T), confidence),
        turns,
        HandSizes(*np.array(_hand_sizes(gripper), dtype=kind)),
        kind(0.025),
        kind(1.0 / len(cloud)),
        room,
    )
    return room


def _hand_sizes(gripper: ParallelGripper) -> HandSizes:
    half = gripper.finger_thickness / 2
    length = gripper.tip - gripper.heel
    camera_y, camera_z = gripper.camera_center[1:]
    return HandSizes(
        finger_x=gripper.max_opening / 2 + half,
        finger_half_x=half,
        finger_half_y=gripper.finger_width / 2,
        finger_z=gripper.tip - length / 2,
        finger_half_z=length / 2,
        palm_half_x=gripper.palm_size[0] / 2,
        palm_half_y=gripper.palm_size[1] / 2,
        heel=gripper.heel,
        camera_half_x=gripper.camera_box[0] / 2,
        camera_y=camera_y,
        camera_half_y=gripper.camera_box[1] / 2,
        camera_top=camera_z + gripper.camera_box[2] / 2,
        clearance=0.004,
    )
