"""Writes camera images into a folder for `read_depth_folder`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from feasigrasp.errors import CameraError, HardwareError, InputError, OutputError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.quantities import ArrayOf, Whole
from feasigrasp.outputs import replacing, write_text
from feasigrasp.recordings.camera_file import CameraInfo

#: Images that are left out at first, until the exposure has settled; as many as librealsense's own
#: example ``rs-save-to-disk`` leaves out. Source: reasoned.
_SETTLING = 30


@contextmanager
def realsense(
    width: int = 640, height: int = 480, rate: int = 30
) -> Iterator[tuple[CameraInfo, Iterator[DepthFrame]]]:
    """Starts the first RealSense that is plugged in, and stops it at the end.

    Both images have that width and height [px], and come at that rate [Hz]. The color image is put
    on the pixels of the depth image, which stays as it was measured.

    Yields:
        The depth camera, and its images as they come.

    Raises:
        HardwareError: pyrealsense2 is not installed; there is no camera, or none with such images;
            while images are read: none comes any more.
        CameraError: The depth image is distorted.
    """
    try:
        import pyrealsense2 as rs
    except ImportError as error:
        raise HardwareError(
            f"a RealSense is read by pyrealsense2 ({error}); pip install pyrealsense2"
        ) from error
    pipeline, config = rs.pipeline(), rs.config()
    config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate)
    config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate)
    try:
        profile = pipeline.start(config)
    except RuntimeError as error:
        raise HardwareError(
            f"no RealSense gives depth and color of {width} x {height} at {rate} Hz ({error}); is "
            "one plugged in, at USB 3, and used by no other program? Else give another --size or "
            "--rate"
        ) from error
    try:
        yield _camera_info(rs, profile), _frames(rs, pipeline)
    finally:
        with suppress(RuntimeError):  # of a camera that is unplugged
            pipeline.stop()


def _camera_info(rs: Any, profile: Any) -> CameraInfo:
    """What the depth camera says of itself."""
    lens = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()
    if any(lens.coeffs):
        raise CameraError(
            f"the depth image is distorted ({lens.model}: {list(lens.coeffs)}), which is not "
            "reckoned with; take a camera of the D400 family, whose is not"
        )
    sensor = profile.get_device().first_depth_sensor()
    stereo, baseline = rs.option.stereo_baseline, CameraInfo.baseline
    if sensor.supports(stereo):
        baseline = round(1e-3 * sensor.get_option(stereo), 6)  # handed out in millimetres
    return CameraInfo(
        (lens.fx, lens.fy, lens.ppx, lens.ppy),
        round(sensor.get_depth_scale(), 9),  # of single precision
        (lens.width, lens.height),
        baseline=baseline,
        source="the RealSense",
    )


def _frames(rs: Any, pipeline: Any) -> Iterator[DepthFrame]:
    to_depth = rs.align(rs.stream.depth)
    settling, last = _SETTLING, -1
    while True:
        try:
            both = to_depth.process(pipeline.wait_for_frames())
        except RuntimeError as error:
            raise HardwareError(f"no image comes from the RealSense any more ({error})") from error
        depth, color = both.get_depth_frame(), both.get_color_frame()
        if not depth or not color or depth.get_frame_number() == last:
            continue  # one of the two was late
        last = depth.get_frame_number()
        if settling > 0:
            settling -= 1
            continue
        # The arrays are views of the library's own memory, which is used again.
        pixels, colors = np.array(depth.get_data()), np.array(color.get_data())
        yield DepthFrame(1e-3 * depth.get_timestamp(), last, pixels, colors)


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """A depth image and the color image of the same pixels.

    Attributes:
        time: When it was taken [s].
        number: The camera's count of its images; where one is left out, an image was missed.
        depth: In the camera's unit, 0 where nothing was measured, shape (height, width).
        color: Red, green, blue, shape (height, width, 3).
    """

    time: float
    number: Whole
    depth: Annotated[NDArray[np.uint16], ArrayOf(("h", "w"), dtype=np.uint16)]
    color: Annotated[NDArray[np.uint8], ArrayOf(("h", "w", 3), dtype=np.uint8)]

    def __post_init__(self) -> None:
        """Checks what it is made of.

        Raises:
            InputError: The images have another kind, or not the same size.
        """
        check_fields(self, InputError)


#: What starts a camera with images of a width and height [px] and a rate [Hz], as `realsense` does;
#: a class that is made and entered so is one, too.
DepthCamera = Callable[
    [int, int, int], AbstractContextManager[tuple[CameraInfo, Iterator[DepthFrame]]]
]


def check_new_recording(folder: Path) -> None:
    """Raises an OutputError for a folder that holds depth images already."""
    if any((folder / "depth").glob("*.png")):
        raise OutputError(f"{folder} holds depth images already; give another folder")


@checked(InputError)
def recorded(
    folder: str | Path, camera: CameraInfo, frames: Iterable[DepthFrame]
) -> Iterator[DepthFrame]:
    """Hands on the images of a camera as they come, each when it is written.

    The folder is made if need be. Whenever it ends, it is a whole recording: an image is named in
    ``depth.txt`` when its file is complete.

    Raises:
        OutputError: It cannot be written, e.g. because the disk is full.
    """
    folder = Path(folder)
    check_new_recording(folder)
    write_text(folder / "camera.json", camera.to_json())
    for k, frame in enumerate(frames):
        name = f"depth/{k:06d}.png"
        for file, image in ((name, frame.depth), (f"color/{k:06d}.png", frame.color)):
            with replacing(folder / file) as target:
                # zlib's quickest level: an image of 640 x 480 has to be written in less than 33 ms.
                Image.fromarray(image).save(target, "png", compress_level=1)
        try:
            with (folder / "depth.txt").open("a") as lines:
                lines.write(f"{frame.time:.6f} {name}\n")
        except OSError as error:
            raise OutputError(f"{folder / 'depth.txt'} cannot be written ({error})") from error
        yield frame
