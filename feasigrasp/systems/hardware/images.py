"""Publishes the images of a simulated camera as messages."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import numpy as np
from drake import lcmt_image, lcmt_image_array
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.lcm import LcmPublisherSystem
from pydrake.systems.sensors import (
    CameraConfig,
    ConvertDepth32FTo16U,
    ImageDepth16U,
    ImageDepth32F,
    ImageLabel16I,
    ImageToLcmImageArrayT,
    PixelType,
)

from feasigrasp.systems.hardware import channels
from feasigrasp.systems.ports import declare_cache, declare_input, declare_output, weakly
from feasigrasp.systems.station.station import Station


class RgbdReceiver(LeafSystem):
    """Depth image and mask of one camera, and when they were taken.

    .. pydrake_system::

        name: RgbdReceiver
        input_ports:
        - message
        output_ports:
        - depth_image
        - label_image
        - stamp

    ``message`` is an ``lcmt_image_array``. ``depth_image`` is ``ImageDepth32F`` [m], infinite where
    the camera measured nothing (0 or 65535 millimetres); ``label_image`` is ``ImageLabel16I``, all
    0 if no mask came with the depth; ``stamp`` is V1, the time stamp of the message [s], NaN before
    the first. An image of another size or kind than expected counts as one without depth. Drake's
    own ``LcmImageArrayToImages`` trusts the size in a message, reads beyond its end, and
    takes 0 mm for a depth.
    """

    def __init__(self, width: int, height: int) -> None:
        """A receiver of images of one size [px]."""
        super().__init__()
        self._shape = (height, width)
        self._message = self.DeclareAbstractInputPort("message", Value(lcmt_image_array()))
        decoded = declare_cache(self, "images", self._decode, {self._message.ticket()})
        self._decoded, ticket = decoded, {decoded.ticket()}
        depth, labels = ImageDepth32F(width, height), ImageLabel16I(width, height)
        declare_output(self, "depth_image", self._calc_depth, ticket, model=depth)
        declare_output(self, "label_image", self._calc_labels, ticket, model=labels)
        self.DeclareVectorOutputPort("stamp", 1, weakly(self._calc_stamp), ticket)

    def _decode(self, context: Context) -> dict[int, NDArray[np.generic]]:
        """The images of the message that can be used, by pixel format."""
        images = self._message.Eval(context).images
        arrays = {image.pixel_format: _array(image, self._shape) for image in images}
        return {key: array for key, array in arrays.items() if array is not None}

    def _calc_depth(self, context: Context) -> ImageDepth32F:
        image = ImageDepth32F(self._shape[1], self._shape[0])
        millimetres = self._decoded.Eval(context).get(lcmt_image.PIXEL_FORMAT_DEPTH)
        image.mutable_data[:] = np.inf
        if millimetres is not None and millimetres.dtype == np.uint16:
            seen = (millimetres > 0) & (millimetres < np.iinfo(np.uint16).max)
            image.mutable_data[:, :, 0] = np.where(seen, 1e-3 * millimetres, np.inf)
        return image

    def _calc_labels(self, context: Context) -> ImageLabel16I:
        image = ImageLabel16I(self._shape[1], self._shape[0])
        labels = self._decoded.Eval(context).get(lcmt_image.PIXEL_FORMAT_LABEL)
        image.mutable_data[:] = 0
        if labels is not None:
            image.mutable_data[:, :, 0] = labels
        return image

    def _calc_stamp(self, context: Context, output) -> None:
        message = self._message.Eval(context)
        output.SetAtIndex(0, 1e-6 * message.header.utime if message.num_images else np.nan)


_TYPES = {
    lcmt_image.CHANNEL_TYPE_UINT16: np.dtype("<u2"),
    lcmt_image.CHANNEL_TYPE_INT16: np.dtype("<i2"),
}


def _array(image: lcmt_image, shape: tuple[int, int]) -> NDArray[np.generic] | None:
    """The pixels of a message, shape (height, width); None if they are not as expected."""
    kind = _TYPES.get(image.channel_type)
    if kind is None or image.bigendian or (image.height, image.width) != shape:
        return None
    data = bytes(image.data)
    try:
        if image.compression_method == lcmt_image.COMPRESSION_METHOD_ZLIB:
            data = zlib.decompress(data)
        elif image.compression_method != lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
            return None
        return np.frombuffer(data, kind).reshape(shape)
    except (zlib.error, ValueError):  # cut off
        return None


def publish_images(
    builder: DiagramBuilder,
    station: Station,
    name: str,
    camera: CameraConfig,
    lcm: DrakeLcm,
    *,
    mask: bool,
) -> None:
    """Publishes a camera's depth at its frame rate, and a mask if there is to be one."""
    images = builder.AddNamedSystem(f"{name}_message", ImageToLcmImageArrayT(do_compress=True))
    depth = builder.AddNamedSystem(f"{name}_depth", _Millimetres(camera))
    sources = [(depth, "depth_image", PixelType.kDepth16U)]
    if mask:
        labels = _Mask(camera, station.object_label, station.robot_and_object_labels())
        builder.AddNamedSystem(f"{name}_mask", labels)
        sources.append((labels, "label_image", PixelType.kLabel16I))
    for system, output, kind in sources:
        builder.Connect(station.GetOutputPort(f"{name}.{output}"), system.get_input_port())
        port = images.DeclareImageInputPort[kind](output)
        builder.Connect(system.get_output_port(), port)
    channel = channels.image_channel(name)
    publisher = LcmPublisherSystem.Make(
        channel, lcmt_image_array, lcm, publish_period=1.0 / camera.fps, use_cpp_serializer=True
    )
    builder.AddNamedSystem(channel, publisher)
    builder.Connect(images.image_array_t_msg_output_port(), publisher.get_input_port())


class _Millimetres(LeafSystem):
    """Depth in whole millimetres, as depth cameras send it; 0 or 65535 where there is none."""

    def __init__(self, camera: CameraConfig) -> None:
        super().__init__()
        size = camera.width, camera.height
        self._size = size
        self._depth = declare_input(self, "depth_image", ImageDepth32F(*size))
        declare_output(self, "depth_image", self._calc, model=ImageDepth16U(*size))

    def _calc(self, context: Context) -> ImageDepth16U:
        image = ImageDepth16U(*self._size)
        ConvertDepth32FTo16U(self._depth.Eval(context), image)
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
        image.mutable_data[:] = channels.ROBOT_LABEL * np.isin(labels, self._robot)
        image.mutable_data[labels == self._label] = channels.OBJECT_LABEL
        return image
