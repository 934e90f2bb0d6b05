"""``feasigrasp live``: follow an object before a live camera, and draw its shape and grasps.

For example::

    feasigrasp live --camera realsense --record my_recording

The camera stands still. A page of this computer alone shows its images: click the object, or draw a
box about it; again for another object. From then on pose, completed surface and grasps are drawn.
What was recorded is tracked again by `feasigrasp track`. For another computer forward the ports of
the page and of its Meshcat, which are printed (``ssh -L PORT:localhost:PORT``).
"""

import argparse
from itertools import chain
from pathlib import Path

import numpy as np

from feasigrasp.commands.record import add_camera_arguments, opened
from feasigrasp.commands.track import step
from feasigrasp.errors import HardwareError, PointCloudError
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.grasps.samplers import make_sampler
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.one_thread import one_thread
from feasigrasp.outputs import check_folder
from feasigrasp.recordings.camera_file import CameraInfo
from feasigrasp.recordings.folder import decimation
from feasigrasp.recordings.images import check_box, decimated, picked
from feasigrasp.recordings.recorder import DepthFrame, check_new_recording, recorded
from feasigrasp.recordings.unaided import TrackerImage, UnaidedTracker
from feasigrasp.runs.live import CameraView
from feasigrasp.runs.replay import quiet_meshcat
from feasigrasp.runs.results.arguments import add_box, add_sampler
from feasigrasp.runs.results.interrupts import STATUS, postponed_interrupt

_CHOOSE = "click the object, or draw a box about it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_camera_arguments(parser)
    parser.add_argument("--record", type=Path, help="Write what is tracked to this folder.")
    use = "Box about the object in the first image, in pixels. Default: chosen on the page."
    add_box(parser, use)
    parser.add_argument("--on-table", action="store_true", help="The object stands on a table.")
    add_sampler(parser)


class _Session:
    """The page of a camera, and what is tracked."""

    def __init__(self, args: argparse.Namespace, info: CameraInfo, frame: DepthFrame) -> None:
        height, width = frame.depth.shape
        check_box(args.box, (height, width))
        self._factor, self._unit, self._on_table = decimation(width), info.unit, args.on_table
        self._camera: Camera = info.camera(width, height).decimated(self._factor)
        self._given = None if args.box is None else np.array(args.box) / self._factor
        self._note, self._tracker = _CHOOSE, UnaidedTracker(self._camera)
        sampler = make_sampler(args.sampler, ParallelGripper())
        self.page = CameraView(quiet_meshcat(), self._camera, sampler)
        self.replay = ""
        self.poses: list[Array | None] = []

    def _image(self, frame: DepthFrame) -> TrackerImage:
        """An image as recordings are read."""
        depth = decimated(self._unit * frame.depth.astype(float), self._factor)
        return TrackerImage(depth, np.eye(4), frame.time, None, picked(frame.color, self._factor))

    def chosen(self, frame: DepthFrame) -> bool:
        """Whether an object is chosen, and found in this image; shows it if not."""
        image = self._image(frame)
        found = self._begun(image)
        if not found:
            self.page.show(self._note, picked(frame.color, self._factor))
        return found

    def _begun(self, image: TrackerImage) -> bool:
        box = self.page.box() if self._given is None else self._given
        if box is None:
            return False
        # A click says nothing of what is beside the object.
        on_table = self._on_table or bool((box[2:] - box[:2]).max() < 4.0)
        tracker, reason = UnaidedTracker(self._camera, on_table, box), "no object is there"
        try:
            found = step(tracker, image)[1] is not None
        except PointCloudError as error:
            found, reason = False, str(error)
        if not found and self._given is not None:
            raise PointCloudError(f"--box: {reason}")
        self._given, self._note = None, "" if found else f"{reason}; {_CHOOSE}"
        if found:
            self._tracker = tracker
            numbers = " ".join(str(round(x * self._factor)) for x in box)
            self.replay = self.replay or f"--box {numbers}" + " --on-table" * on_table
        return found

    def follow(self, frame: DepthFrame) -> None:
        """Tracks the object in an image, and draws it."""
        image = self._image(frame)
        self._begun(image)
        self._tracker, X_CO = step(self._tracker, image)
        self.poses.append(X_CO)
        self.page.draw(self._tracker.tracker.shape.gpdf)
        words = "tracked" if X_CO is not None else f"not found; {_CHOOSE} to begin anew"
        self.page.show(self._note or words, picked(frame.color, self._factor), X_CO)


@one_thread()
def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.record is not None:
        check_folder("--record", args.record)
        check_new_recording(args.record)
    broken = None
    with opened(args) as (info, frames), postponed_interrupt() as asked:
        frame = next(frames, None)
        if frame is None:
            raise HardwareError(f"{args.camera} gave no image; check that it streams")
        session = _Session(args, info, frame)
        print(f"open {session.page.url} in a browser, and {_CHOOSE}; Ctrl-C ends it", flush=True)
        try:
            while not session.chosen(frame):
                frame = next(frames)
                if asked.is_set():
                    return STATUS
            begin, images = frame.time, chain([frame], frames)
            for frame in images if args.record is None else recorded(args.record, info, images):
                session.follow(frame)
                ended = len(session.poses) == args.frames or frame.time - begin >= args.seconds
                if ended or asked.is_set():
                    break
        except StopIteration:
            raise HardwareError(f"{args.camera} ended before an object was chosen") from None
        except HardwareError as error:
            broken = error
    count = sum(X is not None for X in session.poses)
    print(f"{len(session.poses)} images, a pose in {count} of them")
    if session.page.grasps is not None:
        print(f"  {len(session.page.grasps)} grasps on its last shape")
    if args.record is not None and session.poses:
        print(f"  again: feasigrasp track --folder {args.record} {session.replay}")
    if broken is not None:
        print(f"  it ended early: {broken}")
    return 0 if broken is None else 1
