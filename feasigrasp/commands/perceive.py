"""``feasigrasp perceive``: complete an object from a cloud or depth image and find grasps.

For example::

    feasigrasp perceive --sample --grasps grasps.json
    feasigrasp perceive --depth depth/000000.png --on-table --grasps grasps.json
    feasigrasp perceive --cloud mug.ply --picture out/mug.png --html out/mug.html

A depth image is a 16-bit PNG, with ``--intrinsics`` or a ``camera.json`` beside it or one folder
up, as `feasigrasp record` writes it; ``--mask`` shows the object in it. A cloud shows one object,
in metres, in the camera's frame (the camera in the origin, z forward); ``--scale``, ``--crop``,
``--on-table``, ``--viewpoint`` and ``--merged`` are for clouds that differ. ``--sampler`` chooses
where grasps come from, as in scenarios.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from feasigrasp.errors import FeasigraspError, PointCloudError
from feasigrasp.models.clouds.files import prepare_cloud, read_cloud, viewpoint_of
from feasigrasp.models.grasps.grasp_set import Rejection
from feasigrasp.models.grasps.perceive import Perception, perceive
from feasigrasp.models.robot.gripper import SuctionCup
from feasigrasp.models.segmentation.tabletop import tabletop
from feasigrasp.one_thread import one_thread
from feasigrasp.outputs import check_outputs
from feasigrasp.recordings.images import captured_points, holds_depth
from feasigrasp.resources import model_path
from feasigrasp.runs.pictures.perception import draw_perception, write_perception_html
from feasigrasp.runs.results.arguments import add_box, add_sampler, factor, output, positive
from feasigrasp.runs.results.grasps_file import write_grasps

#: What the reasons of `GraspSet.rejected` mean, for somebody who wants a grasp.
REASONS: dict[str, str] = {
    Rejection.TOO_WIDE: "no opposite side within the hand's opening",
    Rejection.OFF_SURFACE: "a contact is not on the completed surface",
    Rejection.NOTHING_BETWEEN: "the line between the contacts misses the object",
    Rejection.NOT_ANTIPODAL: "the surfaces at the contacts do not oppose each other",
    Rejection.NOT_FLAT: "the lip of the cup would not close on the surface",
    Rejection.HITS_TABLE: "the hand would go through the table",
    Rejection.COLLIDES: "fingers, palm or camera would hit the object",
    Rejection.NEAR_COPY: "almost the same as a better grasp",
    Rejection.UNCERTAIN: "less likely to be a true grasp than the others",
    Rejection.TOO_HEAVY: "the object would turn between the pads",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--cloud", type=Path, help="Cloud: a .ply, .pcd, .npy or .npz file.")
    source.add_argument(
        "--depth", type=Path, help="Depth image: 16-bit or float, or .npz with depth and K."
    )
    source.add_argument(
        "--sample", action="store_true", help="The depth image of a mug that comes with feasigrasp."
    )
    parser.add_argument(
        "--intrinsics",
        metavar="FX,FY,CX,CY|FILE",
        help="Intrinsics of the depth image, in pixels, or the file of its camera. Default: "
        "camera.json, or that of another layout, beside it or one folder up.",
    )
    parser.add_argument(
        "--mask", type=Path, help="Mask of the depth image: not zero where the object is."
    )
    parser.add_argument(
        "--label", type=positive, help="The object's value in a mask that shows several."
    )
    add_box(parser, "Keep the pixels of the depth image inside this box, in pixels.")
    parser.add_argument(
        "--grasps",
        type=output(".json", ".npz", ".npy"),
        help="Write poses, widths and scores to this .json, .npz or .npy (GraspNet).",
    )
    parser.add_argument(
        "--picture",
        type=output(*(f".{end}" for end in FigureCanvasAgg.get_supported_filetypes())),
        help="Write the picture to this PNG. Default: out/perceive/<input>.png.",
    )
    parser.add_argument(
        "--html",
        type=output(".html", ""),
        help="Write the 3-D view to this HTML file. Default: beside the picture.",
    )
    parser.add_argument(
        "--scale", type=float, help="Unit of the cloud, in metres, e.g. 0.001. Default: 1."
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
    parser.add_argument("--voxel", type=factor, default=0.003, help="Voxel size, in metres.")
    view = parser.add_mutually_exclusive_group()
    view.add_argument(
        "--viewpoint",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="Position of the camera, in metres. Default: the origin.",
    )
    view.add_argument(
        "--merged", action="store_true", help="The cloud is merged from several views."
    )
    add_sampler(parser)
    parser.add_argument(
        "--mass",
        type=factor,
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
        body, percent = grasps.load.body, 100.0 * grasps.load.probability(perception.down)
        low, high = body.mass * np.exp(np.array([-2.0, 2.0]) * body.spread)
        print(f"  {'mass [kg]':34s} {low:.2f} to {high:.2f}")
        print(f"  {'probability of bearing it [%]':34s} {percent.min():.0f} to {percent.max():.0f}")
    for reason, count in grasps.rejected.items():
        print(f"  {'dropped: ' + reason:34s} {count:6d}   {REASONS.get(reason, '')}")
    if len(grasps) == 0 and grasps.rejected:
        most = max(grasps.rejected, key=lambda reason: grasps.rejected[reason])
        opens = f"the hand opens to {1e3 * gripper.max_opening:.0f} mm"
        if isinstance(gripper, SuctionCup):
            opens = f"the cup is {2e3 * gripper.radius:.0f} mm wide"
        print(f"  no grasp, most often because: {most} ({opens})")


def _check_options(args: argparse.Namespace) -> None:
    """Refuses options that say nothing of what is given."""
    of_cloud, of_depth = ("scale", "viewpoint", "merged"), ("intrinsics", "mask", "box", "label")
    others, what = (of_cloud, "--cloud") if args.cloud is None else (of_depth, "--depth")
    for option in others:
        if getattr(args, option) not in (None, False):
            raise FeasigraspError(f"--{option} goes with {what} only; leave it out")
    if args.on_table and (args.mask or args.sample):
        raise FeasigraspError("--on-table needs to see the table, which a mask leaves out")
    if args.seed < 0:
        raise FeasigraspError(f"--seed {args.seed}: give a number from 0 on")


@one_thread()
def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.cloud is not None and holds_depth(args.cloud):
        args.depth, args.cloud = args.cloud, None
    _check_options(args)
    if args.sample:
        args.depth, args.mask = (
            model_path("capture", kind, "mug.png") for kind in ("depth", "mask")
        )
    source = args.depth or args.cloud
    picture = args.picture or Path("out/perceive") / f"{source.stem}.png"
    html = args.html or picture.with_suffix(".html")
    check_outputs(
        {"--picture": picture, "--html": html, "--grasps": args.grasps},
        {"--cloud": args.cloud, "--depth": args.depth, "--mask": args.mask},
    )
    scale = 1.0 if args.scale is None else args.scale
    if args.depth is None:
        points = read_cloud(args.cloud)
        if args.viewpoint is None and (p := viewpoint_of(args.cloud)) is not None:
            args.viewpoint = [scale * x for x in p]
    else:
        points = captured_points(args.depth, args.intrinsics, args.mask, args.box, args.label)
    viewpoint = None if args.merged else args.viewpoint or (0.0, 0.0, 0.0)
    points = prepare_cloud(
        points, scale=scale, crop=args.crop, viewpoint=viewpoint, scene=args.on_table
    )
    table = None
    if args.on_table:
        if viewpoint is None:
            raise PointCloudError("--on-table needs to know where the camera was: no --merged")
        standing, table = tabletop(points, viewpoint)
        points = points[standing]
    perception = perceive(
        points,
        viewpoint,
        sampler=args.sampler,
        voxel_size=args.voxel,
        seed=args.seed,
        mass=args.mass,
        down=args.down,
        table=table,
    )
    print_table(source.name, perception)
    if perception.outliers > 0.2 * len(points):  # more than one object hardly has
        print(
            "  a large part was dropped: there may be another object beside this one; keep one "
            "with --crop or --on-table"
        )
    if args.grasps is not None:
        frame = "cloud" if args.merged or args.viewpoint else "camera"
        write_grasps(args.grasps, perception.grasps, frame, source)
        print(f"  wrote {args.grasps}")
    draw_perception(perception, picture, source.stem)
    write_perception_html(perception, html)
    print(f"  wrote {picture} and {html}")
    return 0
