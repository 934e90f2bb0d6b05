"""Fits the arm's capsules around its visible links; prints what capsules.py holds.

    python tools/fit_capsules.py

Per link the capsules of least joint volume are searched such that every vertex of the visible mesh
lies in one of them. The links are mirror-symmetric: segments lie in the plane of symmetry. A
candidate is a few segments, each with an offset: every vertex belongs to the segment with the
smallest distance less offset, and a segment's radius is that of the farthest vertex that belongs to
it. So every candidate encloses the mesh, and the volume can be minimised without constraints, from
random starts by Nelder and Mead's method. Lengths are rounded to millimetres, radii up.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh
from scipy.optimize import minimize

from feasigrasp.models.arrays import Array
from feasigrasp.resources import model_path

#: Capsules of each shape, the link that shows it, the coordinate that its symmetry leaves out, and
#: whether the first capsule is a tube along the joint's axis (where it does not move with joint 1,
#: and then costs reachability less). Links 3 and 4 are links 1 and 2 mirrored.
SHAPES = {"base": (2, 0, 1, True), "link 1": (2, 1, 0, True), "link 2": (2, 2, 0, True)}
SHAPES |= {"link 5": (2, 5, 0, True), "link 6": (2, 6, 0, False), "link 7": (1, 7, 0, True)}
#: Step of the grid on which volumes are counted, and how far a capsule may stand out [m].
STEP, AROUND = 0.010, 0.06
ROUNDS = 4


def vertices(name: str) -> Array:
    """Vertices of a mesh of the cell in the frame of its body, shape (n, 3) [m]."""
    mesh = trimesh.load_mesh(model_path("iiwa", "meshes", f"{name}.gltf"), process=False)
    return np.asarray(mesh.vertices[:, [0, 2, 1]] * [1, -1, 1])  # glTF is y up


def segment_distances(points: Array, ends: Array) -> Array:
    """Distances of points (n, 3) to segments (k, 2, 3), shape (k, n)."""
    along = ends[:, 1] - ends[:, 0]
    square = np.maximum((along**2).sum(1), 1e-18)[:, None]
    offset = points[None] - ends[:, :1]
    t = np.clip(np.einsum("kni,ki->kn", offset, along) / square, 0.0, 1.0)
    return np.linalg.norm(offset - t[..., None] * along[:, None], axis=2)


class Fit:
    """Capsules around the vertices of one link."""

    def __init__(self, points: Array, flat: int, tube: bool, floor: float) -> None:
        """Capsules around ``points`` (n, 3), whose coordinate ``flat`` is zero at their axes.

        With ``tube`` the first of them lies on the z-axis. What lies below the height ``floor`` is
        no volume: nothing gets there.
        """
        self.tube = tube
        points = points[points[:, flat] >= -1e-6]  # the other half is the same
        low, high = points.min(0) - AROUND, points.max(0) + AROUND
        low[flat] = 0.5 * STEP
        low[2] = max(low[2], floor)
        axes = [np.arange(a, b, STEP) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self.points, self.all, self.grid = _thinned(points), points, grid
        self.axes = [axis for axis in range(3) if axis != flat]

    def capsules(self, x: Array) -> tuple[Array, Array]:
        """Ends (k, 2, 3) and radii (k,) of a candidate (k * 5,)."""
        x = x.reshape(-1, 5).copy()
        if self.tube:
            x[0, [0, 2]] = 0.0
        ends = np.zeros((len(x), 2, 3))
        ends[:, :, self.axes] = x[:, :4].reshape(-1, 2, 2)
        return ends, self.radii(ends, x[:, 4], self.points)

    @staticmethod
    def radii(ends: Array, offset: Array, points: Array) -> Array:
        """Radii (k,) with which segments (k, 2, 3) hold points (n, 3)."""
        distance = segment_distances(points, ends)
        owner = np.argmin(distance - offset[:, None], axis=0)
        return np.array(
            [np.max(distance[k], where=owner == k, initial=0) for k in range(len(ends))]
        )

    def volume(self, x: Array) -> float:
        """Volume of the union [l]."""
        ends, radii = self.capsules(x)
        inside = (segment_distances(self.grid, ends) < radii[:, None]).any(0)
        return 2e3 * STEP**3 * float(inside.sum())

    def best(self, n: int, rng: np.random.Generator) -> tuple[float, Array, Array]:
        """Volume [l], ends and radii of ``n`` capsules of least volume, in millimetres."""
        low, high = self.points[:, self.axes].min(0), self.points[:, self.axes].max(0)
        least, chosen = np.inf, np.zeros((n, 5))
        for _ in range(ROUNDS):
            ends = rng.uniform(low + 0.04, np.maximum(high - 0.04, low + 0.05), (n, 2, 2))
            ends[0, :, 1] = low[1] + 0.03, high[1] - 0.03  # along the link
            x = np.hstack([ends.reshape(n, 4), rng.uniform(0.05, 0.08, (n, 1))]).ravel()
            for size in (0.03, 0.01):
                simplex = x + size * np.vstack([np.zeros(len(x)), np.eye(len(x))])
                options = {"initial_simplex": simplex, "fatol": 0.003, "xatol": 1e-3}
                x = minimize(self.volume, x, method="Nelder-Mead", options=options).x
            volume = self.volume(x)
            if volume < least:
                least, chosen = volume, x.reshape(n, 5)
        rounded = np.hstack([chosen[:, :4].round(3), chosen[:, 4:]])
        ends, _ = self.capsules(rounded.ravel())
        radii = self.radii(ends, rounded[:, 4], self.all)
        return least, ends, np.ceil(1e3 * radii - 1e-6) / 1e3


def _thinned(points: Array) -> Array:
    """One point of every cube of 6 mm: the search is quicker, and the result is for all points."""
    _, chosen = np.unique((points / 0.006).round(), axis=0, return_index=True)
    return points[np.sort(chosen)]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", nargs="*", default=list(SHAPES), choices=list(SHAPES))
    parser.add_argument("--capsules", type=int, help="so many of each shape")
    chosen = parser.parse_args()
    for shape in chosen.shapes:
        n, link, flat, tube = SHAPES[shape]
        points = vertices(f"link_{link}")
        fit = Fit(points, flat, tube, 0.0 if link == 0 else -np.inf)
        volume, ends, radii = fit.best(chosen.capsules or n, np.random.default_rng(0))
        hull = 1e3 * trimesh.convex.convex_hull(points).volume
        print(f"{shape}: {volume:.2f} l (convex hull {hull:.2f} l)")
        for (a, b), radius in sorted(zip(ends.tolist(), radii.tolist(), strict=True), key=str):
            print(f"    {a} {b} {radius:.3f}", flush=True)


if __name__ == "__main__":
    main()
