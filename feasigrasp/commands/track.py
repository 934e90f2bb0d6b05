"""``feasigrasp track``: follow an object through recorded depth images, and merge its shape.

For example::

    feasigrasp track --folder my_recording --on-table --box 250 130 390 300

The folder is as TUM RGB-D's, BOP's or others (`feasigrasp.recordings.folder`): depth images, a
camera file and, if there are any, times, color images, masks and poses of the camera. One mask, or
a box in the first image, suffices. No robot and no model of the object is needed. The object's
poses are written as TUM's trajectories are, its shape as a cloud.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array
from feasigrasp.models.segmentation.tabletop import check_no_table
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.one_thread import one_thread
from feasigrasp.outputs import check_outputs, replacing
from feasigrasp.recordings.folder import DepthFolder, read_depth_folder
from feasigrasp.recordings.images import check_box
from feasigrasp.recordings.unaided import TrackerImage, UnaidedTracker
from feasigrasp.runs.results.arguments import add_box, factor, output, positive


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument(
        "--folder", type=Path, required=True, help="Folder with depth images and camera.json."
    )
    parser.add_argument(
        "--poses",
        type=output(),
        help="Write the poses to this text file. Default: out/track/<folder>.txt.",
    )
    parser.add_argument(
        "--shape",
        type=output(".ply"),
        help="Write the shape to this cloud (.ply). Default: beside the poses.",
    )
    parser.add_argument(
        "--on-table",
        action="store_true",
        help="Exclude the largest plane of the first image, e.g. a table.",
    )
    use = "Box about the object in the first image, in pixels. Default: the nearest thing."
    add_box(parser, use)
    parser.add_argument(
        "--label", type=positive, help="The object's value in masks of several, or its number."
    )
    parser.add_argument(
        "--rate", type=factor, default=30.0, help="Images per second, for a folder without times."
    )


def check_size(points: Array, gpdf: Gpdf) -> None:
    """Raises a PointCloudError for a view (n, 3) [m] of a table, and notes an unlikely size."""
    # Lengths that are plausible [m]: at least three voxels of a field (3 mm each), and at most
    # twice the longest built-in object (the hammer, 0.24 m).
    smallest, largest = 0.01, 0.5
    try:
        check_no_table(points, None)
    except PointCloudError as error:
        raise PointCloudError(
            f"{str(error).partition(': a table')[0]}: a table. Give --on-table, a --box about the "
            "object, or masks"
        ) from error
    size = float(np.ptp(gpdf.completion.points, axis=0).max())
    if not smallest < size < largest:
        print(
            f"note: the object is {100.0 * size:.1f} cm long at first; if it is not, give a --box "
            "about it, masks, or --on-table, and check depth_scale in camera.json",
            file=sys.stderr,
        )


def step(tracker: UnaidedTracker, image: TrackerImage) -> tuple[UnaidedTracker, Array | None]:
    """The tracker after an image, and X_WO if that gave a pose; see `check_size`."""
    had_shape = tracker.tracker.shape.gpdf is not None
    tracker = tracker.looked(image)
    shape, track = tracker.tracker.shape, tracker.tracker.track
    if shape.gpdf is not None and not had_shape:
        check_size(shape.cloud.points, shape.gpdf)
    if track.estimate is None or track.measured_at != image.time:
        return tracker, None
    return tracker, track.estimate.X_WO


def followed(recording: DepthFolder, tracker: UnaidedTracker) -> tuple[UnaidedTracker, Array]:
    """Plays a recording.

    Returns:
        The tracker at the end; and X_WO of the images that gave a pose, NaN for the others, shape
        (n, 4, 4).
    """
    poses = np.full((len(recording.files), 4, 4), np.nan)
    for k in tqdm(range(len(recording.files)), unit="image", desc="tracking"):
        now = recording.X_WC[k], float(recording.times[k])
        image = TrackerImage(recording.depth(k), *now, recording.mask(k), recording.color(k))
        tracker, X_WO = step(tracker, image)
        if X_WO is not None:
            poses[k] = X_WO
    return tracker, poses


@one_thread()
def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    poses_file = args.poses or Path("out/track") / f"{args.folder.resolve().name}.txt"
    shape_file = args.shape or poses_file.with_suffix(".ply")
    check_outputs({"--poses": poses_file, "--shape": shape_file})
    recording = read_depth_folder(args.folder, args.rate, args.label)
    for note in recording.notes:
        print(f"note: {note}", file=sys.stderr)
    check_box(args.box, recording.file_shape)
    box = None if args.box is None else np.array(args.box) / recording.decimation
    tracker, poses = followed(recording, UnaidedTracker(recording.camera, args.on_table, box))
    tracked, shape = np.isfinite(poses).all(axis=(1, 2)), tracker.tracker.shape
    if not tracked.any() or shape.gpdf is None:
        raise PointCloudError(
            f"no object was found in the {len(poses)} images of {args.folder}; give a --box about "
            "it, --on-table if it stands on one and is higher than 1 cm, masks, or another --label"
        )
    turns = Rotation.from_matrix(poses[tracked, :3, :3]).as_quat()
    rows = np.column_stack([recording.times[tracked], poses[tracked, :3, 3], turns])
    with replacing(poses_file) as file:
        np.savetxt(file, rows, fmt="%.6f", header="time tx ty tz qx qy qz qw")
    with replacing(shape_file) as file:
        trimesh.PointCloud(shape.cloud.points).export(file, file_type="ply")
    size = 1e2 * np.ptp(shape.gpdf.completion.points, axis=0)
    print(f"{args.folder}: {len(poses)} images, a pose in {int(tracked.sum())} of them")
    print(f"  {'views merged':34s} {len(shape.views.times):6d}")
    print(f"  {'completed size [cm]':34s} {size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f}")
    print(f"  wrote {poses_file} and {shape_file}")
    print(f"  grasps: feasigrasp perceive --merged --cloud {shape_file}")
    return 0
