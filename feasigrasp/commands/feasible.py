"""``feasigrasp feasible``: which grasps of others the arm can reach, and why not the rest.

For example::

    feasigrasp feasible --grasps grasps.npz --cloud scene.npy --on-table --camera-pose X_WC.txt

The grasps are poses of shape (n, 4, 4), or GraspNet's 17 columns, in the frame of the cloud. They
are judged as the pipeline judges its own: hand against table and completed object, then the arm.
"""

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np

from feasigrasp.errors import InputError
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.files import prepare_cloud, read_cloud
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.perceive import perceive
from feasigrasp.models.grasps.samplers import SamplerName
from feasigrasp.models.quantities import POSE, Call, Refusal
from feasigrasp.models.reach import Reachability, Situation, Verdict, feasible_poses
from feasigrasp.models.robot.arm_file import arm_names, load_arm
from feasigrasp.models.robot.gripper_file import GRIPPERS, PACKAGED, load_gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.segmentation.tabletop import tabletop
from feasigrasp.outputs import check_outputs, write_text
from feasigrasp.recordings.images import captured_points, holds_depth
from feasigrasp.runs.results.arguments import output
from feasigrasp.runs.results.grasps_file import read_grasps


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("--grasps", type=Path, required=True, help="Grasps: .json, .npz or .npy.")
    parser.add_argument(
        "--cloud", type=Path, help="Cloud of the object, or of the scene with --on-table."
    )
    parser.add_argument(
        "--on-table", "--table", action="store_true", help="The object stands on a table in it."
    )
    parser.add_argument(
        "--camera-pose",
        type=Path,
        help="Pose of the cloud's frame in the arm's base: a text file of 4 x 4 numbers.",
    )
    parser.add_argument(
        "--convention",
        choices=("pads", "panda"),
        default="pads",
        help="Origin of the grasps: between the pads, or at the Panda's flange.",
    )
    parser.add_argument(
        "--arm", default="iiwa7", help=f"One of {', '.join(arm_names())}, or the file of an arm."
    )
    hands = ", ".join(GRIPPERS)
    parser.add_argument("--gripper", default=PACKAGED, help=f"One of {hands}, or the file of one.")
    parser.add_argument(
        "--q",
        type=float,
        nargs="+",
        metavar="Q",
        help="Joint positions, in degrees. Default: elbow bent, hand down; of others, their home.",
    )
    parser.add_argument(
        "--velocity",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("VX", "VY", "VZ"),
        help="Velocity of the object in the base, in m/s.",
    )
    parser.add_argument(
        "--verdicts", type=output(".json", ""), help="Write verdicts and times to this JSON file."
    )


def _pose(file: Path | None) -> Array:
    if file is None:
        return np.eye(4)
    try:
        return POSE.check(np.loadtxt(file).reshape(4, 4), Call())
    except (OSError, ValueError, Refusal) as error:
        raise InputError(f"--camera-pose {file}: {error}; give 4 x 4 numbers") from error


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    check_outputs({"--verdicts": args.verdicts}, {"--grasps": args.grasps, "--cloud": args.cloud})
    if args.on_table and args.cloud is None:
        raise InputError("--on-table needs the cloud that shows the table; give --cloud")
    arm = load_arm(args.arm)
    bent = [0.0, 30.0, 0.0, -90.0, 0.0, 60.0, 0.0] if arm is IIWA_7 else np.rad2deg(arm.home)
    q = np.deg2rad(args.q or bent)
    if len(q) != arm.joints or not np.abs(q).max() <= 4.0 * np.pi:
        given = " ".join(f"{angle:g}" for angle in args.q)
        raise InputError(f"--q is {given}; give {arm.joints} angles in degrees, up to two turns")
    V_WO = np.array([0.0, 0.0, 0.0, *args.velocity])
    now = Situation(0.0, q, np.zeros(arm.joints), _pose(args.camera_pose), V_WO)
    if not now.known:
        raise InputError(f"--velocity is {args.velocity}; give three finite numbers, in m/s")
    reachability = Reachability(load_gripper(args.gripper), arm=arm)
    X_CG, width = read_grasps(args.grasps)
    # From the Panda's flange to the middle of its pads [m] (data sheet: Franka).
    ahead = 0.1034 if args.convention == "panda" else 0.0
    X_CG = X_CG @ se3.make_pose(np.eye(3), [0.0, 0.0, ahead])
    gpdf = None
    if args.cloud is not None:
        depth = holds_depth(args.cloud)
        points = captured_points(args.cloud) if depth else read_cloud(args.cloud)
        points, table = prepare_cloud(points, scene=args.on_table), None
        if args.on_table:
            standing, table = tabletop(points)
            points = points[standing]
        gpdf = perceive(points, sampler=SamplerName.ANTIPODAL, table=table).gpdf
    found = feasible_poses(X_CG, now, reachability, gpdf=gpdf, width=width)
    counts = Counter(found.verdicts)
    print(f"{args.grasps.name}: {len(X_CG)} grasps, {counts[Verdict.REACHABLE]} feasible")
    for verdict, count in counts.most_common():
        print(f"  {verdict:34s} {count:6d}")
    order = np.argsort(found.arrival, kind="stable")[:5]
    for k in order[np.isfinite(found.arrival[order])]:
        print(f"  grasp {k}: in {found.arrival[k]:.2f} s; 0.5 s on: {found.later[k]}")
    if args.verdicts is not None:
        arrival = [t if np.isfinite(t) else None for t in found.arrival.round(4).tolist()]
        content = {"verdicts": found.verdicts, "later": found.later, "arrival_s": arrival}
        content["q_rad"] = np.where(np.isfinite(found.q), found.q.round(5), 0.0).tolist()
        write_text(args.verdicts, json.dumps(content) + "\n")
        print(f"  wrote {args.verdicts}")
    return 0
