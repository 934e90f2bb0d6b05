"""Free space of one depth image; voxel map of observed space, and of unobserved space behind it.

Space in front of what a pixel shows is free; behind it, and outside the picture, nothing is known.
What was never seen need not be free: a wall goes on where the picture ends, and has a back. So
unknown voxels that may belong to a seen surface are kept clear of until they are seen: those
*behind* it, and those that continue it *beside* its rim, in its own plane. Unknown space in front
of a surface, or far from any, holds up no arm, which must be able to move where it cannot look.

A truncated distance field, as libraries have it, keeps voxels near surfaces alone; what counts here
is the free space in between, on the lattice on which distances to obstacles are kept anyway.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import minimum_filter
from scipy.sparse import coo_matrix, identity
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.clouds.camera import project
from feasigrasp.models.clouds.fusion import grouped_means, voxel_keys
from feasigrasp.models.compiled import compiled

#: A depth z is reckoned to err by this times z^2 at most [1/m]: nearly three standard deviations of
#: a D435 whose images are 424 pixels wide. Source: data sheet: D435.
DEPTH_ERROR = 0.02


@dataclass(frozen=True, eq=False)
class DepthView(Frozen):
    """Depth image of a camera with its pose.

    Attributes:
        depth: Least depth among each pixel and its neighbours, shape (h, w) [m]: at an edge it is
            that of the nearer surface. 0 where nothing was measured.
        X_WC: Pose of the camera, z forward, shape (4, 4) [m].
        pinhole: fx, fy, cx, cy [px], for whole-numbered pixels.
    """

    depth: Array
    X_WC: Array
    pinhole: tuple[float, float, float, float]

    @classmethod
    def of_cloud(cls, points: NDArray[np.floating], X_WC: ArrayLike) -> Self | None:
        """The view that a pixel-ordered cloud shows; None if too few of its pixels have a point.

        The intrinsics are those that map its points (3, h, w) in W, not finite where nothing was
        measured, to its pixels.
        """
        # Fewer pixels, or a smaller spread of their directions, do not.
        min_pixels, min_spread = 20, 0.02
        # Step between the pixels that fit the camera's intrinsics, along each side.
        stride = 4
        X_WC = np.array(X_WC, dtype=float)
        offset = points.reshape(3, -1) - X_WC[:3, 3:]
        with np.errstate(invalid="ignore"):  # infinity times zero, where nothing was measured
            x, y, z = (X_WC[:3, :3].T @ offset).reshape(points.shape)
        valid = np.isfinite(z) & (z > 0.0)
        rows, columns = np.nonzero(valid[::stride, ::stride])
        rows, columns = stride * rows, stride * columns
        if len(rows) < min_pixels:
            return None
        right, down = (side[rows, columns] / z[rows, columns] for side in (x, y))
        if min(np.ptp(right), np.ptp(down)) < min_spread:
            return None
        fx, cx = np.polyfit(right, columns, 1)
        fy, cy = np.polyfit(down, rows, 1)
        depth = np.where(valid, z, np.inf)
        depth = np.where(valid, minimum_filter(depth, size=3, mode="nearest"), 0.0)
        return cls(depth, X_WC, (float(fx), float(fy), float(cx), float(cy)))

    def looks_through(self, points: Array) -> Mask:
        """Mask of points (n, 3) in W with measured depth behind them, shape (n,)."""
        points_C = (points - self.X_WC[:3, 3]) @ self.X_WC[:3, :3]
        z, (column, row) = points_C[:, 2], map(np.rint, project(points_C, self.pinhole))
        height, width = self.depth.shape
        inside = (z > 0.0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        through = np.zeros(len(points), dtype=bool)
        pixels = row[inside].astype(int), column[inside].astype(int)
        # A known point this much nearer than the measured depth is no longer there [m].
        through[inside] = self.depth[pixels] > z[inside] + 0.03 + DEPTH_ERROR * z[inside] ** 2
        return through


#: Edge length of the voxels of a scene [m]. Source: guessed.
SCENE_VOXEL = 0.025
#: A surface goes on beside its rim for so long: as wide as a link of the arm and the distance that
#: it keeps, so that none fits into what is left out between rim and unknown edge [m]. Source:
#: reasoned.
BESIDE = 0.2
#: A body observed from one side is at most so thick, or hides no more than that [m]. Source:
#: guessed.
BEHIND = 0.1


@dataclass(frozen=True, eq=False)
class ObservedSpace(Frozen):
    """Observed free voxels of a box, of `SCENE_VOXEL`; changes with each view.

    Attributes:
        free: By voxel, shape (nx, ny, nz).
        low: Middle of the first voxel x, y, z [m].
    """

    free: Mask
    low: Array

    def __post_init__(self) -> None:
        self._freeze(free=self.free, low=np.array(self.low, dtype=float))

    @classmethod
    def unknown(cls, low: Array, size: Array) -> Self:
        """An unobserved box from ``low`` (3,) on, ``size`` (3,) large [m]."""
        shape = tuple((np.ceil(np.asarray(size) / SCENE_VOXEL).astype(int) + 1).tolist())
        return cls(np.zeros(shape, dtype=bool), low)

    def seen(self, view: DepthView, surroundings: Array) -> Self:
        """With one more view, and its points (n, 3) that are neither of robot nor object [m].

        What is in front of robot and object is free, too.
        """
        free = self.free.copy()
        # Where something has come, what is behind it was seen before that: it is unknown again.
        count = np.zeros(self.free.shape, dtype=np.int32)
        np.add.at(count, tuple(self._voxels(surroundings)[0].T), 1)
        # A voxel that this number of points of one view fall into, though it had been seen to be
        # free, holds something that has come since. Fewer may be noise.
        come = np.argwhere((count >= 4) & self.free)
        _forget_kernel(come, int(np.ceil(BEHIND / SCENE_VOXEL)), free)
        # A voxel counts as a whole: its middle is farther than half its diagonal from the surface.
        _look_kernel(
            self.low, SCENE_VOXEL, view.X_WC, view.pinhole, view.depth,
            0.5 * np.sqrt(3.0) * SCENE_VOXEL, free,
        )  # fmt: skip
        return replace(self, free=free)

    def occupied_by(self, center: Array, radius: Array) -> Self:
        """With the space inside balls of the arm itself, which is free of anything else.

        Their centres have the shape (n, 3), their radii (n,) [m].
        """
        free = self.free.copy()
        _balls_kernel(np.ascontiguousarray(center), radius, self.low, SCENE_VOXEL, free)
        return replace(self, free=free)

    def hidden(self, points: Array, directions: Array) -> Array:
        """Centers (k, 3) of unobserved voxels that may belong to observed surfaces [m].

        They are connected to the surface through others. Each is behind it or beside its rim, as
        the point and the normal say from which it was come to. The surfaces are given by points
        (n, 3) and unit directions to the camera that saw these.
        """
        rows = np.hstack([points, directions])[self._voxels(points)[1]]
        keys = voxel_keys(rows[:, :3] - self.low + 0.5 * SCENE_VOXEL, SCENE_VOXEL)
        rows, _ = grouped_means(rows, keys, np.ones(len(rows)))
        at = np.ascontiguousarray(rows[:, :3])
        normals = _normals(at, rows[:, 3:], 2.5 * SCENE_VOXEL)
        found = _spread_kernel(self._voxels(at)[0], at, normals, self.low, SCENE_VOXEL, self.free)
        hidden: Array = self.low + SCENE_VOXEL * found
        return hidden

    def _voxels(self, points: Array) -> tuple[Indices, Mask]:
        """The voxels (m, 3) of those points (n, 3) that are inside the box, and which these are."""
        index = np.rint((points - self.low) / SCENE_VOXEL)
        inside = ((index >= 0) & (index < self.free.shape)).all(axis=1)
        return index[inside].astype(np.int64), np.asarray(inside)


def _normals(points: Array, directions: Array, radius: float) -> Array:
    """Unit normals (n, 3) on the side of ``directions``, of planes through neighbours.

    Fewer than two neighbours leave the direction itself.
    """
    n = len(points)
    i, j = cKDTree(points).query_pairs(radius, output_type="ndarray").T
    one_way = coo_matrix((np.ones(len(i)), (i, j)), shape=(n, n)).tocsr()
    sum_of = one_way + one_way.T + identity(n, format="csr")
    count = sum_of @ np.ones(n)
    mean = (sum_of @ points) / count[:, None]
    square = (sum_of @ np.einsum("ni,nj->nij", points, points).reshape(n, 9)) / count[:, None]
    covariance = square.reshape(n, 3, 3) - np.einsum("ni,nj->nij", mean, mean)
    normals: Array = np.linalg.eigh(covariance)[1][:, :, 0]
    normals = np.where(count[:, None] > 2, normals, directions)
    normals[np.einsum("ni,ni->n", normals, directions) < 0.0] *= -1.0
    return normals


@compiled
def _forget_kernel(come, reach, free):
    """Makes the cubes of voxels around each of ``come`` (m, 3) unknown."""
    for m in range(len(come)):
        low = [max(come[m, d] - reach, 0) for d in range(3)]
        free[
            low[0] : come[m, 0] + reach + 1,
            low[1] : come[m, 1] + reach + 1,
            low[2] : come[m, 2] + reach + 1,
        ] = False


@compiled
def _look_kernel(low, size, X_WC, pinhole, depth, margin, free):
    """Sets the voxels free that lie in front of what a camera measured."""
    fx, fy, cx, cy = pinhole
    height, width = depth.shape
    R, p = X_WC[:3, :3].copy(), X_WC[:3, 3].copy()
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            x, y, z = low[0] + size * i - p[0], low[1] + size * j - p[1], low[2] - p[2]
            u = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
            v = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
            w = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
            for k in range(free.shape[2]):
                if w > 0.0 and not free[i, j, k]:
                    column, row = np.rint(fx * u / w + cx), np.rint(fy * v / w + cy)
                    if 0 <= column < width and 0 <= row < height:
                        seen = depth[int(row), int(column)]
                        free[i, j, k] = w + margin + DEPTH_ERROR * w * w < seen
                u += size * R[2, 0]
                v += size * R[2, 1]
                w += size * R[2, 2]


@compiled
def _balls_kernel(center, radius, low, size, free):
    """Sets the voxels free whose middles lie inside balls."""
    for m in range(len(center)):
        first = [max(int(np.ceil((center[m, d] - radius[m] - low[d]) / size)), 0) for d in range(3)]
        last = [
            min(int(np.floor((center[m, d] + radius[m] - low[d]) / size)) + 1, free.shape[d])
            for d in range(3)
        ]
        for i in range(first[0], last[0]):
            for j in range(first[1], last[1]):
                for k in range(first[2], last[2]):
                    x = low[0] + size * i - center[m, 0]
                    y = low[1] + size * j - center[m, 1]
                    z = low[2] + size * k - center[m, 2]
                    if x * x + y * y + z * z <= radius[m] * radius[m]:
                        free[i, j, k] = True


@compiled
def _spread_kernel(voxels, points, normals, low, size, free):
    """Voxels (k, 3) that are neither free nor seen, spread to from surfaces, nearest ones first."""
    taken = free.copy()
    for m in range(len(voxels)):
        taken[voxels[m, 0], voxels[m, 1], voxels[m, 2]] = True
    queue = np.empty((free.size + len(voxels), 4), dtype=np.int32)
    for m in range(len(voxels)):
        queue[m, :3], queue[m, 3] = voxels[m], m
    count, head = len(voxels), 0
    while head < count:
        m = queue[head, 3]
        for side in range(6):
            i, j, k = queue[head, 0], queue[head, 1], queue[head, 2]
            step = 2 * (side % 2) - 1
            if side < 2:
                i += step
            elif side < 4:
                j += step
            else:
                k += step
            if not (0 <= i < free.shape[0] and 0 <= j < free.shape[1] and 0 <= k < free.shape[2]):
                continue
            if taken[i, j, k]:
                continue
            x = low[0] + size * i - points[m, 0]
            y = low[1] + size * j - points[m, 1]
            z = low[2] + size * k - points[m, 2]
            height = x * normals[m, 0] + y * normals[m, 1] + z * normals[m, 2]
            beside = x * x + y * y + z * z - height * height
            if -BEHIND <= height <= 0.5 * size and beside <= BESIDE * BESIDE:
                taken[i, j, k] = True
                queue[count, 0], queue[count, 1], queue[count, 2], queue[count, 3] = i, j, k, m
                count += 1
        head += 1
    return queue[len(voxels) : count, :3]
