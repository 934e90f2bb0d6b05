"""Keeps the pixels of one body of a pixel-ordered point cloud."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageLabel16I


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
    """

    def __init__(self, label: int) -> None:
        """Keeps the pixels whose label is ``label`` (Drake's cameras label by body index)."""
        super().__init__()
        self._label = label
        self._cloud_input = self.DeclareAbstractInputPort(
            "point_cloud", AbstractValue.Make(PointCloud())
        )
        self._label_input = self.DeclareAbstractInputPort(
            "label_image", AbstractValue.Make(ImageLabel16I(1, 1))
        )
        self.DeclareAbstractOutputPort(
            "point_cloud", lambda: AbstractValue.Make(PointCloud()), self._calc
        )

    def _calc(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        xyz = self._cloud_input.Eval(context).xyzs()
        labels = self._label_input.Eval(context).data.reshape(-1)
        if xyz.shape[1] != labels.size:
            raise ValueError(
                f"SegmentPointCloud: {xyz.shape[1]} points but {labels.size} labels; the cloud and "
                "the label image must come from the same camera, pixel by pixel."
            )
        of_body = xyz[:, np.flatnonzero(labels == self._label)]
        seen = of_body[:, np.isfinite(of_body).all(axis=0)]
        cloud = PointCloud(seen.shape[1])
        cloud.mutable_xyzs()[:] = seen
        output.set_value(cloud)
