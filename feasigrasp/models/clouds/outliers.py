"""Removal of outliers, flying pixels and reflections from a cloud.

A camera's points lie on a surface, about as close together as its pixels are. What floats before
or behind it has no neighbours so near, or few of its kind. "So near" is a multiple of the median
over the cloud, which a fifth of bad points hardly moves. (Open3D's statistical outlier removal
takes mean and standard deviation, which the bad points move to where they pass themselves.)

How strict the limit is depends on the cloud: one without points far off has few close by, and where
a surface is seen at a grazing angle its points are sparse too. Where the limit is strict, such a
surface is visible in the image: there its points are as dense as others, and their depths continue
those of their neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.geometry.se3 import perpendiculars

#: A point is judged by the distance to this neighbour, the nearest being the first ...
NEIGHBOUR = 3
#: ... and hangs together with so many of them, at most.
LINKS = 8
#: Beyond so many times the median of that distance a point is far off.
FAR = 5.0
#: If more points than this share are far off, those are dropped that are beyond so many times it.
CONTAMINATED, NEAR = 0.02, 2.5
#: Fewer points than this that hang together are no surface, and more than this distance from the
#: largest group they are of something else [m].
MIN_GROUP, ELSEWHERE = 8, 0.05
#: Neighbours in the picture, and the multiples of their usual distance and of the spread of their
#: depths within which a point continues them.
_BESIDE, _APART, _DEEPER = 12, 2.0, 3.0
#: Depths spread by so much at least [m].
_DEPTH_NOISE = 1e-3


def outliers(points: Array, p_OC: ArrayLike | None = None) -> Mask:
    """Mask of outliers in one view, or in merged views.

    Args:
        points: Finite points of one object, shape (n, 3) [m].
        p_OC: Position of the camera in the same frame, shape (3,) [m]; None for merged views.

    Returns:
        Shape (n,); none if there are too few points for a decision.
    """
    n = len(points)
    if n <= LINKS:
        return np.zeros(n, dtype=bool)
    apart, near = cKDTree(points).query(points, k=LINKS + 1)
    apart /= max(float(np.median(apart[:, NEIGHBOUR])), 1e-12)
    relative = apart[:, NEIGHBOUR]
    keep = relative <= FAR
    if np.mean(~keep) > CONTAMINATED:
        keep = relative <= NEAR
        sparse = np.flatnonzero(~keep)
        if p_OC is not None:
            keep[sparse] = _continue_the_picture(points, np.asarray(p_OC, dtype=float), sparse)
    # A point that is dropped is no bridge.
    link = keep[:, None] & keep[near] & (apart <= FAR)
    return ~_of_the_object(points, near, link, keep)


def _continue_the_picture(points: Array, p_OC: Array, chosen: Indices) -> Mask:
    """Which of some points have neighbours in the picture that their depth continues."""
    middle = points.mean(axis=0) - p_OC
    z = middle / max(float(np.linalg.norm(middle)), 1e-12)
    in_camera = (points - p_OC) @ np.stack([*perpendiculars(z), z], axis=1)
    depth = np.maximum(in_camera[:, 2], 1e-3)
    tree = cKDTree(in_camera[:, :2] / depth[:, None])
    k = min(_BESIDE + 1, len(points))
    usual = float(np.median(tree.query(tree.data[:: -(-len(points) // 200)], k=k)[0][:, -1]))
    apart, near = tree.query(tree.data[chosen], k=k)
    beside = depth[near[:, 1:]]
    expected = np.median(beside, axis=1)
    spread = np.median(np.abs(beside - expected[:, None]), axis=1)
    continues = np.abs(depth[chosen] - expected) <= _DEEPER * np.maximum(spread, _DEPTH_NOISE)
    return np.asarray(continues & (apart[:, -1] <= _APART * usual))


def _of_the_object(points: Array, near: Indices, link: Mask, keep: Mask) -> Mask:
    """Which kept points hang together, by links (n, k), in groups that the object can consist of.

    The largest group is of the object. What lies behind its rim, for example, when the mask is too
    large, hangs together as well, but far from it.
    """
    n = len(near)
    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(link, axis=1))])
    graph = csr_matrix((np.ones(ends[-1]), near[link], ends), shape=(n, n))
    _, group = connected_components(graph, directed=False)
    sizes = np.bincount(group, weights=keep)
    belongs = sizes >= MIN_GROUP
    largest = int(np.argmax(sizes))
    tree = cKDTree(points[keep & (group == largest)])
    for other in np.flatnonzero(belongs):
        if other != largest:
            distance, _ = tree.query(points[keep & (group == other)])
            belongs[other] = distance.min() <= ELSEWHERE
    return np.asarray(keep & belongs[group])
