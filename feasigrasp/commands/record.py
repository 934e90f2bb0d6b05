"""``feasigrasp record``: record depth and color images of a RealSense or another camera.

For example::

    feasigrasp record --out my_recording --seconds 10
    feasigrasp perceive --depth my_recording/depth/000000.png --on-table --grasps grasps.json

Ctrl-C ends it, too. `feasigrasp track` and `feasigrasp perceive` read the folder. A RealSense needs
pyrealsense2 (``pip install pyrealsense2``); another camera is a class of yours, called as
`feasigrasp.recordings.recorder.realsense` is. ``--camera bag.mcap`` takes the images of a ROS 2
recording (``pip install mcap-ros2-support``).
"""

import argparse
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from math import inf
from pathlib import Path

from tqdm import tqdm

from feasigrasp.errors import FeasigraspError, HardwareError
from feasigrasp.recordings.camera_file import CameraInfo
from feasigrasp.recordings.recorder import (
    DepthCamera,
    DepthFrame,
    check_new_recording,
    realsense,
    recorded,
)
from feasigrasp.recordings.rosbag import rosbag
from feasigrasp.runs.results.arguments import factor, positive
from feasigrasp.runs.results.interrupts import postponed_interrupt
from feasigrasp.scenario.parts import load_named


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("--out", type=Path, required=True, help="Folder to write to.")
    add_camera_arguments(parser)


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds which camera, and what of it."""
    parser.add_argument(
        "--camera",
        default="realsense",
        help="A realsense, your own as package.module:Name, or a ROS 2 recording (.mcap).",
    )
    parser.add_argument("--frames", type=positive, help="Number of images. Default: until Ctrl-C.")
    parser.add_argument(
        "--seconds", type=factor, default=inf, help="Duration, in seconds. Default: until Ctrl-C."
    )
    parser.add_argument(
        "--size", type=_size, default="640x480", help="Width and height of the images, in pixels."
    )
    parser.add_argument("--rate", type=positive, default=30, help="Images per second.")


def _size(text: str) -> tuple[int, int]:
    """Reads a size such as 640x480 from the command line."""
    width, _, height = text.partition("x")
    return positive(width), positive(height)


def _named(name: str) -> DepthCamera:
    if name.endswith(".mcap"):
        return lambda width, height, rate: rosbag(Path(name))
    return realsense if name == "realsense" else load_named(f"--camera {name!r}", name)


@contextmanager
def opened(args: argparse.Namespace) -> Iterator[tuple[CameraInfo, Iterator[DepthFrame]]]:
    """Starts the camera of the command line.

    Raises:
        HardwareError: It is no `feasigrasp.recordings.recorder.DepthCamera`.
    """
    width, height = args.size
    with ExitStack() as stack:
        try:
            info, images = stack.enter_context(_named(args.camera)(width, height, args.rate))
            if not isinstance(info, CameraInfo):
                raise TypeError(f"{info!r} is no CameraInfo")
            images = iter(images)
        except FeasigraspError:
            raise
        except (TypeError, ValueError) as error:
            raise HardwareError(
                f"--camera {args.camera}: {error}; name what is called and entered as "
                "feasigrasp.recordings.recorder.realsense is, and gives what that gives"
            ) from error
        yield info, _frames(args.camera, images)


def _frames(camera: str, images: Iterable[DepthFrame]) -> Iterator[DepthFrame]:
    for image in images:
        if not isinstance(image, DepthFrame):
            raise HardwareError(f"--camera {camera} gave {type(image).__name__}, not a DepthFrame")
        yield image


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    check_new_recording(args.out)
    first: DepthFrame | None = None
    count, broken = 0, None
    with opened(args) as (info, images), postponed_interrupt() as asked:
        written = recorded(args.out, info, images)
        try:
            for frame in tqdm(written, total=args.frames, unit="image", desc="recording"):
                first, count = first or frame, count + 1
                duration, missed = frame.time - first.time, frame.number - first.number + 1 - count
                if asked.is_set() or count == args.frames or duration >= args.seconds:
                    break
        except HardwareError as error:
            if count == 0:
                raise
            broken = error
    if first is None:
        raise HardwareError(f"{args.camera} gave no image")
    more = f"; {missed} more were missed" if missed > 0 else ""
    print(f"{args.out}: {count} images in {duration:.1f} s{more}")
    if broken is not None:
        print(f"  it ended early: {broken}; what was recorded is whole")
    image = args.out / "depth" / "000000.png"
    print(f"  grasps: feasigrasp perceive --depth {image} --on-table --grasps grasps.json")
    print(f"  track:  feasigrasp track --folder {args.out} --on-table")
    return 0 if broken is None else 1
