"""Connected components of pixels, and their grouping into bodies.

A surface is a component of the picture: pixels side by side whose points are near each other. A
body may show more than one, where a part of it hides another; components that come near each other
in space are grouped.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Floats, Indices, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.clouds.edges import EDGE_JUMP
from feasigrasp.models.compiled import compiled

#: Fewer pixels are no surface. Source: guessed.
MIN_PIXELS = 30
#: Components nearer to each other than this are of one body [m]: the two sides of a bowl, between
#: which pixels were lost or fly, are. Source: guessed.
JOINED = 0.045
#: Nothing longer is an object to be grasped [m]: the longest built-in and YCB objects have 0.3 m.
#: Source: reasoned.
LARGEST = 0.4
#: Points of each component that are looked at, at most. Source: guessed.
_SAMPLE = 400


class Components(NamedTuple):
    """Surfaces of a picture.

    Attributes:
        number: The component of each pixel, -1 for pixels of none, shape (height * width,).
        pixels: How many pixels each component has, shape (k,).
        samples: Some of the points of each, at most `_SAMPLE`; k arrays (m, 3) [m].
    """

    number: NDArray[np.int32]
    pixels: Indices
    samples: list[Array]

    def mask(self, chosen: Indices | list[int]) -> Mask:
        """The pixels of some of them."""
        among = np.zeros(len(self.pixels) + 1, dtype=bool)  # the last entry is that of number -1
        among[np.asarray(chosen, dtype=np.int64)] = True
        return np.asarray(among[self.number])

    def graspable(self) -> Indices:
        """The components that are no longer than `LARGEST`: others are of the surroundings."""
        lengths = [np.linalg.norm(np.ptp(sample, axis=0)) for sample in self.samples]
        return np.flatnonzero(np.array(lengths) <= LARGEST)

    def groups(self) -> list[Indices]:
        """The components of each body that may be an object, by `JOINED`."""
        some = self.graspable()
        count = len(some)
        if count < 2:
            return [some] if count else []
        links = np.zeros((count, count), dtype=bool)
        trees = [cKDTree(self.samples[k]) for k in some]
        for k, tree in enumerate(trees):
            for j in range(k):
                links[k, j] = tree.count_neighbors(trees[j], JOINED) > 0
        _, group = connected_components(csr_matrix(links), directed=False)
        return [some[group == g] for g in range(group.max() + 1)]


def find_components(points: Floats, chosen: Mask, p_WC: Array, camera: Camera) -> Components:
    """The components of the chosen pixels, those of fewer than `MIN_PIXELS` left out.

    Points (n, 3) in W and the mask (n,) are given row by row; the points of chosen pixels are
    finite. The camera is at p_WC (3,) [m].
    """
    number = np.empty(len(points), dtype=np.int32)
    # Largest difference of neighbouring pixels on one surface, in standard deviations.
    count = _link(
        np.ascontiguousarray(points, dtype=np.float32),
        chosen,
        camera.width,
        np.ascontiguousarray(p_WC, dtype=float),
        4.0 * camera.depth_noise,
        number,
    )
    pixels = np.bincount(number + 1, minlength=count + 1)[1:]
    large = np.flatnonzero(pixels >= MIN_PIXELS)
    renumbered = np.full(count + 1, -1, dtype=np.int32)
    renumbered[large] = np.arange(len(large))
    number = renumbered[number]
    where = np.flatnonzero(number >= 0)
    samples = []
    for k in range(len(large)):
        of = where[number[where] == k]
        samples.append(points[of[:: -(-len(of) // _SAMPLE)]].astype(float))
    return Components(number, pixels[large], samples)


@compiled(nogil=True)
def _link(points, chosen, width, p_WC, spread, number):
    """Numbers the components of the chosen pixels, the others -1; returns how many there are."""
    n = len(points)
    parent = np.empty(n, dtype=np.int32)
    for i in range(n):
        parent[i] = i
        if not chosen[i]:
            continue
        far = 0.0
        for c in range(3):
            far += (points[i, c] - p_WC[c]) ** 2
        jump = max(EDGE_JUMP, spread * far)
        for back in (1, width):
            j = i - back
            if j < 0 or not chosen[j] or (back == 1 and i % width == 0):
                continue
            square = 0.0
            for c in range(3):
                square += (points[i, c] - points[j, c]) ** 2
            if square < jump * jump:
                a, b = _root(parent, i), _root(parent, j)
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
    count = 0
    for i in range(n):  # a root comes before all others of its component
        if not chosen[i]:
            number[i] = -1
        elif parent[i] == i:
            number[i] = count
            count += 1
        else:
            number[i] = number[_root(parent, i)]
    return count


@compiled(nogil=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
