"""The images of a simulated camera as messages."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from drake import lcmt_image_array
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
from feasigrasp.systems.ports import declare_input, declare_output
from feasigrasp.systems.station.station import Station


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
