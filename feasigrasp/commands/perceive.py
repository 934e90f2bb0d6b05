"""``feasigrasp perceive``: complete an object from a real cloud and find grasps, without a robot.

For example::

    feasigrasp perceive --cloud mug.ply --picture out/mug.png --html out/mug.html

The cloud shows one object, in metres, in the camera's frame (the camera in the origin, z forward);
``--scale``, ``--crop``, ``--on-table``, ``--viewpoint`` and ``--merged`` are for clouds that
differ. ``--sampler`` chooses where grasps come from, as in scenarios.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from feasigrasp.errors import FeasigraspError, PointCloudError
from feasigrasp.evaluation.pictures.perception import draw_perception
from feasigrasp.evaluation.pictures.perception_html import write_perception_html
from feasigrasp.models.clouds.files import prepare_cloud, read_cloud
from feasigrasp.models.grasps.grasp_set import Rejection
from feasigrasp.models.grasps.perceive import Perception, perceive
from feasigrasp.models.grasps.samplers import SamplerName
from feasigrasp.models.segmentation.tabletop import object_on_table
from feasigrasp.outputs import check_outputs

#: What the reasons of `GraspSet.rejected` mean, for somebody who wants a grasp.
REASONS: dict[str, str] = {
    Rejection.TOO_WIDE: "no opposite side within the hand's opening",
    Rejection.OFF_SURFACE: "a contact is not on the completed surface",
    Rejection.NOTHING_BETWEEN: "the line between the contacts misses the object",
    Rejection.NOT_ANTIPODAL: "the surfaces at the contacts do not oppose each other",
    Rejection.COLLIDES: "fingers, palm or camera would hit the object",
    Rejection.NEAR_COPY: "almost the same as a better grasp",
    Rejection.UNCERTAIN: "less likely to be a true grasp than the others",
    Rejection.TOO_HEAVY: "the object would turn between the pads",
}
#: A share of outliers that one object hardly has.
_MANY = 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument(
        "--cloud", type=Path, required=True, help="Cloud: a .ply, .pcd, .npy or .npz file."
    )
    parser.add_argument(
        "--picture",
        type=Path,
        help="Write the picture to this PNG. Default: out/perceive/<cloud>.png.",
    )
    parser.add_argument(
        "--html",
        type=Path,
        help="Write the 3-D view to this HTML file. Default: beside the picture.",
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="Unit of the cloud, in metres, e.g. 0.001."
    )
    parser.add_argument(
        "--crop",
        type=float,
        nargs=6,
        metavar=("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX"),
        help="Keep the points inside this box, in metres.",
    )
    parser.add_argument(
        "--on-table",
        action="store_true",
        help="Keep the largest object that stands on the table in the cloud.",
    )
    parser.add_argument("--voxel", type=_length, default=0.003, help="Voxel size, in metres.")
    view = parser.add_mutually_exclusive_group()
    view.add_argument(
        "--viewpoint",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("X", "Y", "Z"),
        help="Position of the camera, in metres. Default: the origin.",
    )
    view.add_argument(
        "--merged", action="store_true", help="The cloud is merged from several views."
    )
    parser.add_argument(
        "--sampler",
        choices=list(SamplerName),
        default=SamplerName.NETWORK,
        help="Sampler of the grasps.",
    )
    parser.add_argument(
        "--mass",
        type=_mass,
        help="Mass of the object, in kilograms. Default: estimated from its volume.",
    )
    parser.add_argument(
        "--down",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="Direction of gravity in the cloud's frame. Default: the worst for each grasp.",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="Random seed of the samplers antipodal and diffusion."
    )


def _length(text: str) -> float:
    """Reads a length [m] from the command line."""
    length = float(text)
    if not length > 0.0:
        raise argparse.ArgumentTypeError(f"{text}: give a length in metres")
    return length


def _mass(text: str) -> float:
    """Reads a mass [kg] from the command line."""
    mass = float(text)
    if not 0.0 < mass < np.inf:
        raise argparse.ArgumentTypeError(f"{text}: give a mass in kilograms")
    return mass


def print_table(name: str, perception: Perception) -> None:
    """Prints what was found, and why the other candidates were dropped."""
    grasps, gripper = perception.grasps, perception.gripper
    size = 1e2 * np.ptp(perception.gpdf.completion.points, axis=0)
    print(f"{name}: {len(perception.cloud.points)} points of {perception.cloud.voxel_size:g} m")
    print(f"  {'outliers dropped before':34s} {perception.outliers:6d}")
    print(f"  {'completed size [cm]':34s} {size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f}")
    print(f"  {'grasps kept':34s} {len(grasps):6d}")
    if len(grasps) > 0:
        narrow, wide = 1e3 * grasps.width.min(), 1e3 * grasps.width.max()
        print(f"  {'their widths [mm]':34s} {narrow:.0f} to {wide:.0f}")
    if grasps.load is not None:
        body, carries = grasps.load.body, 100.0 * grasps.load.probability(perception.down)
        low, high = body.mass * np.exp(np.array([-2.0, 2.0]) * body.spread)
        print(f"  {'mass [kg]':34s} {low:.2f} to {high:.2f}")
        print(f"  {'how surely they carry it [%]':34s} {carries.min():.0f} to {carries.max():.0f}")
    for reason, count in grasps.rejected.items():
        print(f"  {'dropped: ' + reason:34s} {count:6d}   {REASONS.get(reason, '')}")
    if len(grasps) == 0 and grasps.rejected:
        most = max(grasps.rejected, key=lambda reason: grasps.rejected[reason])
        print(f"  no grasp, most often because: {most} (the hand opens to", end=" ")
        print(f"{1e3 * gripper.max_opening:.0f} mm)")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    viewpoint = None if args.merged else args.viewpoint
    picture = args.picture or Path("out/perceive") / f"{args.cloud.stem}.png"
    html = args.html or picture.with_suffix(".html")
    if args.seed < 0:
        raise FeasigraspError(f"--seed {args.seed}: give a number from 0 on")
    check_outputs({"--picture": picture, "--html": html}, {"--cloud": args.cloud})
    points = prepare_cloud(
        read_cloud(args.cloud), scale=args.scale, crop=args.crop, viewpoint=viewpoint
    )
    if args.on_table:
        if viewpoint is None:
            raise PointCloudError("--on-table needs to know where the camera was: no --merged")
        points = points[object_on_table(points, viewpoint)]
    perception = perceive(
        points,
        viewpoint,
        sampler=args.sampler,
        voxel_size=args.voxel,
        seed=args.seed,
        mass=args.mass,
        down=args.down,
    )
    print_table(args.cloud.name, perception)
    if perception.outliers > _MANY * len(points):
        print(
            "  so many were dropped that there may be another object beside this one; keep one "
            "with --crop or --on-table"
        )
    draw_perception(perception, picture, args.cloud.stem)
    write_perception_html(perception, html)
    print(f"  wrote {picture} and {html}")
    return 0
