"""Messages of the cell: LCM channels, types and rates, and decoding.

Those of ``IIWA_*`` are what drake-iiwa-driver reads and writes in position mode, ``SCHUNK_WSG_*``
drake-schunk-driver's, ``DRAKE_RGBD_CAMERA_IMAGES_*`` what Drake's own camera publishers send. All
time stamps are microseconds of one clock, that of the computer that the drivers run on. Whatever a
message contains, memory and time of its decoding are bounded.
"""

import struct
import weakref
import zlib
from collections.abc import Callable
from enum import IntEnum
from io import BytesIO
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from drake import (
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_image,
    lcmt_image_array,
    lcmt_robot_state,
    lcmt_schunk_wsg_status,
)
from numpy.typing import NDArray
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import kIiwaLcmStatusPeriod
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem

from feasigrasp.errors import HardwareError
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.ports import add_connected

#: Multicast that stays on this computer.
LCM_URL = "udpm://239.255.76.67:7667?ttl=0"

IIWA_STATUS, IIWA_COMMAND = "IIWA_STATUS", "IIWA_COMMAND"
#: What the controller asks of the guard, in messages of the kind that the driver reads.
IIWA_REQUEST = "FEASIGRASP_IIWA_REQUEST"
#: What a standby is about to command: the guard leaves the arm to it.
IIWA_STANDBY = "FEASIGRASP_IIWA_STANDBY"
WSG_STATUS, WSG_COMMAND = "SCHUNK_WSG_STATUS", "SCHUNK_WSG_COMMAND"
#: A motion-capture system's measurements: a floating joint's seven positions, `POSE_NAMES`.
OBJECT_POSE = "FEASIGRASP_OBJECT_POSE"

#: Time between messages of the arm's driver and of the gripper's [s]. Source: definition: rates of
#: the drivers, 200 and 20 Hz.
IIWA_PERIOD, WSG_PERIOD = kIiwaLcmStatusPeriod, 0.05
#: The order in which a pose is sent, that of Drake's floating joints.
POSE_NAMES = ["qw", "qx", "qy", "qz", "x", "y", "z"]

#: Messages that systems in Python read and write; those of the others are Drake's own, in C++.
_OF_PYTHON = (lcmt_robot_state, lcmt_image_array)


class MaskLabel(IntEnum):
    """Labels of a mask: everything else is 0."""

    OBJECT = 1
    ROBOT = 2


def image_channel(camera: str) -> str:
    """The channel of a camera's images: depth in millimetres, and the mask if there is one."""
    return f"DRAKE_RGBD_CAMERA_IMAGES_{camera}"


def inbound(scenario: Scenario) -> dict[str, type]:
    """Input channels of a controller of the scenario, with message types."""
    return {
        IIWA_STATUS: lcmt_iiwa_status,
        WSG_STATUS: lcmt_schunk_wsg_status,
        OBJECT_POSE: lcmt_robot_state,
        **{image_channel(name): lcmt_image_array for name in scenario.cameras},
    }


def subscribe(lcm: DrakeLcm, channel: str, receive: Callable[..., None], *given: Any) -> Any:
    """Has a method called with what comes on a channel, without keeping its object alive.

    A bus holds its handlers out of sight of Python's garbage collector: an object that has both
    the bus and a handler would never be freed, nor the file descriptors of the bus. The method
    gets the arguments ``given``, then a message's bytes. The result is the subscription.
    """
    method = weakref.WeakMethod(receive)

    def handle(data: bytes) -> None:
        if (call := method()) is not None:
            call(*given, data)

    return lcm.Subscribe(channel, handle)


def add_publisher(
    builder: DiagramBuilder,
    channel: str,
    kind: type,
    lcm: DrakeLcm,
    message: OutputPort,
    period: float,
    offset: float = 0.0,
) -> None:
    """Adds what sends the messages of a port, every ``period`` [s] from ``offset`` [s] on."""
    native, times = kind not in _OF_PYTHON, {"publish_period": period, "publish_offset": offset}
    publisher = LcmPublisherSystem.Make(channel, kind, lcm, use_cpp_serializer=native, **times)
    add_connected(builder, channel, publisher, message)


