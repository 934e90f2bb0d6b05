"""``feasigrasp evaluate tracking``: compare the pose tracked in depth images with the true one.

Records what the wrist camera sees in the simulator, once, and plays it to our tracker and to peers
with the errors of two sensors. ``docs/results_schema.md`` defines each figure. A command
that was interrupted goes on after its last object.

With ``--real`` a folder of a real camera's images is tracked from its first mask instead. True
poses ``X`` (m, 4, 4) of every image, or every second one and so on, may lie there, in the camera's
or the world's frame, in a file ``*poses*.npz``; then no other images are looked at.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp.commands.track import followed
from feasigrasp.errors import InputError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.recordings.folder import read_depth_folder
from feasigrasp.recordings.unaided import UnaidedTracker
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.results.arguments import add_common_arguments, names, select_objects
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import grouped, mean
from feasigrasp_lab.tracking.judge import IN_VIEW, Frame, TrueObject, judge, lost
from feasigrasp_lab.tracking.recording import SENSORS, recorded
from feasigrasp_lab.tracking.trackers import OurTracker, PeerTracker, Tracker, peers

OBJECTS = (
    "mustard_bottle,mug,soup_can,small_box,drill,banana,bowl,hammer,spray_can,water_bottle,"
    "l_block,duck"
)
SCENARIOS = ("ReachLinear", "ReachCircular", "ReachSinusoidal")
#: How the arm moves: what is changed of a scenario, and for how long [s].
KINDS = {
    # As it grasps, until it lets go of the object's motion.
    "approach": ("", 10.0),
    # It follows some way behind a grasp, as far as both sensors can measure, and does not close.
    "follow": ("{grasp: {close: false, standoff: 0.15}}", 60.0),
}
#: A tracker is on the object when its surface is this near [mm]. Source: definition.
_ON_OBJECT = 10.0
#: Figures per image: column, row, unit and percentile.
FIGURES = (
    ("surface_mm", "tracking.surface_mm.median", "mm", 50.0),
    ("surface_mm", "tracking.surface_mm.p95", "mm", 95.0),
    ("rotation_deg", "tracking.rotation_deg", "deg", 50.0),
    ("speed_mm_s", "tracking.twist_mm_s", "mm/s", 50.0),
    ("prediction_mm", "tracking.prediction_mm", "mm", 50.0),
    ("frame_ms", "tracking.frame_ms", "ms", 50.0),
    ("keyframe_ms", "tracking.keyframe_ms", "ms", 50.0),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/tracking", objects=OBJECTS)
    parser.add_argument(
        "--seeds", type=positive, default=3, help="Number of recordings of every object."
    )
    parser.add_argument(
        "--real", type=Path, help="Track this folder of a real camera, and nothing else."
    )
    parser.add_argument(
        "--kinds", type=names, default=list(KINDS), help="Kinds of recordings, separated by commas."
    )


def real_errors(folder: Path) -> tuple[Array, Array, Array]:
    """Errors of a real recording that is tracked from its first mask.

    Returns:
        Times, shape (n,) [s]; distance [mm] and angle [deg] between the tracked and the true motion
        since the first pose, shape (n, 2), NaN where one of both is missing; and the poses, shape
        (n, 4, 4).

    Raises:
        InputError: See `read_depth_folder`; or there are more true poses than images.
    """
    recording = read_depth_folder(folder)
    found = next(iter(sorted(folder.glob("*poses*.npz"))), None)
    truth = None if found is None else read_arrays(found)["X"]
    every = 1 if truth is None else -(-len(recording.files) // len(truth))
    if truth is not None and len(truth) > len(recording.files):
        raise InputError(f"{found} has {len(truth)} poses, of {len(recording.files)} images")
    first = dict(list(recording.masks.items())[:1])
    recording = replace(
        recording,
        files=recording.files[::every],
        times=recording.times[::every],
        X_WC=recording.X_WC[::every],
        masks=first,
    )
    _, poses = followed(recording, UnaidedTracker(recording.camera, on_table=not first))
    errors = np.full((len(poses), 2), np.nan)
    tracked = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    if truth is not None and len(tracked):
        X_OB = se3.inverse(poses[tracked[0]]) @ truth[tracked[0]]
        for k in tracked:
            E = se3.inverse(truth[k]) @ poses[k] @ X_OB
            angle = float(se3.rotation_angle(E[:3, :3]))
            errors[k] = 1e3 * np.linalg.norm(E[:3, 3]), np.rad2deg(angle)
    return recording.times, errors, poses


def judge_object(
    name: str, path: str, kinds: list[str], seeds: int, seed: int, folder: str
) -> list[Record]:
    """Records and judges one object.

    Returns:
        A record for every recording, sensor and tracker: figures of `FIGURES` by percentile, and
        whether the object was lost, and how far off it was in the end.
    """
    truth = TrueObject(load_object(path))
    _warm_up(truth, name, path, Path(folder))
    found = []
    for kind in kinds:
        change, duration = KINDS[kind]
        for number in range(seed, seed + seeds):
            scenario = SCENARIOS[number % len(SCENARIOS)]
            text = f"{{object: {{model: {path!r}}}, random_seed: {number}}}"
            file = Path(folder) / f"{name}_{kind}_{number}.npz"
            recording = recorded(file, scenario, (text, change), duration, Path(path))
            for sensor_name, sensor in SENSORS.items():
                trackers = _trackers(with_peers=kind != "follow")
                judged = judge(trackers, recording, sensor, truth, number)
                for tracker_name, frames in judged.items():
                    about = {"object": name, "seed": number, "tracker": tracker_name}
                    about |= {"condition": f"{kind}/{sensor_name}"}
                    found.append(about | _figures(frames))
    return found


def _trackers(*, with_peers: bool) -> dict[str, Tracker]:
    """Ours, and the peers if they are asked for, by preset; none has seen anything."""
    found: dict[str, Tracker] = {"default": OurTracker()}
    if with_peers:
        found |= {f"peer:{name}": PeerTracker(register) for name, register in peers().items()}
    return found


def _warm_up(truth: TrueObject, name: str, path: str, folder: Path) -> None:
    """Loads compiled code, which would count as time of the first images."""
    text = f"{{object: {{model: {path!r}}}, random_seed: 0}}"
    recording = recorded(folder / f"{name}_first.npz", SCENARIOS[0], (text,), 0.5, Path(path))
    judge(_trackers(with_peers=True), recording, SENSORS["d435"], truth, 0)


def _figures(frames: list[Frame]) -> Record:
    """What is said of one run."""
    rows = [asdict(frame) for frame in frames if frame.hold]
    # Twist and prediction count from here on [s].
    settled = [r for r in rows if r["time"] >= 0.5]
    late = ("speed_mm_s", "prediction_mm")
    result: Record = {}
    for column, name, _, percentile in FIGURES:
        chosen = settled if column in late else rows
        if not column.endswith("_ms"):
            chosen = [r for r in chosen if r["points"] >= IN_VIEW]
        values = np.array([r[column] for r in chosen], dtype=float)
        values = values[np.isfinite(values)]
        result[name] = float(np.percentile(values, percentile)) if len(values) else None
    result["lost"] = lost(frames)
    result["end_mm"] = rows[-1]["surface_mm"] if rows else None
    return result


def report_real(folder: Path, out: Path) -> None:
    """Prints the errors of a real recording, and writes them image by image."""
    times, errors, poses = real_errors(folder)
    tracked = np.isfinite(poses).all(axis=(1, 2))
    print(f"{folder}: {len(times)} images, a pose in {100.0 * tracked.mean():.0f} % of them")
    if np.isfinite(errors).any():
        for column, what in enumerate(("distance [mm]", "angle [deg]")):
            middle, most = np.nanpercentile(errors[:, column], [50.0, 95.0])
            print(f"  {what:24s} median {middle:.2f}, 95 % {most:.2f}")
    table = np.column_stack([times, errors]).tolist()
    write_csv(out / "real.csv", table, ["time_s", "distance_mm", "angle_deg"], ".6g")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.real is not None:
        report_real(args.real, args.out)
        return 0
    objects = select_objects(args.objects)
    seeds, kinds = args.seeds, args.kinds
    if args.quick:
        objects, seeds = dict(list(objects.items())[:2]), 1
        kinds = [kind for kind in kinds if kind != "follow"]
    settings: dict[str, Any] = {
        "kinds": kinds,
        "seeds": seeds,
        "seed": args.seed,
        "folder": str(args.out / "recordings"),
    }
    records = finish_all(
        objects, args.out / "objects", settings, judge_object, jobs=args.jobs, desc="tracking"
    )
    write_csv(args.out / "runs.csv", records, list(records[0]), ".6g")
    report_rows(args, "evaluate tracking", summary_rows(records))
    return 0


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Means over the recordings of each condition and tracker, and shares of them."""
    rows = []
    for (condition, tracker), runs in grouped(records, itemgetter("condition", "tracker")).items():
        preset = f"{condition}/{tracker}"
        for _, name, unit, _ in FIGURES:
            values = [r[name] for r in runs if r[name] is not None]
            if values:
                rows.append(Row.of(name, preset, mean(values, 0.0), unit))
        objects = [r["object"] for r in runs]
        rows.append(
            Row.percent("tracking.lost_percent", preset, [r["lost"] for r in runs], objects)
        )
        if condition.startswith("follow"):
            ends = [r["end_mm"] for r in runs if r["end_mm"] is not None]
            rows.append(Row.of("tracking.drift_mm.60s", preset, mean(ends, 0.0), "mm"))
            on = [r["end_mm"] is not None and r["end_mm"] < _ON_OBJECT for r in runs]
            rows.append(Row.percent("tracking.on_object_percent.60s", preset, on, objects))
    return rows
