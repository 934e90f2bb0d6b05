"""``feasigrasp evaluate tracking``: compare the pose tracked in depth images with the true one.

Records what the wrist camera sees in the simulator, once, and plays it to our tracker and to peers
with the errors of two sensors. ``docs/results_schema.md`` defines each figure. A command
that was interrupted goes on after its last object.

With ``--real`` a folder of a real camera's images is tracked from its first mask instead. True
poses ``X`` (m, 4, 4) of every image, or every second one and so on, may lie there, in the camera's
or the world's frame, in a file ``*poses*.npz``; then no other images are looked at.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from importlib.util import find_spec
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp.commands.track import followed
from feasigrasp.errors import InputError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.usable import ViewRecord
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.tracking.keyframe import KEY_PERIOD, KEY_VIEWS
from feasigrasp.models.tracking.view import ObjectView
from feasigrasp.recordings.folder import read_depth_folder
from feasigrasp.recordings.unaided import UnaidedTracker
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.results.arguments import add_common_arguments, names, select_objects
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import grouped, mean
from feasigrasp_lab.tracking.judge import IN_VIEW, Frame, TrueObject, judge, lost
from feasigrasp_lab.tracking.recording import SENSORS, recorded
from feasigrasp_lab.tracking.trackers import OurTracker, Tracker

# Other registrations in the place of ours: image against model, point to plane.
#
# They get what ours gets: the same images and points, the pose expected from the last two, and a
# model that grows by the same rule of keyframes, fused in voxels as ours is.

#: Points of an image that are registered, and how far a pair may be apart [m]. Source: guessed.
_POINTS, _GATE = 1500, 0.01
#: Scale of the robust kernel [m], and steps. Source: guessed.
_SCALE, _STEPS = 2e-3, 15
#: A registration that fits fewer of the points is not accepted, or not merged. Source: guessed.
_ACCEPTED, _MERGED = 0.6, 0.85

#: From points, model points, model normals and a start to X_model_points and the share of inliers.
Registration = Callable[[Array, Array, Array, Array], tuple[Array, float]]


def point_to_plane_open3d(
    points: Array, model: Array, normals: Array, X: Array
) -> tuple[Array, float]:
    """Open3D, with the kernel of Geman and McClure."""
    import open3d as o3d

    source, target = (o3d.geometry.PointCloud() for _ in range(2))
    source.points = o3d.utility.Vector3dVector(points)
    target.points = o3d.utility.Vector3dVector(model.copy())  # does not take read-only arrays
    target.normals = o3d.utility.Vector3dVector(normals.copy())
    registration = o3d.pipelines.registration
    estimation = registration.TransformationEstimationPointToPlane(registration.GMLoss(_SCALE))
    criteria = registration.ICPConvergenceCriteria(max_iteration=_STEPS)
    found = registration.registration_icp(source, target, _GATE, X, estimation, criteria)
    return np.asarray(found.transformation), float(found.fitness)


def point_to_plane_small_gicp(
    points: Array, model: Array, normals: Array, X: Array
) -> tuple[Array, float]:
    """small_gicp, which has its own neighbours, normals and steps."""
    import small_gicp

    found = small_gicp.align(
        model,
        points,
        X,
        registration_type="PLANE_ICP",
        downsampling_resolution=0.002,
        max_correspondence_distance=_GATE,
        num_threads=1,
        max_iterations=_STEPS,
    )
    return np.asarray(found.T_target_source), float(found.num_inliers / max(len(points), 1))


def peers() -> dict[str, Registration]:
    """Those that are installed, by name."""
    found: dict[str, Registration] = {"open3d": point_to_plane_open3d}
    if find_spec("small_gicp") is not None:
        found["small_gicp"] = point_to_plane_small_gicp
    return found


class PeerTracker:
    """A tracker around a registration of point clouds."""

    def __init__(self, registration: Registration) -> None:
        self._registration = registration
        self._cloud = FusedCloud.empty(0.003, smooth=True)
        self._views = ViewRecord()
        self._poses: list[tuple[float, Array]] = []
        self._view: ObjectView | None = None
        self._fit, self._last_key = 0.0, -np.inf
        self.measured = False

    @property
    def X_WO(self) -> Array | None:
        """The pose at the time of the last image."""
        return self._poses[-1][1] if self._poses else None

    @property
    def V_WO(self) -> Array:
        """The mean twist of the last images."""
        (t0, X0), (t1, X1) = self._poses[0], self._poses[-1]
        if t1 <= t0:
            return np.zeros(6)
        turn = se3.so3_log(X1[:3, :3] @ X0[:3, :3].T)
        return np.concatenate([turn, X1[:3, 3] - X0[:3, 3]]) / (t1 - t0)

    def predicted(self, time: float, ahead: float) -> Array:
        """By the twist held."""
        del time
        return se3.extrapolate(self._poses[-1][1], self.V_WO, ahead)

    def looked(self, view: ObjectView, time: float) -> None:
        """Takes in an image."""
        # An image with fewer points is not registered; a first one needs so many.
        least, first = 80, 300
        self._view, self.measured, self._fit = view, False, 0.0
        if not self._poses:
            if len(view.points_W) >= first:
                X = se3.make_pose(np.eye(3), np.median(view.points_W, axis=0))
                self._poses, self.measured, self._fit = [(time, X)], True, 1.0
            return
        X = se3.extrapolate(self._poses[-1][1], self.V_WO, time - self._poses[-1][0])
        if len(view.points_W) >= least and len(self._cloud.points):
            points = view.points_W[:: -(-len(view.points_W) // _POINTS)]
            X_OW, self._fit = self._registration(
                points, self._cloud.points, self._cloud.normals, se3.inverse(X)
            )
            if self._fit >= _ACCEPTED:
                X, self.measured = se3.inverse(X_OW), True
        # The twist is the mean over so many images.
        self._poses = [*self._poses[1 - 6 :], (time, X)]

    def learnt(self) -> bool:
        """Merges the last image where the same rule as ours asks for it."""
        if not self.measured or self._fit < _MERGED or self._view is None:
            return False
        time, X_WO = self._poses[-1]
        X_OW = se3.inverse(X_WO)
        p_OC = X_OW[:3, :3] @ self._view.X_WC[:3, 3] + X_OW[:3, 3]
        soon = time < self._last_key + KEY_PERIOD
        if soon or not self._views.adds_information(p_OC, time, KEY_VIEWS, np.inf):
            return False
        points_O = self._view.points_W @ X_OW[:3, :3].T + X_OW[:3, 3]
        self._cloud = self._cloud.merged(points_O, p_OC, register=False)
        self._views, self._last_key = self._views.extended(p_OC, time), time
        return True


OBJECTS = (
    "mustard_bottle,mug,soup_can,small_box,drill,banana,bowl,hammer,spray_can,water_bottle,"
    "l_block,duck"
)
SCENARIOS = ("ReachLinear", "ReachCircular", "ReachSinusoidal")
#: How the arm moves: end of the scenario's name, what is changed of it, and for how long [s].
KINDS = {
    # As it grasps, until it lets go of the object's motion.
    "approach": ("", "", 10.0),
    # It never has a grasp; and where it does not lead its camera, it stands still.
    "observe": ("Mocap", "{perception: {latency: 10.0}}", 8.0),
    # It follows some way behind a grasp, as far as both sensors can measure, and does not close.
    "follow": ("", "{grasp: {close: false, standoff: 0.15}}", 60.0),
}
#: A tracker is on the object when its surface is this near [mm]; after a gap it is back if it is
#: within a time [s]. Source: definition.
_ON_OBJECT, _BACK_WITHIN = 10.0, 1.0
#: Figures per image: column, row, unit and percentile.
FIGURES = (
    ("surface_mm", "tracking.surface_mm.median", "mm", 50.0),
    ("surface_mm", "tracking.surface_mm.p95", "mm", 95.0),
    ("rotation_deg", "tracking.rotation_deg", "deg", 50.0),
    ("path_mm", "tracking.path_mm.median", "mm", 50.0),
    ("path_mm", "tracking.path_mm.p95", "mm", 95.0),
    ("path_deg", "tracking.path_deg", "deg", 50.0),
    ("spin_rad_s", "tracking.spin_rad_s", "rad/s", 50.0),
    ("speed_mm_s", "tracking.twist_mm_s", "mm/s", 50.0),
    ("turn_rad_s", "tracking.twist_rad_s", "rad/s", 50.0),
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
        whether the object was lost, found again, and how far off it was in the end.
    """
    truth = TrueObject(load_object(path))
    _warm_up(truth, name, path, Path(folder))
    found = []
    for kind in kinds:
        ending, change, duration = KINDS[kind]
        for number in range(seed, seed + seeds):
            scenario = SCENARIOS[number % len(SCENARIOS)] + ending
            text = f"{{object: {{model: {path!r}}}, random_seed: {number}}}"
            file = Path(folder) / f"{name}_{kind}_{number}.npz"
            recording = recorded(file, scenario, (text, change), duration, Path(path))
            # Something hides the object in the observing runs, in a run of its own [s].
            gaps = {"": (0.0, 0.0)} | ({"/hidden": (3.0, 4.0)} if kind == "observe" else {})
            for (sensor_name, sensor), (gap, hidden) in product(SENSORS.items(), gaps.items()):
                trackers = _trackers(with_peers=kind != "follow")
                judged = judge(trackers, recording, sensor, truth, number, hidden)
                for tracker_name, frames in judged.items():
                    about = {"object": name, "seed": number, "tracker": tracker_name}
                    about |= {"condition": f"{kind}{gap}/{sensor_name}"}
                    found.append(about | _figures(frames, hidden))
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


