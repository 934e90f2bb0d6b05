"""Tracks an object in depth images alone, without robot, cell or mask.

What stands on a table, if there is one, is separated from it by the plane; of that the object is
what somebody has drawn a box about, or what is nearest to the camera. Once it has a field it is
followed by that, see `feasigrasp.models.segmentation.foreground`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.clouds.camera import Camera, unproject
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels
from feasigrasp.models.segmentation.camera_view import CameraView
from feasigrasp.models.segmentation.foreground import Known, Label, segment
from feasigrasp.models.segmentation.modeled_bodies import CELL, FREE, MARGIN, SIGMAS, UNOBSERVED
from feasigrasp.models.segmentation.tabletop import table_plane
from feasigrasp.models.tracking.sequence import SequenceTracker
from feasigrasp.models.tracking.view import ObjectView


@dataclass(frozen=True, eq=False)
class UnaidedTracker(Frozen):
    """A tracker of whatever is before a camera, image by image.

    Attributes:
        camera: The camera.
        on_table: Whether the largest plane of the first image is a table, and not the object's.
        box: What somebody drew about the object in the first image: first column and row, last
            ones, shape (4,) [px].
        tracker: The tracker.
        plane: The table in the world, shape (4,); None before the first image, or without one.
    """

    camera: Camera
    on_table: bool = False
    box: Array | None = None
    tracker: SequenceTracker = field(default_factory=SequenceTracker)
    plane: Array | None = None

    def looked(
        self, depth: Array, X_WC: Array, time: float, mask: Mask | None = None
    ) -> UnaidedTracker:
        """Takes in an image, and merges it if it is worth it.

        Args:
            depth: 0 or not finite where nothing was measured, shape (height, width) [m].
            X_WC: Pose of the camera, z forward, shape (4, 4); an image without (NaN) is left out.
            time: When it was taken [s].
            mask: Which pixels show the object, if given, shape (height, width).

        Raises:
            PointCloudError: There is no table in the first image.
        """
        if not np.isfinite(X_WC).all():
            return self
        points = self._points(depth, X_WC)
        seen: Mask = np.asarray(np.isfinite(points).all(axis=1))
        now = self
        if self.on_table and self.plane is None and seen.any():
            now = replace(self, plane=table_plane(points[seen], X_WC[:3, 3]))
        chosen = now._object(points, seen, X_WC) if mask is None else mask
        used = chosen & seen.reshape(depth.shape)
        used &= ~edge_pixels(
            points.T.reshape(3, *depth.shape), seen.reshape(depth.shape), chosen, EDGE_JUMP
        )
        image = np.where(seen.reshape(depth.shape), depth, 0.0)
        view = ObjectView(self.camera, X_WC, points[used.ravel()], image)
        return replace(now, tracker=now.tracker.looked(view, time).learnt())

    def _points(self, depth: Array, X_WC: Array) -> Array:
        """By pixel in the world, NaN where nothing was measured, shape (n, 3) [m]."""
        z = np.where(np.isfinite(depth) & (depth > self.camera.near), depth, np.nan)
        points_C = unproject(z, self.camera.intrinsics).reshape(3, -1).T
        return np.asarray(points_C @ X_WC[:3, :3].T + X_WC[:3, 3])

    def _object(self, points: Array, seen: Mask, X_WC: Array) -> Mask:
        kinds = np.where(seen, FREE, UNOBSERVED).astype(np.uint8)
        if self.plane is not None:
            height = points @ self.plane[:3] + self.plane[3]
            z = (points - X_WC[:3, 3]) @ X_WC[:3, 2]
            margin = MARGIN + SIGMAS * self.camera.depth_noise * z**2
            kinds[seen & ~(height > margin)] = CELL
        estimate = self.tracker.track.estimate
        known = Known(
            self.tracker.shape.gpdf,
            None if estimate is None else estimate.X_WO,
            box=self.box if estimate is None else None,
        )
        view = CameraView(points, X_WC)
        labels = segment(view, known, kinds, X_WC[:3, 3], self.camera)
        return np.asarray(labels == Label.OBJECT)
