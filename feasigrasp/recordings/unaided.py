"""Tracks an object in depth and color images alone, without robot or cell.

The object of the first image is what a mask shows, what is in a box, or what is
nearest to the camera. The plane under it is found in every image, and is never of it. Once the
object has a field it is followed by that (`feasigrasp.models.segmentation.foreground`); when it is
not found where it was expected, it is searched for by the color learnt from the first image, and
by its size.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.clouds.camera import Camera, unproject
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels, smeared_pixels
from feasigrasp.models.geometry import se3
from feasigrasp.models.segmentation.components import find_components
from feasigrasp.models.segmentation.foreground import CameraView, Known, Label, segment
from feasigrasp.models.segmentation.modeled_bodies import SIGMAS, ColorHistogram, Kind
from feasigrasp.models.segmentation.tabletop import support_plane, table_plane
from feasigrasp.models.tracking.tracker import SequenceTracker
from feasigrasp.models.tracking.view import ObjectView


class _Expected(NamedTuple):
    """Where the object is expected, how far off that may be [m], and since when unseen [s]."""

    X_WO: Array
    slack: float
    age: float

    @property
    def lost(self) -> bool:
        """Whether it has to be searched for: after two images at 15 Hz."""
        return self.age > 0.1


class TrackerImage(NamedTuple):
    """One image for an `UnaidedTracker`.

    Attributes:
        depth: 0 or not finite where nothing was measured, shape (height, width) [m].
        X_WC: Pose of the camera, z forward, shape (4, 4); an image without (NaN) is left out.
        time: When it was taken [s].
        mask: Which pixels show the object, if given, shape (height, width).
        color: Colors of the same pixels, if there are any, shape (height, width, 3).
    """

    depth: Array
    X_WC: Array
    time: float
    mask: Mask | None = None
    color: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class UnaidedTracker(Frozen):
    """A tracker of whatever is before a camera, image by image.

    Attributes:
        camera: The camera.
        on_table: Whether the plane under what is nearest in the first image is a table.
        box: Rectangle about the object in the first image: first column and row, last
            ones, shape (4,) [px].
        tracker: The tracker.
        plane: What the object stands on, in the world, shape (4,); None before the first image, or
            without one.
        colors: The object's color; None before, and without color images.
        X_WO: Where the object was when the plane was found, shape (4, 4); None before.
    """

    camera: Camera
    on_table: bool = False
    box: Array | None = None
    tracker: SequenceTracker = field(default_factory=SequenceTracker)
    plane: Array | None = None
    colors: ColorHistogram | None = None
    X_WO: Array | None = None

    def looked(self, image: TrackerImage) -> UnaidedTracker:
        """Takes in an image, and merges it if it is worth it.

        Raises:
            PointCloudError: There is no table in the first image.
        """
        depth, X_WC, time, mask, color = image
        if not np.isfinite(X_WC).all():
            return self
        depth = np.where(np.isfinite(depth) & (depth > self.camera.near), depth, 0.0)
        expected = self._expected(time)
        window = np.s_[:, :] if mask is not None else self._window(X_WC, expected)
        part = replace(self, camera=self.camera.cropped(*window))
        color = None if color is None else color[window]
        now, points = part._segmented(image._replace(depth=depth[window], color=color), expected)
        view = ObjectView(self.camera, X_WC, points, depth)
        return replace(now, camera=self.camera, tracker=self.tracker.looked(view, time).learnt())

    def _window(self, X_WC: Array, expected: _Expected | None) -> tuple[slice, slice]:
        """Rows and columns of an image that may show the object."""
        gpdf = self.tracker.shape.gpdf
        if expected is None or gpdf is None or expected.lost:
            return np.s_[:, :]
        X_WO, slack, _ = expected
        body = (gpdf.points @ X_WO[:3, :3].T + X_WO[:3, 3] - X_WC[:3, 3]) @ X_WC[:3, :3]
        columns, rows = self.camera.pixels(body)
        left, right, top, bottom = columns.min(), columns.max(), rows.min(), rows.max()
        # Half as much again on every side, and by what the pose may err.
        more = 8.0 + 0.5 * max(right - left, bottom - top)
        more += self.camera.intrinsics[0] * slack / max(float(body[:, 2].min()), self.camera.near)
        return (
            _span(top - more, bottom + more + 1, self.camera.height),
            _span(left - more, right + more + 1, self.camera.width),
        )

    def _segmented(
        self, image: TrackerImage, expected: _Expected | None
    ) -> tuple[UnaidedTracker, Array]:
        """With the plane and the colors of an image, and the object's points, shape (n, 3)."""
        depth, X_WC, _, mask, color = image
        z = np.where(depth > 0.0, depth, np.nan)
        points_C = unproject(z, self.camera.intrinsics).reshape(3, -1).T
        points: Array = np.asarray(points_C @ X_WC[:3, :3].T + X_WC[:3, 3])
        seen: Mask = np.asarray(np.isfinite(points).all(axis=1))
        now = self._with_plane(points, seen, X_WC, expected, mask)
        kinds = now._kinds(points, seen, X_WC)
        if mask is None:
            chosen = now._object(CameraView(points, X_WC), kinds, expected, color)
        else:
            chosen = mask & (kinds != Kind.CELL).reshape(depth.shape)
        seen = seen.reshape(depth.shape)
        used = chosen & seen & ~smeared_pixels(depth, self.camera)
        used &= ~edge_pixels(points.T.reshape(3, *depth.shape), seen, chosen, EDGE_JUMP)
        if color is not None and now.colors is None and used.any():
            beside = ~binary_dilation(chosen, iterations=2)
            now = replace(now, colors=ColorHistogram.learnt(color, used, beside))
        return now, points[used.ravel()]

    def _expected(self, time: float) -> _Expected | None:
        """What is expected of an image; None before the first."""
        track = self.tracker.track
        if track.estimate is None:
            return None
        ahead = track.estimate.predicted(time)
        slack = float(np.sqrt(np.trace(ahead.covariance[3:6, 3:6]) / 3.0))
        return _Expected(ahead.X_WO, slack, track.age(time))

    def _with_plane(
        self, points: Array, seen: Mask, X_WC: Array, expected: _Expected | None, mask: Mask | None
    ) -> UnaidedTracker:
        """With the plane under the object in an image."""
        shape = self.camera.height, self.camera.width
        at = seen.reshape(shape).copy()
        if self.tracker.shape.gpdf is not None and expected is not None and mask is None:
            body = self.tracker.shape.gpdf.points
            body = body @ expected.X_WO[:3, :3].T + expected.X_WO[:3, 3]
            points_O = (points - expected.X_WO[:3, 3]) @ expected.X_WO[:3, :3]
            # What comes into view beside the field's surface is of the body, and no plane [m].
            beside = 0.005 + expected.slack
            low, high = self.tracker.shape.gpdf.bounds + np.array([[-beside], [beside]])
            with np.errstate(invalid="ignore"):  # NaN where nothing was measured
                at &= ~((points_O >= low) & (points_O <= high)).all(axis=1).reshape(shape)
        elif mask is None and self.on_table and self.plane is None and seen.any():
            return replace(self, plane=table_plane(points[seen], X_WC[:3, 3]))
        elif mask is not None or (self.box is not None and expected is None):
            inside = self._in_box() if mask is None else mask
            body = points[(at & inside).ravel()]
            at &= ~inside
        else:
            return self
        if len(body) == 0:
            return self
        guesses = []
        if self.plane is not None and expected is not None and self.X_WO is not None:
            moved = expected.X_WO @ se3.inverse(self.X_WO)  # the camera may move
            guesses = [self.plane, se3.inverse(moved).T @ self.plane]
        middle, size = np.median(body, axis=0), float(np.linalg.norm(np.ptp(body, axis=0)))
        around = points[at.ravel()]
        around = around[np.linalg.norm(around - middle, axis=1) < size]
        tolerance = float(self._foot(float((middle - X_WC[:3, 3]) @ X_WC[:3, 2])))
        plane = support_plane(around, body, X_WC[:3, 3], tolerance, guesses)
        if plane is None and guesses:
            plane = guesses[1]
        return replace(self, plane=plane, X_WO=None if expected is None else expected.X_WO)

    def _in_box(self) -> Mask:
        """The pixels of the box."""
        assert self.box is not None
        left, top, right, bottom = self.box
        inside = np.zeros((self.camera.height, self.camera.width), dtype=bool)
        inside[
            _span(top, bottom + 1, self.camera.height), _span(left, right + 1, self.camera.width)
        ] = True
        return inside

    def _foot(self, z: ArrayLike) -> Array:
        """What is no higher above the plane is of it, at depths z [m]."""
        # Where a body stands cameras smear from one to the other without a jump: with 5 mm a desk
        # is learnt as the foot of a cube.
        return 0.01 + SIGMAS * self.camera.depth_noise * np.square(z)

    def _kinds(self, points: Array, seen: Mask, X_WC: Array) -> NDArray[np.uint8]:
        kinds = np.where(seen, Kind.FREE, Kind.UNOBSERVED).astype(np.uint8)
        if self.plane is not None:
            height = points @ self.plane[:3] + self.plane[3]
            z = (points - X_WC[:3, 3]) @ X_WC[:3, 2]
            kinds[seen & ~(height > self._foot(z))] = Kind.CELL
        return kinds

    def _object(
        self,
        view: CameraView,
        kinds: NDArray[np.uint8],
        expected: _Expected | None,
        color: NDArray[np.uint8] | None,
    ) -> Mask:
        """The pixels of the object in an image."""
        likely = None if self.colors is None or color is None else self.colors.of(color)
        if expected is None and self.box is not None:
            inside = np.where(self._in_box().ravel() | (kinds == Kind.UNOBSERVED), kinds, Kind.CELL)
            bounded = self._labelled(view, Known(box=self.box), inside)
            # A box that shows fewer pixels points to an object. Source: guessed.
            if np.count_nonzero(bounded) >= 300:
                return bounded
        lost = expected is not None and expected.lost
        if lost and (found := self._searched(view, kinds, likely)) is not None:
            return found
        known = Known(box=self.box)
        if expected is not None:
            known = Known(self.tracker.shape.gpdf, expected.X_WO, slack=expected.slack)
        chosen = self._labelled(view, known, kinds)
        return chosen if likely is None else chosen & ~_of_other_color(likely)

    def _labelled(self, view: CameraView, known: Known, kinds: NDArray[np.uint8]) -> Mask:
        labels = segment(view, known, kinds.astype(np.uint8), view.X_WC[:3, 3], self.camera)
        return np.asarray(labels == Label.OBJECT)

    def _searched(
        self, view: CameraView, kinds: NDArray[np.uint8], likely: Array | None
    ) -> Mask | None:
        """The body that is most like the object by color and size; None if none is."""
        gpdf = self.tracker.shape.gpdf
        if gpdf is None or likely is None:
            return None
        free = (kinds == Kind.FREE) & ~_of_other_color(likely.ravel())
        parts = find_components(view.points, free, view.X_WC[:3, 3], self.camera)
        size = float(np.linalg.norm(np.ptp(gpdf.points, axis=0)))
        # What is as probable as this by its color, all in all, and of such a size may be it.
        of_color, smallest, largest = 0.5, 0.4, 1.6
        best, chosen = 0.0, None
        for group in parts.groups():
            samples = np.concatenate([parts.samples[k] for k in group])
            ratio = float(np.linalg.norm(np.ptp(samples, axis=0))) / size
            mask = parts.mask(group).reshape(likely.shape)
            alike = float(likely[mask].mean())
            score = alike * min(ratio, 1.0 / ratio)
            if alike >= of_color and smallest < ratio < largest and score > best:
                best, chosen = score, mask
        return chosen


def _of_other_color(likely: Array) -> Mask:
    """Mask of pixels that are not the object's, by probabilities of their colors."""
    return likely < 0.1


def _span(first: float, end: float, size: int) -> slice:
    """Rows or columns of an image that has ``size``, at least 8 of them."""
    begin = min(max(round(first), 0), size - 8)
    return slice(begin, min(max(round(end), begin + 8), size))
