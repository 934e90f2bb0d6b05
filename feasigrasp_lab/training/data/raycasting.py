"""Rays cast at a triangle mesh, and distances from it, by Open3D on one thread."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import needed_by
from feasigrasp.models.arrays import Array, Mask


class Raycaster:
    """A mesh that can be asked where its surface is.

    Args:
        vertices: Shape (n, 3) [m].
        faces: Vertex indices, shape (m, 3).
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        with needed_by("casting rays at a mesh"):
            import open3d as o3d  # a slow import that most objects never need

        core: Any = o3d.core  # its stubs refuse typed arrays
        self._tensor = core.Tensor
        self._scene: Any = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._points(vertices), self._tensor(np.ascontiguousarray(faces, dtype=np.uint32))
        )

    def cast(self, starts: Array, directions: Array) -> tuple[Array, NDArray[np.uint32]]:
        """First intersections of rays with the surface.

        Args:
            starts: Shape (n, 3) [m].
            directions: Shape (n, 3).

        Returns:
            Length in units of the direction's, infinite without a hit, and the number of the face,
            one that does not exist without a hit; shape (n,) each.
        """
        rays = self._points(np.concatenate([starts, directions], axis=1))
        hit = self._scene.cast_rays(rays, nthreads=1)
        return np.asarray(hit["t_hit"].numpy(), dtype=float), hit["primitive_ids"].numpy()

    def depth_image(self, K: Array, X_CO: Array, width: int, height: int) -> Array:
        """Depth image of a perfect camera.

        Args:
            K: Its matrix, with pixel centres at halves, shape (3, 3) [px].
            X_CO: Pose of the mesh in the camera's frame, shape (4, 4).
            width: Pixels in a row.
            height: Pixels in a column.

        Returns:
            Depth along the optical axis, infinite without a hit, shape (height, width) [m].
        """
        rays = self._scene.create_rays_pinhole(self._tensor(K), self._tensor(X_CO), width, height)
        # The rays' directions have z = 1 in the camera's frame, so lengths along them are depths.
        return np.asarray(self._scene.cast_rays(rays, nthreads=1)["t_hit"].numpy(), dtype=float)

    def distance(self, points: ArrayLike) -> Array:
        """Unsigned distance of points (n, 3) from the surface, shape (n,) [m]."""
        found = self._scene.compute_distance(self._points(points), nthreads=1)
        return np.asarray(found.numpy(), dtype=float)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Distance of points (n, 3) from a closed surface, negative inside, shape (n,) [m]."""
        found = self._scene.compute_signed_distance(self._points(points), nthreads=1)
        return np.asarray(found.numpy(), dtype=float)

    def inside(self, points: ArrayLike) -> Mask:
        """Mask of points (n, 3) inside a closed surface, shape (n,)."""
        found = self._scene.compute_occupancy(self._points(points), nthreads=1)
        return np.asarray(found.numpy() > 0.5)

    def closest(self, points: ArrayLike) -> tuple[Array, NDArray[np.uint32]]:
        """Nearest points of the surface to points (n, 3), and the numbers of their faces (n,)."""
        found = self._scene.compute_closest_points(self._points(points), nthreads=1)
        return np.asarray(found["points"].numpy(), dtype=float), found["primitive_ids"].numpy()

    def _points(self, array: ArrayLike) -> Any:
        return self._tensor(np.ascontiguousarray(array, dtype=np.float32))
