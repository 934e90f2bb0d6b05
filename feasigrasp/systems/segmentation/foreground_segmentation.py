"""Segments the object in camera images: by their depth alone, or by a mask function."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem, ValueProducer
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from feasigrasp.errors import CameraError, ScenarioError
from feasigrasp.models.arrays import Array, Floats, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.objects.tracking import TrackerConfig, Tracking
from feasigrasp.models.segmentation.foreground import CameraView, Known, Label, segment
from feasigrasp.models.segmentation.modeled_bodies import Kind, ModeledBodies, in_color_gate
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_input,
    declare_output,
    evaluate,
    scalar,
    to_value,
    weakly,
)


class _Segmentation(LeafSystem):
    """Input ports of a camera's image, and of the arm at its instant."""

    def __init__(self, camera: Camera, bodies: ModeledBodies) -> None:
        super().__init__()
        self._camera, self._bodies = camera, bodies
        self._cloud = declare_input(self, "point_cloud", PointCloud())
        self._image_time = self.DeclareVectorInputPort("image_time", 1)
        self._camera_pose = declare_input(self, "camera_pose", RigidTransform())
        self._position = self.DeclareVectorInputPort("position", bodies.arm.joints)
        self._gripper = self.DeclareVectorInputPort("gripper_state", 2)

    def _time(self, context: Context) -> float:
        """When the image was taken [s]; NaN before the first."""
        return scalar(self._image_time, context, context.get_time())

    def _kinds(self, context: Context, points: Floats, X_WC: Array) -> NDArray[np.uint8]:
        """What is at each point (n, 3) by the modeled bodies, a `Kind`, shape (n,)."""
        q, opening = self._position.Eval(context), float(self._gripper.Eval(context)[0])
        return self._bodies.kinds(points, X_WC, q, opening, self._camera.depth_noise)

    def _image(self, labels: NDArray[np.int16] | Label) -> ImageLabel16I:
        image = ImageLabel16I(self._camera.width, self._camera.height)
        image.mutable_data[:, :, 0] = labels
        return image


class ForegroundSegmentation(_Segmentation):
    """Labels the pixels of a depth camera's point cloud: object, robot, surroundings.

    .. pydrake_system::

        name: ForegroundSegmentation
        input_ports: [point_cloud, image_time, camera_pose, position, gripper_state, object_pose,
          tracking, gpdf, color_image, depth_image]
        output_ports: [label_image, contradicted]

    ``point_cloud`` is pixel-ordered and in the world frame W, taken at ``image_time`` (V1) [s], NaN
    before the first image; without a time it is taken when it is read. Of the same instant are
    ``camera_pose`` X_WC, ``position`` V7 the measured joints [rad], and ``gripper_state`` V2 the
    measured distance between the pads [m] and its rate. ``object_pose`` X_WO and ``tracking`` come
    from the tracker, ``gpdf`` is the object's field in O, or None before there is one.
    ``color_image`` is of the same pixels, and needed only where the carrier of the object is found
    by its hue. ``label_image`` holds a `Label` for each pixel: it fits the port of the same name of
    `SegmentPointCloud` and `PointCloudToScene` as a label image of the simulation does. The method
    is in `models.segmentation.foreground`. ``depth_image``, optional, is of the same pixels: while
    the last three images looked through the cell, ``contradicted`` is true, and nothing is clear.
    """

    def __init__(
        self,
        camera: Camera,
        bodies: ModeledBodies,
        carrier_hue: float | None = None,
        *,
        period: float = TrackerConfig.image_period,
    ) -> None:
        """A segmentation of the images of a camera, by what is known of robot and cell.

        The hue of the carrier [deg] is None without a color gate. Until the first image it looks
        every ``period`` seconds.
        """
        super().__init__(camera, bodies)
        self._carrier_hue = carrier_hue
        self._object_pose = declare_input(self, "object_pose", RigidTransform())
        self._tracking = declare_input(self, "tracking", kind=Tracking)
        self._gpdf = declare_input(self, "gpdf", kind=Gpdf | None)
        self._color = declare_input(self, "color_image", ImageRgba8U(1, 1))
        # Time and view of the first image, for the detection of motion; None before.
        self._first = PeriodicState(self, (None, None), period, self._remember)
        self._depth = declare_input(self, "depth_image", ImageDepth32F(1, 1))
        # Time of the last image, and how many in succession looked through the cell.
        self._through = PeriodicState(self, (-np.inf, 0), period, self._compare)
        declare_output(self, "label_image", self._calc, model=ImageLabel16I(1, 1))
        declare_output(self, "contradicted", self._contradicted, {self._through})
        _compile(camera, bodies)

    def _view(self, context: Context) -> CameraView:
        points, camera = self._cloud.Eval(context).xyzs().T, self._camera
        if len(points) != camera.width * camera.height:
            raise ValueError(
                f"ForegroundSegmentation: {len(points)} points, but the camera has {camera.width} "
                f"x {camera.height} pixels; the cloud must have one point for each"
            )
        return CameraView(points, self._camera_pose.Eval(context).GetAsMatrix4())

    def _remember(self, context: Context) -> tuple[float | None, CameraView | None]:
        first, time = self._first.Eval(context), self._time(context)
        if first[0] is not None or not np.isfinite(time):
            return first
        view = self._view(context)
        return time, replace(view, points=view.points.copy())

    def _compare(self, context: Context) -> tuple[float, int]:
        before, count = self._through.Eval(context)
        time, X_WC = self._time(context), self._camera_pose.Eval(context).GetAsMatrix4()
        if not (time > before and self._depth.HasValue(context)):
            return before, count
        depth = self._depth.Eval(context).data[:, :, 0]
        through = self._bodies.looked_through(depth, X_WC, self._camera)
        return time, count if through is None else (count + 1) * through

    def _contradicted(self, context: Context) -> bool:
        return bool(self._through.Eval(context)[1] >= 3)

    def _calc(self, context: Context) -> ImageLabel16I:
        time, first = self._first.Eval(context)
        known = Known(
            field=evaluate(self._gpdf, context),
            X_WO=self._object_pose.Eval(context).GetAsMatrix4(),
            lost=self._tracking.Eval(context).lost,
            before=first,
            waited=0.0 if time is None else self._time(context) - time,
        )
        view = self._view(context)
        kinds = self._kinds(context, view.points, view.X_WC)
        if self._carrier_hue is not None:
            on_carrier = in_color_gate(self._color.Eval(context).data, self._carrier_hue)
            kinds[(kinds == Kind.FREE) & on_carrier] = Kind.CARRIER
        hand = self._bodies.hand(self._position.Eval(context))
        labels = segment(view, known, kinds, hand, self._camera)
        return self._image(Label.UNCLEAR if self._contradicted(context) else labels)


