"""Decodes messages of the bus; whatever they contain, memory and time are bounded."""

import struct
import zlib
from io import BytesIO
from typing import Any

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

from feasigrasp.models.robot.iiwa import IIWA_7

#: Largest message [bytes]: uncompressed depth and mask of 2560 x 1600 pixels. Source: reasoned.
LARGEST = 16_384_000
#: Most images and coordinates of a message. Source: reasoned: more than any driver sends.
IMAGES, COORDINATES = 8, 64
#: Largest distance or opening of a message [m]. Source: reasoned: no cell is larger.
FARTHEST = 100.0
_TYPES = {
    lcmt_image.CHANNEL_TYPE_UINT16: np.dtype("<u2"),
    lcmt_image.CHANNEL_TYPE_INT16: np.dtype("<i2"),
}


def decode(kind: type, data: bytes, joints: int = IIWA_7.joints) -> Any | None:
    """The message of a type that bytes contain, of an arm of so many joints.

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
    if isinstance(message, lcmt_iiwa_command):
        finite = bool(np.isfinite(message.joint_position).all())
        return message.num_joints == joints and finite
    if isinstance(message, lcmt_iiwa_status):
        used = (
            message.joint_position_measured,
            message.joint_velocity_estimated,
            message.joint_torque_external,
        )
        return message.num_joints == joints and bool(np.isfinite(used).all())
    if isinstance(message, lcmt_schunk_wsg_status):
        values = message.actual_position_mm, message.actual_speed_mm_per_s, message.actual_force
        return bool((np.abs(values) <= 1e3 * FARTHEST).all())
    if isinstance(message, lcmt_robot_state):  # positions that are not finite say so
        return message.num_joints <= COORDINATES and not any(
            abs(x) > FARTHEST for x in message.joint_position
        )
    if isinstance(message, lcmt_image_array):
        return 0 <= message.num_images <= IMAGES
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
