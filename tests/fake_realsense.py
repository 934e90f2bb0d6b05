"""As much of pyrealsense2 as `feasigrasp.recordings.recorder` uses, its camera being a list.

Names, units and errors are those of pyrealsense2 2.59; `test_realsense.py` compares the names with
the library where it is installed.
"""

from enum import Enum
from types import SimpleNamespace

import numpy as np


class stream(Enum):
    depth = 1
    color = 2


class format(Enum):
    z16 = 1
    rgb8 = 5


class option(Enum):
    stereo_baseline = 1


class distortion(Enum):
    brown_conrady = 4


class intrinsics:
    """Of a depth stream of 32 x 24 pixels, in single precision as the library has it."""

    width, height = 32, 24
    fx, fy, ppx, ppy = map(float, np.float32([30.1, 30.2, 15.6, 11.7]))
    model, coeffs = distortion.brown_conrady, [0.0] * 5


class depth_frame:
    """An image of one of the two streams, in memory that is used again for the next one."""

    memory = {
        stream.depth: np.zeros((24, 32), np.uint16),
        stream.color: np.zeros((24, 32, 3), np.uint8),
    }

    def __init__(self, kind, number, lost=False):
        self.kind, self.number, self.lost = kind, number, lost

    def __bool__(self):
        return not self.lost

    def get_frame_number(self):
        return self.number

    def get_timestamp(self):
        return 5e6 + 1e3 / 30.0 * self.number  # milliseconds

    def get_data(self):
        image = camera.plays(self.kind, self.number)
        if self.memory[self.kind].shape != image.shape:
            self.memory[self.kind] = np.zeros_like(image)
        self.memory[self.kind][:] = image
        return self.memory[self.kind]


def pixels(kind, number):
    """What the camera saw in an image."""
    rng = np.random.default_rng([kind.value, number])
    if kind is stream.depth:
        return rng.integers(5000, 5050, (24, 32)).astype(np.uint16)
    return rng.integers(0, 256, (24, 32, 3)).astype(np.uint8)


class composite_frame:
    def __init__(self, number, lost=False):
        self.number, self.lost = number, lost

    def get_depth_frame(self):
        return depth_frame(stream.depth, self.number)

    def get_color_frame(self):
        return depth_frame(stream.color, self.number, self.lost)


class align:
    def __init__(self, align_to):
        self.align_to = align_to

    def process(self, frames):
        assert self.align_to is stream.depth and isinstance(frames, composite_frame)
        return frames


class config:
    def __init__(self):
        self.streams = {}

    def enable_stream(self, stream_type, width, height, format, framerate):
        self.streams[stream_type] = (width, height, format, framerate)


class depth_sensor:
    def supports(self, option):
        return True

    def get_option(self, option):
        return float(np.float32(18.1))  # millimetres

    def get_depth_scale(self):
        return float(np.float32(1e-4))  # metres per unit


class video_stream_profile:
    def as_video_stream_profile(self):
        return self

    def get_intrinsics(self):
        return intrinsics


class pipeline_profile:
    def get_stream(self, stream_type):
        assert stream_type is stream.depth
        return video_stream_profile()

    def get_device(self):
        return SimpleNamespace(first_depth_sensor=depth_sensor)


class pipeline:
    """Plays `camera.images`, numbers or whole frames; at their end it is unplugged."""

    def start(self, config):
        if camera.images is None:
            raise RuntimeError("No device connected")
        wanted = {(*size[:2], size[3]) for size in config.streams.values()}
        if wanted != {(intrinsics.width, intrinsics.height, 30)} or set(config.streams) != set(
            stream
        ):
            raise RuntimeError("Couldn't resolve requests")
        self.images, camera.running = iter(camera.images), True
        return pipeline_profile()

    def wait_for_frames(self):
        image = next(self.images, None)
        if image is None:
            raise RuntimeError("Frame didn't arrive within 5000")
        return image if isinstance(image, composite_frame) else composite_frame(image)

    def stop(self):
        camera.running = False


#: What is plugged in: the images to come, None without a camera, and what each of them shows.
camera = SimpleNamespace(images=None, running=False, plays=pixels)
