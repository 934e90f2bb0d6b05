"""Messages of cameras and motion capture, sent by the simulated cell and received by a station."""

import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from drake import lcmt_image, lcmt_image_array, lcmt_robot_state
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.sensors import (
    CameraConfig,
    ConvertDepth32FTo16U,
    ImageDepth16U,
    ImageDepth32F,
    ImageLabel16I,
)

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.tracking import TrackerConfig, measured_pose
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.channels import POSE_NAMES, pixels
from feasigrasp.systems.ports import (
    add_connected,
    declare_cache,
    declare_input,
    declare_output,
    scalar,
    weakly,
)
from feasigrasp.systems.station.station import Station


class RgbdReceiver(LeafSystem):
    """Depth image and mask of one camera, and when they were taken.

    .. pydrake_system::

        name: RgbdReceiver
        input_ports: [message]
        output_ports: [depth_image, label_image, stamp]

    ``message`` is an ``lcmt_image_array``. ``depth_image`` is ``ImageDepth32F`` [m], 0 where the
    camera measured nothing, infinite where all is too far (65535 millimetres); ``label_image`` is
    ``ImageLabel16I``, all 0 if no mask came with the depth; ``stamp`` is V1, the time stamp of the
    message [s], NaN before the first. An image of another size or kind than expected counts as one
    without depth. Drake's own ``LcmImageArrayToImages`` trusts the size in a message, reads beyond
    its end, and takes 0 mm for a depth.
    """

    def __init__(self, width: int, height: int) -> None:
        """A receiver of images of one size [px]."""
        super().__init__()
        self._shape = (height, width)
        self._message = self.DeclareAbstractInputPort("message", Value(lcmt_image_array()))
        self._decoded = declare_cache(self, "images", self._decode, {self._message})
        decoded = {self._decoded}
        depth, labels = ImageDepth32F(width, height), ImageLabel16I(width, height)
        declare_output(self, "depth_image", self._calc_depth, decoded, model=depth)
        declare_output(self, "label_image", self._calc_labels, decoded, model=labels)
        declare_output(self, "stamp", self._calc_stamp, decoded, size=1)

    def _decode(self, context: Context) -> dict[int, NDArray[np.generic]]:
        """The images of the message that can be used, by pixel format."""
        images = self._message.Eval(context).images
        arrays = {image.pixel_format: pixels(image, self._shape) for image in images}
        return {key: array for key, array in arrays.items() if array is not None}

    def _calc_depth(self, context: Context) -> ImageDepth32F:
        image = ImageDepth32F(self._shape[1], self._shape[0])
        millimetres = self._decoded.Eval(context).get(lcmt_image.PIXEL_FORMAT_DEPTH)
        image.mutable_data[:] = 0.0
        if millimetres is not None and millimetres.dtype == np.uint16:
            far = millimetres == np.iinfo(np.uint16).max
            image.mutable_data[:, :, 0] = np.where(far, np.inf, 1e-3 * millimetres)
        return image

    def _calc_labels(self, context: Context) -> ImageLabel16I:
        image = ImageLabel16I(self._shape[1], self._shape[0])
        labels = self._decoded.Eval(context).get(lcmt_image.PIXEL_FORMAT_LABEL)
        image.mutable_data[:] = 0
        if labels is not None:
            image.mutable_data[:, :, 0] = labels
        return image

    def _calc_stamp(self, context: Context) -> float:
        message = self._message.Eval(context)
        return 1e-6 * message.header.utime if message.num_images else np.nan


def publish_images(
    builder: DiagramBuilder,
    station: Station,
    name: str,
    camera: CameraConfig,
    lcm: DrakeLcm,
    *,
    mask: bool,
) -> None:
    """Publishes a camera's depth at its frame rate, and a mask if there is to be one.

    A message is sent when the image is there, with the time of its exposure.
    """
    inputs = {"depth_image": station.GetOutputPort(f"{name}.depth_image")}
    if station.HasOutputPort(f"{name}.stamp"):
        inputs["stamp"] = station.GetOutputPort(f"{name}.stamp")
    if mask:
        labels = _Mask(camera, station.object_label, station.robot_and_object_labels())
        add_connected(builder, f"{name}_mask", labels, station.GetOutputPort(f"{name}.label_image"))
        inputs["label_image"] = labels.get_output_port()
    message = _ImageMessage(camera, mask=mask)
    add_connected(builder, f"{name}_message", message, **inputs)
    channels.add_publisher(
        *(builder, channels.image_channel(name), lcmt_image_array, lcm, message.get_output_port()),
        period=1.0 / camera.fps,
        offset=camera.capture_offset + camera.output_delay,
    )


