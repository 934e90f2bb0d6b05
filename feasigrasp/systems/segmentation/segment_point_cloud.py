"""Selects the pixels of one body in an organized point cloud."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import RenderLabel
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I

from feasigrasp.errors import CameraError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.clouds.edges import (
    EDGE_JUMP,
    GROWTH,
    Outline,
    edge_pixels,
    grown_mask,
    outline,
    smeared_pixels,
)
from feasigrasp.models.quantities import Whole
from feasigrasp.systems.ports import declare_cache, declare_input, declare_output


class SegmentPointCloud(LeafSystem):
    """The part of a depth camera's point cloud that shows one body.

    .. pydrake_system::

        name: SegmentPointCloud
        input_ports: [point_cloud, label_image, depth_image]
        output_ports: [point_cloud, outline]

    ``point_cloud`` is pixel-ordered as ``DepthImageToPointCloud`` makes it, infinite where the
    camera saw nothing; ``label_image`` holds the label of the body in each pixel. The output keeps
    the frame of the input and contains finite points only; it may be empty.

    Pixels on the edge of a surface are dropped: there a real camera mixes the depths of two
    surfaces, and the label is a guess. Where the body touches another one, and the depth does not
    jump, nothing is lost. Of a camera that smears, those between two surfaces are dropped as well,
    see `smeared_pixels`, by ``depth_image`` of the same pixels; others have no such port. A mask of
    a few pixels only is grown along the surface that it is on.

    ``outline`` is an `Outline` in the camera's axes: where the body may go on although no point of
    it is in the cloud. It is None if the camera is not known.
    """

    @checked(CameraError)
    def __init__(
        self,
        label: Whole,
        *,
        camera: Camera | None = None,
        hiding: Collection[int] = (),
        smears: bool = False,
    ) -> None:
        """Keeps the pixels whose label is ``label`` (Drake's cameras label by body index).

        Args:
            label: The body's label.
            camera: The camera.
            hiding: Labels of what may be before the body.
            smears: Whether the camera's depth is between two surfaces over some pixels at edges.
        """
        super().__init__()
        self.label, self._camera = label, camera
        self._hiding = sorted(set(hiding) - {label})
        self._cloud_input = declare_input(self, "point_cloud", PointCloud())
        self._label_input = declare_input(self, "label_image", ImageLabel16I(1, 1))
        self._depth = declare_input(self, "depth_image", ImageDepth32F(1, 1)) if smears else None
        ports = self._cloud_input, self._label_input, self._depth
        inputs = {port for port in ports if port is not None}
        segmented = self._segmented = declare_cache(self, "segmented", self._calc, inputs)
        declare_output(self, "point_cloud", self._calc_cloud, {segmented}, model=PointCloud())
        declare_output(self, "outline", lambda context: segmented.Eval(context)[1], {segmented})

    def _calc_cloud(self, context: Context) -> PointCloud:
        points, _ = self._segmented.Eval(context)
        cloud = PointCloud(points.shape[1])
        cloud.mutable_xyzs()[:] = points
        return cloud

    def _calc(self, context: Context) -> tuple[NDArray[np.floating], Outline | None]:
        """Points of the body, shape (3, n) [m], and its outline."""
        xyz = self._cloud_input.Eval(context).xyzs()
        labels = self._label_input.Eval(context).data[:, :, 0]
        if xyz.shape[1] != labels.size:
            raise ValueError(
                f"SegmentPointCloud: {xyz.shape[1]} points but {labels.size} labels; the cloud and "
                "the label image must come from the same camera, pixel by pixel."
            )
        around = _box_about(labels == self.label)
        of_body = labels[around] == self.label
        points = xyz.reshape(3, *labels.shape)[:, *around]
        seen = np.isfinite(points).all(axis=0)
        # Labels of pixels that show nothing that is known: that of the world, and none.
        unknown = np.isin(labels[around], (0, int(RenderLabel.kEmpty)))
        of_body = grown_mask(points, of_body, unknown, EDGE_JUMP)
        keep = of_body & seen & ~edge_pixels(points, seen, of_body, EDGE_JUMP)
        if self._camera is None:
            return points[:, keep], None
        if self._depth is not None and self._depth.HasValue(context):
            depth = self._depth.Eval(context).data[*around, 0]
            keep &= ~smeared_pixels(depth, self._camera)
        hiding = np.isin(labels[around], self._hiding)
        corner = around[0].start or 0, around[1].start or 0
        return points[:, keep], outline(keep, of_body, hiding, corner, self._camera)


def _box_about(mask: Mask) -> tuple[slice, slice]:
    """Rows and columns that show a mask, and `GROWTH` and one more on each side, no further."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return slice(0), slice(0)
    a, b = (slice(max(at[0] - GROWTH - 1, 0), at[-1] + GROWTH + 2) for at in (rows, columns))
    return a, b