def _compile(camera: Camera, bodies: ModeledBodies) -> None:
    """Segments an image of a wall once, so that no kernel is compiled at the first image."""
    points = np.zeros((camera.width * camera.height, 3), dtype=np.float32)
    points[:, 0] = np.arange(len(points)) % camera.width * 1e-3
    points[:, 1] = np.arange(len(points)) // camera.width * 1e-3
    points[:, 2] = 0.5
    view, q = CameraView(points, np.eye(4)), bodies.arm.home
    kinds = bodies.kinds(view.points, view.X_WC, q, 0.0, camera.depth_noise)
    segment(view, Known(), kinds, bodies.hand(q), camera)


#: Which pixels show the object, shape (height, width): from the colors (height, width, 3) as
#: uint8, the depths (height, width) [m], infinite where nothing was measured, and the time when the
#: image was taken [s].
MaskFn = Callable[[NDArray[np.uint8], NDArray[np.float32], float], Mask]


class MaskSegmentation(_Segmentation):
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
        """A segmentation of the images of a camera, with the bodies of robot and cell.

        The mask function is called once for each image that is looked at, in the order of time. It
        must not change the arrays that it is given.

        Raises:
            ScenarioError: The mask cannot be called; later, a `CameraError` if what it returns is
                no mask of the image.
        """
        super().__init__(camera, bodies)
        if not callable(mask):
            raise ScenarioError(
                f"the segmentation is a {type(mask).__name__}; give a callable (color, depth, time)"
                " -> mask"
            )
        self._mask = mask
        self._color = declare_input(self, "color_image", ImageRgba8U(1, 1))
        # Time and labels of the last image: each is masked once, whoever reads it and when.
        last = ValueProducer(to_value((np.nan, None)).Clone, weakly(self._look))
        self._last = self.DeclareCacheEntry("labels of the last image", last).cache_index()
        declare_output(self, "label_image", self._calc, model=ImageLabel16I(1, 1))

    def _calc(self, context: Context) -> ImageLabel16I:
        return self.get_cache_entry(self._last).Eval(context)[1]

    def _look(self, context: Context, last: AbstractValue) -> None:
        time = self._time(context)
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
        kinds = self._kinds(context, points, X_WC).reshape(shape)
        seen = kinds != Kind.UNOBSERVED
        depth = np.full(shape, np.inf, dtype=np.float32)
        depth[seen] = (points[seen.ravel()] - X_WC[:3, 3]) @ X_WC[:3, 2]
        mask = np.zeros(shape, dtype=bool)
        if np.isfinite(time):
            mask = checked_mask(self._mask(color, depth, time), shape, self._mask)
        labels = np.where(mask, np.int16(Label.OBJECT), np.int16(Label.SURROUNDINGS))
        labels[kinds == Kind.ROBOT] = Label.ROBOT
        return self._image(labels)


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