class _ImageMessage(LeafSystem):
    """The message with a depth image, in whole millimetres as depth cameras send it, and a mask.

    Drake's own ``ImageToLcmImageArrayT`` stamps it with the time at which it is sent.
    """

    def __init__(self, camera: CameraConfig, *, mask: bool) -> None:
        super().__init__()
        size, self._compress = (camera.width, camera.height), camera.do_compress
        self._millimetres = ImageDepth16U(*size)
        self._depth = declare_input(self, "depth_image", ImageDepth32F(*size))
        self._labels = declare_input(self, "label_image", ImageLabel16I(*size)) if mask else None
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        declare_output(self, "message", self._calc, model=lcmt_image_array())

    def _calc(self, context: Context) -> lcmt_image_array:
        time = scalar(self._stamp, context, context.get_time())
        message = lcmt_image_array()
        if not np.isfinite(time):  # before the first image
            return message
        ConvertDepth32FTo16U(self._depth.Eval(context), self._millimetres)
        depth = lcmt_image.PIXEL_FORMAT_DEPTH, lcmt_image.CHANNEL_TYPE_UINT16
        message.images = [self._image(*depth, self._millimetres.data)]
        if self._labels is not None:
            label = lcmt_image.PIXEL_FORMAT_LABEL, lcmt_image.CHANNEL_TYPE_INT16
            message.images.append(self._image(*label, self._labels.Eval(context).data))
        message.num_images = len(message.images)
        message.header.utime = round(1e6 * time)
        return message

    def _image(self, pixel_format: int, channel_type: int, pixels: NDArray[Any]) -> lcmt_image:
        image = lcmt_image()
        image.height, image.width = pixels.shape[:2]
        image.pixel_format, image.channel_type = pixel_format, channel_type
        image.row_stride = image.width * pixels.itemsize
        data = pixels.astype(pixels.dtype.newbyteorder("<")).tobytes()
        image.data = zlib.compress(data) if self._compress else data
        image.size = len(image.data)
        plain, zipped = image.COMPRESSION_METHOD_NOT_COMPRESSED, image.COMPRESSION_METHOD_ZLIB
        image.compression_method = zipped if self._compress else plain
        return image


class _Mask(LeafSystem):
    """Which pixels show the object and which the robot: what a segmentation would say."""

    def __init__(self, camera: CameraConfig, label: int, robot_and_object: Iterable[int]) -> None:
        super().__init__()
        self._size = camera.width, camera.height
        self._label, self._robot = label, sorted(set(robot_and_object) - {label})
        self._labels = declare_input(self, "label_image", ImageLabel16I(*self._size))
        declare_output(self, "label_image", self._calc, model=ImageLabel16I(*self._size))

    def _calc(self, context: Context) -> ImageLabel16I:
        labels = self._labels.Eval(context).data
        image = ImageLabel16I(*self._size)
        image.mutable_data[:] = channels.MaskLabel.ROBOT * np.isin(labels, self._robot)
        image.mutable_data[labels == self._label] = channels.MaskLabel.OBJECT
        return image


#: Time, then the pose as it is sent. Source: layout.
_ROW = 8


class ObjectPoseSender(LeafSystem):
    """Publishes object poses of a simulated motion-capture system, with noise, delay and loss.

    .. pydrake_system::

        name: ObjectPoseSender
        input_ports: [pose]
        output_ports: [message]

    ``pose`` is the true ``RigidTransform`` X_WO; ``message`` an ``lcmt_robot_state`` of a
    measurement, with the time at which it was made. It stays the same where one is lost.
    """

    def __init__(self, config: TrackerConfig) -> None:
        super().__init__()
        self._config = config
        self._pose = declare_input(self, "pose", RigidTransform())
        rows = np.full((round(config.latency / config.period) + 1) * _ROW, np.nan)
        state = {self.discrete_state_ticket(self.DeclareDiscreteState(rows))}
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, weakly(self._measure))
        declare_output(self, "message", self._calc, state, model=lcmt_robot_state())

    def _measure(self, context: Context, state) -> None:
        rows, time = context.get_discrete_state_vector().value(), context.get_time()
        X_WO = measured_pose(self._pose.Eval(context).GetAsMatrix4(), time, self._config)
        row = rows[:_ROW]  # one that is lost: the same once more
        if X_WO is not None:
            row = np.concatenate([[time], se3.quaternions(X_WO), X_WO[:3, 3]])
        state.get_mutable_vector().SetFromVector(np.concatenate([row, rows[:-_ROW]]))

    def _calc(self, context: Context) -> lcmt_robot_state:
        time, *values = context.get_discrete_state_vector().value()[-_ROW:]
        return pose_message(time, np.array(values))


class ObjectPoseReceiver(LeafSystem):
    """The pose that a motion-capture system measured, and when.

    .. pydrake_system::

        name: ObjectPoseReceiver
        input_ports: [message]
        output_ports: [pose, stamp]

    ``message`` is an ``lcmt_robot_state`` with the positions `POSE_NAMES` in that order, ``pose``
    the ``RigidTransform`` X_WO, NaN where the message has none, ``stamp`` its time stamp, V1 [s].
    """

    def __init__(self) -> None:
        super().__init__()
        self._message = self.DeclareAbstractInputPort("message", Value(lcmt_robot_state()))
        declare_output(self, "pose", self._calc_pose, {self._message}, model=RigidTransform())
        declare_output(self, "stamp", self._calc_stamp, {self._message}, size=1)

    def _calc_pose(self, context: Context) -> RigidTransform:
        message = self._message.Eval(context)
        X = np.full((4, 4), np.nan)
        if list(message.joint_name) == POSE_NAMES:
            values = np.array(message.joint_position, dtype=float)
            size = np.linalg.norm(values[:4])
            if np.isfinite(values).all() and size > 0.5:
                X = se3.make_pose(se3.rotations(values[:4] / size), values[4:])
        return RigidTransform(X)

    def _calc_stamp(self, context: Context) -> float:
        message = self._message.Eval(context)
        return 1e-6 * message.utime if message.num_joints else np.nan


def pose_message(time: float, values: Array) -> lcmt_robot_state:
    """The message of a pose that was measured at a time [s]; ``values`` as in `POSE_NAMES`.

    Without a measurement yet (NaN) its time stamp is -1, which no receiver uses.
    """
    message = lcmt_robot_state()
    message.utime = -1 if np.isnan(time) else round(1e6 * time)
    message.num_joints, message.joint_name = len(POSE_NAMES), POSE_NAMES
    message.joint_position = values.tolist()
    return message
