"""Keeps the pixels of one body of a pixel-ordered point cloud."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import RenderLabel
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.arrays import Mask
from feasigrasp.models.clouds.edges import EDGE_JUMP, GROWTH, edge_pixels, grown_mask
from feasigrasp.systems.ports import declare_input, declare_output

#: Labels of pixels that show nothing that is known: that of the world, and none.
_UNKNOWN = (0, int(RenderLabel.kEmpty))


class SegmentPointCloud(LeafSystem):
    """The part of a depth camera's point cloud that shows one body.

    .. pydrake_system::

        name: SegmentPointCloud
        input_ports:
        - point_cloud
        - label_image
        output_ports:
        - point_cloud

    ``point_cloud`` is pixel-ordered as ``DepthImageToPointCloud`` makes it, infinite where the
    camera saw nothing; ``label_image`` holds the label of the body in each pixel. The output keeps
    the frame of the input and contains finite points only; it may be empty.

    Pixels on the edge of a surface are dropped: there a real camera mixes the depths of two
    surfaces, and the label is a guess. Where the body touches another one, and the depth does not
    jump, nothing is lost. A mask of a few pixels only is grown along the surface that it is on.
    """

    def __init__(self, label: int, *, edge_jump: float | None = EDGE_JUMP) -> None:
        """Keeps the pixels whose label is ``label`` (Drake's cameras label by body index).

        Args:
            label: The body's label.
            edge_jump: Points of neighbouring pixels that are farther apart than this [m] lie on
                different surfaces; None keeps the pixels at edges too.
        """
        super().__init__()
        self.label, self._edge_jump = label, edge_jump
        self._cloud_input = declare_input(self, "point_cloud", PointCloud())
        self._label_input = declare_input(self, "label_image", ImageLabel16I(1, 1))
        declare_output(self, "point_cloud", self._calc, model=PointCloud())

    def _calc(self, context: Context) -> PointCloud:
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
        if self._edge_jump is None:
            keep = of_body & seen
        else:
            unknown = np.isin(labels[around], _UNKNOWN)
            of_body = grown_mask(points, of_body, unknown, self._edge_jump)
            keep = of_body & seen & ~edge_pixels(points, seen, of_body, self._edge_jump)
        chosen = points[:, keep]
        cloud = PointCloud(chosen.shape[1])
        cloud.mutable_xyzs()[:] = chosen
        return cloud


def _box_about(mask: Mask) -> tuple[slice, slice]:
    """Rows and columns that show a mask, and `GROWTH` and one more on each side, no further."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return slice(0), slice(0)
    a, b = (slice(max(at[0] - GROWTH - 1, 0), at[-1] + GROWTH + 2) for at in (rows, columns))
    return a, b