def add_subscriber(builder: DiagramBuilder, channel: str, kind: type, lcm: DrakeLcm) -> OutputPort:
    """Adds what receives the messages of a channel; returns their port."""
    native = kind not in _OF_PYTHON
    subscriber = LcmSubscriberSystem.Make(channel, kind, lcm, use_cpp_serializer=native)
    return builder.AddNamedSystem(channel, subscriber).get_output_port()


def open_lcm(url: str) -> DrakeLcm:
    """The message bus at a URL.

    Raises:
        HardwareError: There is none; the message says what to try.
    """
    works = f"on one computer {LCM_URL} works where multicast on the loopback is on"
    if not _is_bus(url):
        raise HardwareError(
            f"--lcm-url {url} is no message bus: give udpm://ADDRESS:PORT?ttl=N with a multicast "
            f"address, 224.0.0.0 to 239.255.255.255; {works}, see 'feasigrasp doctor'"
        )
    try:
        return DrakeLcm(url)
    except RuntimeError as error:
        raise HardwareError(
            f"--lcm-url {url}: no message bus can be opened there ({error}); {works}, see "
            "'feasigrasp doctor'"
        ) from error


def _is_bus(url: str) -> bool:
    """Whether LCM supports a URL; an unsupported one it accepts, and stays silent there."""
    parts = urlsplit(url)
    if parts.scheme in ("memq", "file"):
        return True
    try:
        there = ip_address(parts.hostname or "").is_multicast and parts.port != 0
    except ValueError:  # no address, or a port that is none
        return False
    return parts.scheme == "udpm" and there


#: Largest message [bytes]: uncompressed depth and mask of 2560 x 1600 pixels. Source: reasoned.
LARGEST = 16_384_000
#: Largest distance or opening of a message [m]. Source: reasoned: no cell is larger.
FARTHEST = 100.0
_TYPES = {
    lcmt_image.CHANNEL_TYPE_UINT16: np.dtype("<u2"),
    lcmt_image.CHANNEL_TYPE_INT16: np.dtype("<i2"),
}


def decode(kind: type, data: bytes, joints: int = IIWA_7.joints) -> Any | None:
    """The message of a type that bytes contain; ``joints`` is the number of the arm's.

    Returns:
        None where they are of another type, are cut off or have bytes to spare, or where a value is
        impossible: another number of joints, not finite, or out of proportion.
    """
    if len(data) > LARGEST:
        return None
    rest = BytesIO(data)
    try:
        message = kind.decode(rest)  # type: ignore[attr-defined]
    except (ValueError, struct.error, OverflowError, MemoryError):
        return None
    return message if not rest.read(1) and _is_possible(message, joints) else None


def _is_possible(message: Any, joints: int) -> bool:
    most_images, most_coordinates = 8, 64  # more than any driver sends
    if isinstance(message, lcmt_iiwa_command):
        used = [message.joint_position]
        return message.num_joints == joints and bool(np.isfinite(used).all())
    if isinstance(message, lcmt_iiwa_status):
        used = [message.joint_position_measured, message.joint_velocity_estimated]
        used.append(message.joint_torque_external)
        return message.num_joints == joints and bool(np.isfinite(used).all())
    if isinstance(message, lcmt_schunk_wsg_status):
        values = message.actual_position_mm, message.actual_speed_mm_per_s, message.actual_force
        return bool((np.abs(values) <= 1e3 * FARTHEST).all())
    if isinstance(message, lcmt_robot_state):  # positions that are not finite say so
        few, used = message.num_joints <= most_coordinates, message.joint_position
        return few and all(not abs(x) > FARTHEST for x in used)
    if isinstance(message, lcmt_image_array):
        return 0 <= message.num_images <= most_images
    return True


def pixels(image: lcmt_image, shape: tuple[int, int]) -> NDArray[np.generic] | None:
    """The pixels of an image, shape (height, width); None if it is not of that size and 16 bits."""
    kind = _TYPES.get(image.channel_type)
    if kind is None or image.bigendian or (image.height, image.width) != shape:
        return None
    size, data = shape[0] * shape[1] * kind.itemsize, image.data
    try:
        if image.compression_method == lcmt_image.COMPRESSION_METHOD_ZLIB:
            data = zlib.decompressobj().decompress(data, size + 1)
        elif image.compression_method != lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
            return None
        return np.frombuffer(data, kind).reshape(shape)
    except (zlib.error, ValueError):  # cut off, or too long
        return None
