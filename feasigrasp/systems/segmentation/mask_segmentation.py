"""Segments the object by a mask function, such as a network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem, ValueProducer
from pydrake.systems.sensors import ImageLabel16I, ImageRgba8U

from feasigrasp.errors import CameraError, ScenarioError
from feasigrasp.models.arrays import Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.models.segmentation.modeled_bodies import Kind, ModeledBodies
from feasigrasp.systems.ports import declare_input, declare_output, scalar, to_value, weakly

#: Which pixels show the object, shape (height, width): from the colors (height, width, 3) as
#: uint8, the depths (height, width) [m], infinite where nothing was measured, and the time when the
#: image was taken [s].
MaskFn = Callable[[NDArray[np.uint8], NDArray[np.float32], float], Mask]


class MaskSegmentation(LeafSystem):
    """Labels the pixels of a camera: the object by a mask function, the robot by its joints.

    .. pydrake_system::

        name: MaskSegmentation
        input_ports: [point_cloud, image_time, camera_pose, position, gripper_state, color_image]
        output_ports: [label_image]

    The ports are those of the same name of `ForegroundSegmentation`, whose place it takes.
    ``label_image`` holds a `Label` for each pixel: `Label.OBJECT` where the mask is true and the
    pixel shows nothing of the robot. Before the first image nothing is the object.
    """

    def __init__(self, mask: MaskFn, camera: Camera, bodies: ModeledBodies) -> None:
        """A segmentation of the images of a camera.

        Args:
            mask: The function. It is called once for each image that is looked at, in the order of
                time. It must not change the arrays that it is given.
            camera: The camera.
            bodies: The robot and its cell.

        Raises:
            ScenarioError: The mask cannot be called; later, a `CameraError` if what it returns is
                no mask of the image.
        """
        super().__init__()
        if not callable(mask):
            raise ScenarioError(
                f"the segmentation is a {type(mask).__name__}; give a callable (color, depth, time)"
                " -> mask"
            )
        self._mask, self._camera, self._bodies = mask, camera, bodies
        self._cloud = declare_input(self, "point_cloud", PointCloud())
        self._image_time = self.DeclareVectorInputPort("image_time", 1)
        self._camera_pose = declare_input(self, "camera_pose", RigidTransform())
        self._position = self.DeclareVectorInputPort("position", bodies.arm.joints)
        self._gripper = self.DeclareVectorInputPort("gripper_state", 2)
        self._color = declare_input(self, "color_image", ImageRgba8U(1, 1))
        # Time and labels of the last image: each is masked once, whoever reads it and when.
        last = ValueProducer(to_value((np.nan, None)).Clone, weakly(self._look))
        self._last = self.DeclareCacheEntry("labels of the last image", last).cache_index()
        declare_output(self, "label_image", self._calc, model=ImageLabel16I(1, 1))

    def _calc(self, context: Context) -> ImageLabel16I:
        return self.get_cache_entry(self._last).Eval(context)[1]

    def _look(self, context: Context, last: AbstractValue) -> None:
        time = scalar(self._image_time, context, context.get_time())
        if time != last.get_value()[0]:  # nor is NaN, before the first image
            last.set_value((time, self._labels(context, time)))

    def _labels(self, context: Context, time: float) -> ImageLabel16I:
        camera, shape = self._camera, (self._camera.height, self._camera.width)
        points = self._cloud.Eval(context).xyzs().T
        color = self._color.Eval(context).data[:, :, :3]
        if (len(points), color.shape[:2]) != (camera.width * camera.height, shape):
            raise CameraError(
                f"MaskSegmentation: {len(points)} points and an image of {color.shape[1]} x "
                f"{color.shape[0]} pixels, but the camera has {camera.width} x {camera.height}"
            )
        X_WC = self._camera_pose.Eval(context).GetAsMatrix4()
        q, opening = self._position.Eval(context), float(self._gripper.Eval(context)[0])
        kinds = self._bodies.kinds(points, X_WC, q, opening, camera.depth_noise).reshape(shape)
        seen = kinds != Kind.UNOBSERVED
        depth = np.full(shape, np.inf, dtype=np.float32)
        depth[seen] = (points[seen.ravel()] - X_WC[:3, 3]) @ X_WC[:3, 2]
        mask = np.zeros(shape, dtype=bool)
        if np.isfinite(time):
            mask = checked_mask(self._mask(color, depth, time), shape, self._mask)
        labels = np.where(mask, np.int16(Label.OBJECT), np.int16(Label.SURROUNDINGS))
        labels[kinds == Kind.ROBOT] = Label.ROBOT
        image = ImageLabel16I(camera.width, camera.height)
        image.mutable_data[:, :, 0] = labels
        return image


def checked_mask(mask: Any, shape: tuple[int, int], made_by: Any) -> Mask:
    """The result of a mask function, checked for type and shape.

    Raises:
        CameraError: It is none.
    """
    if isinstance(mask, np.ndarray) and mask.shape == shape and mask.dtype == bool:
        return mask
    what = type(mask).__name__
    if isinstance(mask, np.ndarray):
        what = f"an array of {mask.dtype} of shape {mask.shape}"
    named = made_by if hasattr(made_by, "__qualname__") else type(made_by)
    raise CameraError(
        f"the segmentation {named.__module__}.{named.__qualname__} returned {what}; have it "
        f"return a bool array of shape {shape}, height and width of the image, true where the "
        "object is"
    )
