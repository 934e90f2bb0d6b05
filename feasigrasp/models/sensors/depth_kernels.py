"""Kernels of the stereo camera's noise model, see `feasigrasp.models.sensors.depth_noise`."""

import math

import numpy as np

from feasigrasp.models.compiled import compiled


@compiled(nogil=True)
def edges_kernel(inverse, threshold, partner, edge):
    """The most different inverse depth among each pixel's four neighbours, and where it is an edge.

    Images have shape (h, w); inverse depths are NaN where they are not known [1/m]: that is no
    partner. Neighbours that differ by more than the threshold [1/m] are an edge. ``partner`` is
    given the inverse depth of the partner, its own where there is none.
    """
    h, w = inverse.shape
    for i in range(h):
        for j in range(w):
            own = inverse[i, j]
            other, most = own, 0.0
            for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                if 0 <= a < h and 0 <= b < w:
                    jump = abs(inverse[a, b] - own)
                    if jump > most:
                        other, most = inverse[a, b], jump
            partner[i, j], edge[i, j] = other, most > threshold


@compiled(nogil=True)
def smear_kernel(inverse, threshold, partner, edge):
    """Partners and edges of `edges_kernel` anew, each wider by a pixel on the surface it ends."""
    h, w = inverse.shape
    wider, partners = edge.copy(), partner.copy()
    for i in range(h):
        for j in range(w):
            if edge[i, j]:
                continue
            for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                beside = 0 <= a < h and 0 <= b < w and edge[a, b]
                if beside and abs(inverse[a, b] - inverse[i, j]) <= threshold:
                    wider[i, j], partners[i, j] = True, partner[a, b]
                    break
    return partners, wider


@compiled(nogil=True)
def cosine_kernel(inverse, valid, intrinsics, cosine):
    """Cosine of the angle between line of sight and normal, 1 where nothing was measured.

    On a plane the inverse depth is linear in the image, ``1/z = a x + b y + c`` with
    ``x = (u - cx) / fx`` and ``y = (v - cy) / fy``, and (a, b, c) is along its normal: exact for
    planes. Of the two differences to either side the smaller one counts, so that an edge does not
    look like a slope. Inverse depths are known where they are ``valid``; ``intrinsics`` are fx, fy,
    cx, cy [px].
    """
    fx, fy, cx, cy = intrinsics
    h, w = inverse.shape
    for i in range(h):
        y = (i - cy) / fy
        for j in range(w):
            if not valid[i, j]:
                cosine[i, j] = 1.0
                continue
            own = inverse[i, j]
            right, left, below, above = np.inf, np.inf, np.inf, np.inf
            if j + 1 < w and valid[i, j + 1]:
                right = inverse[i, j + 1] - own
            if j > 0 and valid[i, j - 1]:
                left = own - inverse[i, j - 1]
            if i + 1 < h and valid[i + 1, j]:
                below = inverse[i + 1, j] - own
            if i > 0 and valid[i - 1, j]:
                above = own - inverse[i - 1, j]
            x = (j - cx) / fx
            a, b = fx * _smaller(right, left), fy * _smaller(below, above)
            c = own - a * x - b * y
            length = math.sqrt((a * a + b * b + c * c) * (x * x + y * y + 1.0))
            cosine[i, j] = min(max(own / length, 0.0), 1.0)


@compiled(nogil=True)
def _smaller(after, before):
    """The difference that is smaller by its amount; 0 where neither is known."""
    smaller = after if abs(after) < abs(before) else before
    return smaller if math.isfinite(smaller) else 0.0


@compiled(nogil=True)
def measure_kernel(z, inverse, valid, partner, edge, cosine, chance, noise, limits, measured):
    """What is measured of every pixel.

    Args:
        z: True depths [m].
        inverse: Inverse depths.
        valid: Where there is one.
        partner: Of `edges_kernel`.
        edge: Of `edges_kernel`.
        cosine: Of `cosine_kernel`.
        chance: Three images: of a pixel's fate and what it is mixed of, uniform in [0, 1), and the
            error of its disparity, with standard deviation 1.
        noise: f B [px m], scale of depths, bias of disparities [px], and of `DepthNoise`
            ``subpixel``, ``disparity_step``, ``depth_step``, ``flying``, ``edge_missing``,
            ``grazing_start_deg`` and ``grazing_end_deg``.
        limits: Least and largest depth that is measured [m].
        measured: Is given the depths, as `DepthNoise.apply` has them [m].
    """
    fate, mix, error = chance
    scale, gain, bias, subpixel, disparity_step, depth_step, flying, missing, start, end = noise
    near, far = limits
    # At a smaller cosine errors grow no further: such a surface is hardly measured; guessed.
    least = max(math.cos(math.radians(end)), 0.1)
    h, w = z.shape
    for i in range(h):
        for j in range(w):
            if not valid[i, j]:
                measured[i, j] = z[i, j]
                continue
            lost = edge[i, j] and fate[i, j] < missing
            flies = edge[i, j] and not lost and fate[i, j] < missing + flying
            if start < 90.0 and not flies and not lost:
                # An edge pixel that flies is of no surface; elsewhere the draw is still unused.
                angle = math.degrees(math.acos(cosine[i, j]))
                lost = mix[i, j] < (angle - start) / (end - start)
            if lost:
                measured[i, j] = 0.0
                continue
            disparity = inverse[i, j]
            if flies:
                disparity += mix[i, j] * (partner[i, j] - inverse[i, j])
            disparity = scale * disparity + bias
            disparity += subpixel * error[i, j] / max(cosine[i, j], least)
            if disparity_step > 0.0:
                disparity = disparity_step * np.rint(disparity / disparity_step)
            depth = gain * scale / disparity if disparity > 0.0 else np.inf
            if depth_step > 0.0:
                depth = depth_step * np.rint(depth / depth_step)
            measured[i, j] = 0.0 if depth < near else (np.inf if depth > far else depth)
