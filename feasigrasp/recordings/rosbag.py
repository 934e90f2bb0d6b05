"""Depth and color images of a ROS 2 recording (rosbag2 in MCAP), as those of a camera."""

import io
import itertools
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from feasigrasp.errors import CameraError, FeasigraspError, HardwareError, InputError
from feasigrasp.recordings.camera_file import CameraInfo
from feasigrasp.recordings.recorder import DepthFrame

_IMAGES = {"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"}
#: NumPy's type of a pixel and its channels, by encoding of sensor_msgs/Image.
_ENCODINGS = {
    "16UC1": ("u2", 1),
    "mono16": ("u2", 1),
    "32FC1": ("f4", 1),
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
}


@contextmanager
def rosbag(file: Path) -> Iterator[tuple[CameraInfo, Iterator[DepthFrame]]]:
    """Opens a recording (MCAP) with images (raw, or compressed as PNG or JPEG) and a camera_info.

    The topic of depth images is the one with ``depth`` in its name, of several the one with
    ``aligned`` in it. Color is of the topic with ``color`` or ``rgb`` in its name, whose images
    have to be of the same pixels; without one, images are black. What it gives is the depth camera,
    and its images in order of time.

    Raises:
        HardwareError: mcap-ros2-support is not installed.
        InputError: The file, or later an image, cannot be read; it has no such topics.
        CameraError: The depth image is distorted.
    """
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise HardwareError(
            f"{file} is read by mcap-ros2-support ({error}); pip install mcap-ros2-support"
        ) from error
    with ExitStack() as stack:
        with _readable(file):
            opened = stack.enter_context(file.open("rb"))
            reader = make_reader(opened, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            if summary is None or summary.statistics is None:
                raise InputError(f"{file} was cut off: no summary; 'mcap recover' mends it")
            counts, kinds = summary.statistics.channel_message_counts, summary.schemas
            channels = [c for number, c in summary.channels.items() if counts.get(number)]
            images = [c.topic for c in channels if kinds[c.schema_id].name in _IMAGES]
            depth = _chosen([topic for topic in images if "depth" in topic])
            if depth is None:
                found = ", ".join(channel.topic for channel in channels)
                raise InputError(f"{file} has no images of depth; topics with messages are {found}")
            beside = [topic for topic in images if "depth" not in topic]
            color = _chosen([topic for topic in beside if "color" in topic or "rgb" in topic])
            info = depth.removesuffix("/compressedDepth").rpartition("/")[0] + "/camera_info"
            first = next(reader.iter_decoded_messages([info]), None)
            if first is None:
                raise InputError(f"{file} has no {info}, the intrinsics of {depth}; record it too")
            messages = reader.iter_decoded_messages([depth, *([color] if color else [])])
            camera = _camera(first[3], info)
        yield camera, _frames(file, depth, messages)


@contextmanager
def _readable(file: Path) -> Iterator[None]:
    try:
        yield
    except FeasigraspError:
        raise
    except Exception as error:  # the readers raise whatever they stumble over
        raise InputError(f"{file} cannot be read as MCAP ({error!r}); record it anew") from error


def _chosen(topics: list[str]) -> str | None:
    """Of several topics the aligned one, or the one with the shortest name."""
    return min(topics, key=lambda topic: ("aligned" not in topic, len(topic)), default=None)


def _camera(info: Any, topic: str) -> CameraInfo:
    if any(info.d):
        raise CameraError(
            f"{topic}: the depth image is distorted ({list(info.d)}), which is not reckoned with; "
            "record the rectified one"
        )
    k = info.k
    return CameraInfo((k[0], k[4], k[2], k[5]), size=(info.width, info.height), source=topic)


def _frames(file: Path, depth_topic: str, messages: Any) -> Iterator[DepthFrame]:
    """Each depth image with the color image that is nearest in time."""
    waiting: list[tuple[float, NDArray[np.uint16]]] = []
    color: tuple[float, NDArray[np.uint8]] | None = None
    count = itertools.count()
    with _readable(file):
        for _, channel, _, message in messages:
            time = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            pixels = _pixels(channel.topic, message)
            if channel.topic == depth_topic:
                waiting.append((time, _millimetres(pixels)))
                continue
            later = time, pixels
            for taken, depth in waiting:
                sooner = color if color and taken - color[0] < time - taken else later
                yield DepthFrame(taken, next(count), depth, sooner[1])
            waiting, color = [], later
    for taken, depth in waiting:
        last = color[1] if color else np.zeros((*depth.shape, 3), dtype=np.uint8)
        yield DepthFrame(taken, next(count), depth, last)


def _pixels(topic: str, message: Any) -> NDArray[Any]:
    """The image of a message: depth (height, width), or red, green, blue (height, width, 3)."""
    data = bytes(message.data)
    try:
        if not hasattr(message, "encoding"):  # compressed; depth has a header of 12 bytes
            picture = Image.open(io.BytesIO(data[12:] if "compressedDepth" in topic else data))
            image = np.array(picture if "depth" in topic else picture.convert("RGB"))
            if message.format.startswith("32FC1"):  # depth is A / (value - B), and none where 0
                _, A, B = np.frombuffer(data[:12], "<f4").astype(float)
                return np.divide(A, image - B, out=np.zeros(image.shape), where=image > 0)
            return image
        kind, channels = _ENCODINGS[message.encoding]
        dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
        rows = np.frombuffer(data, np.uint8).reshape(message.height, message.step)
        used = np.ascontiguousarray(rows[:, : message.width * channels * dtype.itemsize])
        image = used.view(dtype).reshape(message.height, message.width, channels)
    except KeyError as error:
        known = ", ".join(_ENCODINGS)
        raise InputError(f"{topic}: images are {message.encoding}; give {known}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{topic}: an image is broken ({error})") from error
    order = [2, 1, 0] if message.encoding.startswith("bgr") else [0, 1, 2]
    return image[..., 0] if channels == 1 else image[..., order]


def _millimetres(depth: NDArray[Any]) -> NDArray[np.uint16]:
    """Depth of whole millimetres as it is; that of floats [m] rounded, 0 where there is none."""
    if depth.dtype.kind != "f":
        return depth.astype(np.uint16)
    whole = np.rint(1e3 * np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0))
    return np.where(whole <= np.iinfo(np.uint16).max, whole, 0).astype(np.uint16)
