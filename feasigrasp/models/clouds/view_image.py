"""Silhouette and depth image of one view, rendered from its points, and the free space it shows.

The picture is that of a virtual camera at the real one's position, which looks at the middle of
the points and just contains them. So it needs neither the real camera's intrinsics nor its
picture, and says the same in any frame. Space is free beside the silhouette and before the surface
(silhouette carving).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation, convolve, distance_transform_edt, gaussian_filter
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.clouds.camera import looking_along, projected
from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.points import farthest_points

#: The points of a view miss the true edge by about this many pixels of the camera: edge pixels are
#: dropped, and so are pixels at a grazing angle. Source: guessed.
EDGE_PIXELS = 1.0


def free_distance(views: Sequence[ViewImage], x: Array) -> Array:
    """Depth of points inside observed free space: a lower bound of their distance to the object.

    Beside the silhouette that is the distance to its rim, if it is whole, in front of the seen
    surface the depth to it; of several views the largest counts. For points x (n, 3) in O, shape
    (n,) [m]; zero or negative where nothing is known.
    """
    best = np.full(len(x), -np.inf)
    points = np.ascontiguousarray(x, dtype=float)
    for view in views:
        edge = EDGE_PIXELS * view.pitch
        picture = (view.mask, view.front, view.beside)
        _raise_to_free(points, view.X_OC, view.pixel, edge, view.whole, picture, best)
    return best


@compiled(nogil=True)
def _raise_to_free(points, X_OC, pixel, edge, whole, picture, best):
    """Raises ``best`` (n,) to how deep the points (n, 3) lie in the free space of one view."""
    mask, front, beside = picture
    for i in range(len(points)):
        a, b, c = points[i, 0] - X_OC[0, 3], points[i, 1] - X_OC[1, 3], points[i, 2] - X_OC[2, 3]
        u = a * X_OC[0, 0] + b * X_OC[1, 0] + c * X_OC[2, 0]
        v = a * X_OC[0, 1] + b * X_OC[1, 1] + c * X_OC[2, 1]
        w = a * X_OC[0, 2] + b * X_OC[1, 2] + c * X_OC[2, 2]
        z = max(w, 1e-6)
        u_at, v_at = u / z / pixel + 0.5 * (SIDE - 1), v / z / pixel + 0.5 * (SIDE - 1)
        column = int(min(max(np.rint(u_at), 0.0), SIDE - 1.0))
        row = int(min(max(np.rint(v_at), 0.0), SIDE - 1.0))
        if mask[row, column]:
            free = front[row, column] - z
        elif not whole:
            continue
        else:
            du, dv = u_at - column, v_at - row
            if max(abs(du), abs(dv)) > 0.5:  # outside the picture, which has a margin
                outside = np.sqrt(du * du + dv * dv) + MARGIN - 2.0
            else:
                outside = beside[row, column] - 0.5
            oblique = z / np.sqrt(u * u + v * v + w * w)
            free = (outside * pixel - edge) * z * oblique
        best[i] = max(best[i], free)


def rim_points(view: ViewImage, count: int) -> Array:
    """At most ``count`` points (n, 3) in free space just outside a silhouette, if it is whole [m].

    There the object's hidden side begins. They lie on lines of sight spread evenly round the
    silhouette, at the depth of its rim and a part of the object's width behind it: there a surface
    that bulges out of the silhouette would be. Further back the distance to the silhouette says
    little about that to the object, and holding it there as a value makes the field invent.
    """
    # Depths of the nodes behind the rim of the silhouette, as a share of the object's width.
    rim_depths = (0.0, 0.4)
    if not view.whole:
        return np.zeros((0, 3))
    at = EDGE_PIXELS * view.pitch / view.pixel + 1.5
    row, column = np.nonzero((view.beside >= at) & (view.beside < at + 1.0))
    if len(row) == 0:
        return np.zeros((0, 3))
    ring = np.stack([row, column, np.zeros_like(row)], axis=1).astype(float)
    chosen = farthest_points(ring, min(max(count // len(rim_depths), 1), len(ring)))
    pixels = row[chosen], column[chosen]
    nearest_row, nearest_column = view.nearest[:, *pixels]
    rim = view.depth[nearest_row, nearest_column]
    half_width = float(distance_transform_edt(view.mask).max()) * view.pixel * rim.mean()
    return np.concatenate(
        [view.unproject(pixels, rim + 2.0 * share * half_width) for share in rim_depths]
    )


#: Pixels along each side. Source: layout: input of the hidden-side network.
SIDE = 40
#: Pixels between the silhouette and the border. Source: layout: input of the hidden-side network.
MARGIN = 4
#: A pixel and its eight neighbours. Source: layout.
_AROUND = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, eq=False)
class ViewImage:
    """Silhouette and depth.

    Attributes:
        X_OC: Pose of the virtual camera, z towards the middle of the points, shape (4, 4).
        pixel: Width of a pixel in the plane z = 1.
        pitch: Width of a pixel of the real camera in the plane z = 1.
        mask: Which pixels show the object, shape (SIDE, SIDE).
        depth: Mean depth along z, shape (SIDE, SIDE) [m], inpainted where it was not measured; 0
            outside the mask.
        front: Depth where the surface begins that a pixel shows, less than the mean where it is
            steep or has steps, shape (SIDE, SIDE) [m]; 0 where it was not measured.
        measured: Which pixels have a depth of their own, shape (SIDE, SIDE).
        whole: Whether the object ends where the silhouette does. If the picture ends there, or
            something hides the rest, only what is before the seen surface is known to be free.
        unclear: Pixels that may show a part of the object that was not measured, or is hidden,
            shape (SIDE, SIDE).
        ends: Whether the object ends in the picture, by what the camera saw without measuring it.
        careful: Whether what is unclear counts as the silhouette's when asked what is beside it.
    """

    X_OC: Array
    pixel: float
    pitch: float
    mask: Mask
    depth: Array
    front: Array
    measured: Mask
    whole: bool = True
    unclear: Mask = field(default_factory=lambda: np.zeros((SIDE, SIDE), dtype=bool))
    ends: bool = True
    careful: bool = False

    @cached_property
    def reliable(self) -> ViewImage:
        """The view without free space where the object may have been."""
        return replace(self, whole=self.whole and self.ends, careful=True)

    @cached_property
    def beside(self) -> Array:
        """Distance from every pixel to the silhouette, 0 in it, shape (SIDE, SIDE) [pixels]."""
        of_object = self.mask | self.unclear if self.careful else self.mask
        return np.asarray(distance_transform_edt(~of_object))

    @cached_property
    def nearest(self) -> Indices:
        """Row and column of the silhouette's pixel nearest to every pixel, (2, SIDE, SIDE)."""
        found: Indices = distance_transform_edt(
            ~self.mask, return_distances=False, return_indices=True
        )
        return found

    @cached_property
    def deviation(self) -> Array:
        """Expected error of the depth, shape (SIDE, SIDE) [m]: 0 where it was measured.

        The distance to what was measured; a surface at 45 degrees is as far from the filled one.
        """
        apart: Array = distance_transform_edt(~self.measured)
        return apart * self.pixel * self.depth

    def project(self, x: Array) -> tuple[Indices, Indices, Array, Mask]:
        """Pixel coordinates of points (n, 3) given in O.

        Row and column, at the border for those outside; depth along z [m]; and which are in the
        picture; shape (n,) each.
        """
        u, v, z = ((x - self.X_OC[:3, 3]) @ self.X_OC[:3, :3]).T
        scale = np.maximum(z, 1e-6)
        column = np.rint(u / scale / self.pixel + 0.5 * (SIDE - 1)).astype(int)
        row = np.rint(v / scale / self.pixel + 0.5 * (SIDE - 1)).astype(int)
        inside = (row >= 0) & (row < SIDE) & (column >= 0) & (column < SIDE)
        return np.clip(row, 0, SIDE - 1), np.clip(column, 0, SIDE - 1), z, inside

    def moved(self, X: Array) -> ViewImage:
        """The view after a rigid motion X of object and camera, shape (4, 4)."""
        return replace(self, X_OC=X @ self.X_OC)

    def rays(self) -> Array:
        """Direction of every pixel's line of sight in C with z = 1, shape (SIDE, SIDE, 3)."""
        at = (np.arange(SIDE) - 0.5 * (SIDE - 1)) * self.pixel
        x, y = np.meshgrid(at, at)
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def unproject(self, pixels: tuple[Indices, ...], depth: Array) -> Array:
        """Points in O at depths (k,) along the lines of sight of pixels (rows, columns), (k, 3)."""
        points_C = self.rays()[pixels] * depth[:, None]
        return np.asarray(points_C @ self.X_OC[:3, :3].T + self.X_OC[:3, 3])


