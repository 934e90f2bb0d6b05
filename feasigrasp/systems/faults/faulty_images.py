"""Fault injection into depth images and object masks."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.faults.images import CloudFault, MaskFault, View
from feasigrasp.systems.ports import declare_input, declare_output

#: Label of a pixel that is no longer taken for the object: that of the world.
_OTHER = 0


class FaultyCloud(LeafSystem):
    """Passes a camera's point cloud on, but for a fault.

    .. pydrake_system::

        name: FaultyCloud
        input_ports:
        - point_cloud
        - label_image
        - camera_pose
        output_ports:
        - point_cloud

    Clouds are pixel-ordered and in the world; ``label_image`` is the true one of the same camera,
    ``camera_pose`` X_WC a ``RigidTransform``. What is random depends on seed and time only.
    """

    def __init__(self, fault: CloudFault, label: int, seed: int = 0) -> None:
        """A fault of a camera that sees the object under ``label``."""
        super().__init__()
        self._fault, self._label, self._seed = fault, label, seed
        self._cloud = declare_input(self, "point_cloud", PointCloud())
        self._labels = declare_input(self, "label_image", ImageLabel16I(1, 1))
        self._pose = declare_input(self, "camera_pose", RigidTransform())
        declare_output(self, "point_cloud", self._calc, model=PointCloud())

    def _calc(self, context: Context) -> PointCloud:
        cloud, time = self._cloud.Eval(context), context.get_time()
        if not self._fault.active(time):
            return cloud
        X_WC = self._pose.Eval(context)
        view = View(
            cloud.xyzs().astype(float),
            self._labels.Eval(context).data.reshape(-1) == self._label,
            X_WC.translation(),
            X_WC.rotation().col(2),
        )
        faulty = PointCloud(cloud.size())
        faulty.mutable_xyzs()[:] = self._fault.seen(view, _rng(self._seed, time))
        return faulty


class FaultyMask(LeafSystem):
    """Passes a label image on, but for a fault of the pixels of one body.

    .. pydrake_system::

        name: FaultyMask
        input_ports:
        - label_image
        output_ports:
        - label_image

    A pixel that is no longer taken for the body counts as the world.
    """

    def __init__(self, fault: MaskFault, label: int) -> None:
        """A fault of the mask of the body with that label."""
        super().__init__()
        self._fault, self._label = fault, label
        self._input = declare_input(self, "label_image", ImageLabel16I(1, 1))
        declare_output(self, "label_image", self._calc, model=ImageLabel16I(1, 1))

    def _calc(self, context: Context) -> ImageLabel16I:
        image = self._input.Eval(context)
        if not self._fault.active(context.get_time()):
            return image
        labels = image.data[:, :, 0]
        of_object = labels == self._label
        mask = self._fault.mask(of_object)
        faulty = ImageLabel16I(image.width(), image.height())
        others = np.where(of_object, _OTHER, labels)
        faulty.mutable_data[:, :, 0] = np.where(mask, self._label, others)
        return faulty


def _rng(seed: int, time: float) -> np.random.Generator:
    return np.random.default_rng([seed, round(1e6 * time)])
