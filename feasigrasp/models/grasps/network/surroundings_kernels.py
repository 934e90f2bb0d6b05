"""Compiled loops of `surroundings`, over pairs of contact and point."""

import numpy as np
from numba import njit

from feasigrasp.models.numerics.simd import wide_vectors


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def neighbourhood_kernel(centers, facing, cloud, radii, axis, means):
    """Writes `neighbourhoods` (n, r, 8); the cloud (7, c) is sorted along an axis."""
    one, zero = cloud.dtype.type(1.0), cloud.dtype.type(0.0)
    for i in range(len(centers)):
        p, n = centers[i], facing[i]
        for s in range(len(radii)):
            mean, radius = means[i, s], radii[s]
            inverse = one / (radius * radius)
            start = np.searchsorted(cloud[axis], p[axis] - radius)
            stop = np.searchsorted(cloud[axis], p[axis] + radius)
            _neighbourhood(
                p[0], p[1], p[2], n[0], n[1], n[2], cloud, start, stop, inverse, one, zero, mean
            )
            if mean[0] > zero:
                share = one / mean[0]
                for c in range(1, 8):
                    mean[c] *= share
                for c in range(4, 7):
                    mean[c] /= radius


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _neighbourhood(x, y, z, u, v, w, cloud, start, stop, inverse, one, zero, out):
    wide_vectors()
    xs, ys, zs = cloud[0, start:stop], cloud[1, start:stop], cloud[2, start:stop]
    us, vs, ws = cloud[3, start:stop], cloud[4, start:stop], cloud[5, start:stop]
    sure = cloud[6, start:stop]
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
        sq += weight * sure[j]
    out[0], out[1], out[2], out[3] = total, su, sv, sw
    out[4], out[5], out[6], out[7] = sx, sy, sz, sq


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def room_kernel(points, axes, across, widths, cloud, sure, turns, hand, reach, share, room):
    """Writes `hand_room` (ROOM, K, n); ``hand`` holds the sizes that it gathers."""
    sums = np.empty((len(turns), room.shape[0]), dtype=points.dtype)
    scratch = np.empty((6, cloud.shape[1]), dtype=points.dtype)
    for i in range(len(points)):
        b, u = axes[i], across[i]
        v = (b[1] * u[2] - b[2] * u[1], b[2] * u[0] - b[0] * u[2], b[0] * u[1] - b[1] * u[0])
        half = widths[i] * hand[13]
        x, y, z = points[i, 0] + half * b[0], points[i, 1] + half * b[1], points[i, 2] + half * b[2]
        u, b = (u[0], u[1], u[2]), (b[0], b[1], b[2])
        _project(x, y, z, b, u, v, half, cloud, hand, scratch)
        half_turn = len(turns) // 2
        for k in range(half_turn):
            _directions(
                turns[k, 0], turns[k, 1], scratch, sure, hand, reach, sums[k], sums[k + half_turn]
            )
        for f in range(room.shape[0]):
            for k in range(len(turns)):
                room[f, k, i] = np.sqrt(np.sqrt(sums[k, f] * share))


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _project(x, y, z, b, u, v, half, cloud, hand, scratch):
    """The cloud across the axis, and its distances along the axis from each part of the hand."""
    wide_vectors()
    xs, ys, zs = cloud[0], cloud[1], cloud[2]
    p, q, finger, way, palm, camera = (
        scratch[0],
        scratch[1],
        scratch[2],
        scratch[3],
        scratch[4],
        scratch[5],
    )
    b0, b1, b2 = b
    u0, u1, u2 = u
    v0, v1, v2 = v
    center, thick, palm_x, camera_x = hand[0], hand[1], hand[5], hand[8]
    inner, outer = half + hand[12], center + thick
    for j in range(len(xs)):
        a, b, c = xs[j] - x, ys[j] - y, zs[j] - z
        h = abs(a * b0 + b * b1 + c * b2)
        p[j] = a * u0 + b * u1 + c * u2
        q[j] = a * v0 + b * v1 + c * v2
        finger[j] = abs(h - center) - thick
        way[j] = max(inner - h, h - outer)
        palm[j] = h - palm_x
        camera[j] = h - camera_x


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _directions(cos, sin, scratch, sure, hand, reach, out, opposite):
    """Sums of the fourth powers for an approach direction and its opposite.

    z lies along the approach and y across; for the opposite one both change sign.
    """
    wide_vectors()
    p, q, finger, way, palm, camera = (
        scratch[0],
        scratch[1],
        scratch[2],
        scratch[3],
        scratch[4],
        scratch[5],
    )
    width, middle, length = hand[2], hand[3], hand[4]
    palm_y, heel, camera_y, camera_w, camera_z = hand[6], hand[7], hand[9], hand[10], hand[11]
    zero = reach - reach
    a0, a1, a2, a3, a4, a5, a6 = zero, zero, zero, zero, zero, zero, zero
    b0, b1, b2, b3, b4, b5, b6 = zero, zero, zero, zero, zero, zero, zero
    for j in range(len(sure)):
        z = cos * p[j] + sin * q[j]
        y = sin * p[j] - cos * q[j]
        beside = abs(y)
        finger_y, palm_xy = beside - width, max(palm[j], beside - palm_y)
        left = max(camera[j], abs(y - camera_y) - camera_w)
        right = max(camera[j], abs(y + camera_y) - camera_w)

        fingers = max(finger_y, abs(z - middle) - length)
        d = max(reach - max(finger[j], fingers), zero)
        d *= d
        d *= d
        a0 += d
        a1 += d * sure[j]
        d = max(reach - max(palm_xy, z - heel), zero)
        d *= d
        d *= d
        a2 += d
        a3 += d * sure[j]
        d = max(reach - max(way[j], fingers), zero)
        d *= d
        a4 += d * d
        d = max(reach - max(left, z - camera_z), zero)
        d *= d
        a5 += d * d
        d = max(reach - max(right, z - camera_z), zero)
        d *= d
        a6 += d * d

        z = -z
        fingers = max(finger_y, abs(z - middle) - length)
        d = max(reach - max(finger[j], fingers), zero)
        d *= d
        d *= d
        b0 += d
        b1 += d * sure[j]
        d = max(reach - max(palm_xy, z - heel), zero)
        d *= d
        d *= d
        b2 += d
        b3 += d * sure[j]
        d = max(reach - max(way[j], fingers), zero)
        d *= d
        b4 += d * d
        d = max(reach - max(left, z - camera_z), zero)
        d *= d
        b5 += d * d
        d = max(reach - max(right, z - camera_z), zero)
        d *= d
        b6 += d * d
    out[0], out[1], out[2], out[3], out[4], out[5] = a0, a1, a2, a3, a4, min(a5, a6)
    opposite[0], opposite[1], opposite[2] = b0, b1, b2
    opposite[3], opposite[4], opposite[5] = b3, b4, min(b5, b6)