def view_image(points: Array, p_OC: Array, outline: Outline | None = None) -> ViewImage:
    """Draws the picture of points (n, 3) of the object that a camera at p_OC (3,) saw, in O [m].

    The outline says where the object may go on; nowhere without it.
    """
    R = looking_along(points.mean(axis=0) - p_OC)
    unmeasured = np.zeros((0, 3)) if outline is None else outline.unmeasured
    # Turned once more, onto the center of what is visible.
    seen = np.concatenate([projected(points, p_OC, R)[0], _in_picture(unmeasured, R)])
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    R = looking_along(R @ np.append(middle, 1.0))
    at, depth_of = projected(points, p_OC, R)
    lost = _in_picture(unmeasured, R)
    pixel = 2.0 * float(max(np.abs(at).max(), np.abs(lost).max(initial=0.0))) / (SIDE - 2 * MARGIN)
    pixel = max(pixel, 1e-6)
    some = at[:: -(-len(at) // 200)]
    # A pixel's four neighbours are one pitch away; for points at random it is about the same.
    fourth = cKDTree(at).query(some, k=min(5, len(at)))[0][:, -1]
    pitch = float(np.clip(np.median(fourth), 0.05 * pixel, 4.0 * pixel))

    # Spread by the real pixel's width: closes the gaps between points and averages the noise.
    blur = max(0.6, 0.7 * pitch / pixel)
    mean = depth_of.mean()
    measured, weight = _silhouette(at, pixel, pitch, blur)
    total, square = (
        gaussian_filter(part, blur, mode="constant") / np.maximum(weight, 1e-12)
        for part in (_counted(at, pixel, (depth_of - mean) ** power) for power in (1, 2))
    )
    # Scatter of depths that says nothing about the surface [m].
    steep = np.sqrt(3.0 * np.maximum(square - total**2 - 2e-3**2, 0.0))
    X_OC = np.eye(4)
    X_OC[:3, :3], X_OC[:3, 3] = R, p_OC
    depth, front = (np.where(measured, part, 0.0) for part in (mean + total, mean + total - steep))
    mask = measured
    if len(lost):
        mask = measured | _silhouette(lost, pixel, pitch, blur)[0]
        depth = _inpainted(depth, measured, mask)
    image = ViewImage(X_OC, pixel, pitch, mask, depth, front, measured)
    return image if outline is None else _outlined(image, outline)


def _in_picture(rays: Array, R: Array) -> Array:
    """Positions (n, 2) in the plane z = 1 of lines of sight before the camera."""
    in_camera = rays @ R
    # Nearer to the image plane they would be out of every picture, or behind the camera.
    before = in_camera[:, 2] > 0.1 * np.linalg.norm(in_camera, axis=1)
    return np.asarray(in_camera[before, :2] / in_camera[before, 2:])


def _counted(at: Array, pixel: float, values: Array | None = None) -> Array:
    """Sums of values, or numbers, of what is at positions (n, 2), by pixel, (SIDE, SIDE)."""
    column, row = np.rint(at / pixel + 0.5 * (SIDE - 1)).astype(int).T
    inside = (row >= 0) & (row < SIDE) & (column >= 0) & (column < SIDE)
    flat = (row * SIDE + column)[inside]
    sums = np.bincount(flat, None if values is None else values[inside], minlength=SIDE * SIDE)
    return np.asarray(sums.reshape(SIDE, SIDE), dtype=float)


def _silhouette(at: Array, pixel: float, pitch: float, blur: float) -> tuple[Mask, Array]:
    """The pixels that positions (n, 2) of the camera's pixels cover, and their blurred number."""
    count = _counted(at, pixel)
    weight = gaussian_filter(count, blur, mode="constant")
    # A pixel deep in the silhouette has the weight 1 / pitch^2 per pixel^2, one at its rim half.
    mask = weight > 0.3 * (pixel / pitch) ** 2
    # What is thinner than a pixel weighs less, and is there all the same.
    apart = (count > 0.0) & ~binary_dilation(mask, _AROUND)
    return mask | ((count > 0.0) & binary_dilation(apart, _AROUND)), weight


def _inpainted(depth: Array, measured: Mask, mask: Mask) -> Array:
    """Depths of all pixels of a mask: harmonic inpainting of those that were not measured.

    Jacobi's iteration of Laplace's equation: every one is the mean of its neighbours in the mask,
    and what was measured are the boundary values. It begins at the nearest of these; one sweep per
    pixel of the side leaves the largest holes short of convergence.
    """
    nearest = distance_transform_edt(~measured, return_distances=False, return_indices=True)
    filled = np.where(mask, depth[nearest[0], nearest[1]], 0.0)
    around = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    neighbours = np.maximum(convolve(mask.astype(float), around, mode="constant"), 1.0)
    for _ in range(SIDE):
        mean = convolve(filled, around, mode="constant") / neighbours
        filled = np.where(mask & ~measured, mean, filled)
    return filled


def _outlined(image: ViewImage, outline: Outline) -> ViewImage:
    """With what the outline says that may be the object."""
    rays = np.concatenate([outline.unmeasured, outline.hidden])
    row, column, z, inside = image.project(image.X_OC[:3, 3] + rays)
    inside &= z > 0.0
    unclear = np.zeros_like(image.mask)
    unclear[row[inside], column[inside]] = True
    if image.pitch > 0.7 * image.pixel:  # lines of sight miss pixels between them
        unclear = binary_dilation(unclear, _AROUND)
    return replace(image, unclear=unclear, ends=outline.whole)