def _figures(frames: list[Frame], hidden: tuple[float, float]) -> Record:
    """What is said of one run."""
    rows = [asdict(frame) for frame in frames if frame.hold]
    # Twist and prediction count from here on [s].
    settled = [r for r in rows if r["time"] >= 0.5]
    late = ("speed_mm_s", "turn_rad_s", "prediction_mm", "spin_rad_s")
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
    after = [r for r in rows if hidden[1] <= r["time"] <= hidden[1] + _BACK_WITHIN]
    back = [r["measured"] and r["surface_mm"] < _ON_OBJECT for r in after]
    result["back"] = bool(back and back[-1]) if hidden[1] > 0.0 else None
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
    objects: dict[str, str] = {}
    for part in names(args.objects):
        objects |= select_objects(part)
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
    finished = finish_all(
        objects, args.out / "objects", settings, judge_object, jobs=args.jobs, desc="tracking"
    )
    records = [record for name in objects for record in finished[name]]
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
        back = [(r["back"], r["object"]) for r in runs if r["back"] is not None]
        if back:
            rows.append(Row.percent("tracking.recovered_percent", preset, *zip(*back, strict=True)))
        if condition.startswith("follow"):
            ends = [r["end_mm"] for r in runs if r["end_mm"] is not None]
            rows.append(Row.of("tracking.drift_mm.60s", preset, mean(ends, 0.0), "mm"))
            on = [r["end_mm"] is not None and r["end_mm"] < _ON_OBJECT for r in runs]
            rows.append(Row.percent("tracking.on_object_percent.60s", preset, on, objects))
    return rows
