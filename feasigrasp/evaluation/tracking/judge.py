"""Plays recordings to a tracker, and judges its poses by the object's true surface.

The frame O is the tracker's own, so at the first view it is aligned with the object once; from then
on every error is the tracker's. A pose is judged by the mean distance of the surface at the tracked
pose from that at the true one (ADD-S, by the mesh itself).

What the first view leaves open of O stays in every later pose, though nothing that lies in O feels
it. So the path is judged a second time, with O where it is on an average over the run, as is usual
for trajectories (Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from time import thread_time
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from feasigrasp.evaluation.tracking.recording import RATE, Recording
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import Camera, unproject
from feasigrasp.models.clouds.depth_noise import DepthNoise
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.objects.raycasting import Raycaster
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.tracking.information import jacobian
from feasigrasp.models.tracking.sequence import SequenceTracker
from feasigrasp.models.tracking.view import ObjectView

#: Points of the true surface that are compared.
_SAMPLES = 400
#: Points that tell what is symmetric.
_SYMMETRY_SAMPLES = 3000
#: Mean square of what a turn moves the surface across itself, over the square of its size, below
#: which the object is round: the built-in ones are below 0.002 or above 0.02.
_ROUND = 5e-3
#: How far ahead poses are predicted [s].
AHEAD = 0.5
#: An image with fewer points of the object does not show it.
IN_VIEW = 300


@dataclass(frozen=True)
class Sensor:
    """A depth camera.

    Attributes:
        noise: Its errors.
        near: Least depth that it measures [m].
    """

    noise: DepthNoise
    near: float


#: Those that the tracker is judged with; focal length and size are those of the recording. The
#: second has the errors of the Reach scenarios' camera, but for its calibration.
SENSORS = {
    "d435": Sensor(DepthNoise(), 0.105),
    "d405": Sensor(
        DepthNoise(baseline=0.018, correlation=1.0, motion_blur=1.0, dropped=0.02), 0.07
    ),
}


class Tracker(Protocol):
    """What plays a recording: a tracker, or a peer."""

    def looked(self, view: ObjectView, time: float) -> None:
        """Takes in an image."""

    def learnt(self) -> bool:
        """Merges what was seen last, if it is worth it; whether it did."""

    @property
    def X_WO(self) -> Array | None:
        """The pose now, shape (4, 4); None before the first view."""

    @property
    def V_WO(self) -> Array:
        """The twist now, shape (6,)."""

    def predicted(self, time: float, ahead: float) -> Array:
        """The pose ``ahead`` seconds after now, shape (4, 4)."""

    @property
    def measured(self) -> bool:
        """Whether the last image gave a pose."""


class OurTracker:
    """`SequenceTracker`, image by image."""

    def __init__(self) -> None:
        self._now = SequenceTracker()

    def looked(self, view: ObjectView, time: float) -> None:
        """Takes in an image."""
        self._now = self._now.looked(view, time)

    def learnt(self) -> bool:
        """Merges a keyframe, if there is a new one."""
        before, self._now = self._now, self._now.learnt()
        return self._now is not before

    @property
    def X_WO(self) -> Array | None:
        """The pose at the time of the last image."""
        estimate = self._now.track.estimate
        return None if estimate is None else estimate.X_WO

    @property
    def V_WO(self) -> Array:
        """The twist."""
        estimate = self._now.track.estimate
        return np.zeros(6) if estimate is None else estimate.V_WO

    def predicted(self, time: float, ahead: float) -> Array:
        """As the motion of the last seconds goes on."""
        X: Array = MotionEstimate(self._now.track.motion, time).predict([ahead])[0]
        return X

    @property
    def measured(self) -> bool:
        """Whether the last image gave a pose."""
        return self._now.track.measured_at == self._now.track.image_time


@dataclass(frozen=True)
class Frame:
    """One image, judged.

    Attributes:
        time: [s].
        points: Points of the object in it.
        measured: Whether it gave a pose.
        hold: Whether the object still moved by itself.
        surface_mm: Mean distance of the surface from where it is.
        rotation_deg: Angle of the orientation's error, without a turn about an axis of symmetry.
        path_mm: As ``surface_mm``, with O aligned over the whole run; NaN if it was never in view.
        path_deg: As ``rotation_deg``, in the same way.
        spin_rad_s: Turn about such an axis that the tracker reports; NaN without one.
        speed_mm_s: Error of the velocity of the object's middle.
        turn_rad_s: Error of the angular velocity, without that about an axis of symmetry.
        prediction_mm: As the first, `AHEAD` seconds later by the tracker's prediction; NaN where
            the recording ends before.
        frame_ms: Processor time of the image.
        keyframe_ms: That of merging it; NaN if it was not merged.
    """

    time: float
    points: int
    measured: bool
    hold: bool
    surface_mm: float
    rotation_deg: float
    path_mm: float
    path_deg: float
    spin_rad_s: float
    speed_mm_s: float
    turn_rad_s: float
    prediction_mm: float
    frame_ms: float
    keyframe_ms: float


class TrueObject:
    """What poses are judged by.

    Args:
        obj: The object.
    """

    def __init__(self, obj: RigidObject) -> None:
        self._surface = Raycaster(obj.vertices, obj.faces)
        self._mesh = obj.mesh

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        points, faces = self._mesh.sample(_SAMPLES, return_index=True, seed=0)
        return np.asarray(points), np.asarray(self._mesh.face_normals[faces])

    @cached_property
    def axes(self) -> Array:
        """Axes of symmetry in the object's frame: one of a can, three of a ball, shape (k, 3)."""
        points, faces = self._mesh.sample(_SYMMETRY_SAMPLES, return_index=True, seed=0)
        lever = np.asarray(points) - np.mean(points, axis=0)
        size = float(np.sqrt(np.square(lever).sum(axis=1).mean()))
        rows = jacobian(lever / size, np.asarray(self._mesh.face_normals[faces]))
        H = rows.T @ rows / len(rows)
        # What is left of a turn if the object is shifted back as well as can be.
        turns = H[:3, :3] - H[:3, 3:] @ np.linalg.solve(H[3:, 3:], H[3:, :3])
        values, vectors = np.linalg.eigh(turns)
        return np.asarray(vectors[:, values < _ROUND].T)

    def surface_error(self, X: Array, X_true: Array) -> float:
        """Mean distance of the surface at one pose from that at the other [m]."""
        E = se3.inverse(X_true) @ X
        points = self._samples[0] @ E[:3, :3].T + E[:3, 3]
        return float(self._surface.distance(points).mean())

    def split(self, w: Array, R: Array) -> tuple[Array, float]:
        """A rotation vector in the world without its part about axes of symmetry, and that part.

        Args:
            w: The vector, shape (3,).
            R: Orientation of the object, shape (3, 3).

        Returns:
            Shape (3,), and the length of the part that is left out; NaN without such an axis.
        """
        if len(self.axes) == 0:
            return w, np.nan
        axes = self.axes @ R.T
        about = axes.T @ (axes @ w)
        return w - about, float(np.linalg.norm(about))


def images(
    recording: Recording, sensor: Sensor, seed: int, hidden: tuple[float, float] = (0.0, 0.0)
) -> Iterator[tuple[int, ObjectView]]:
    """The images of a recording, as a sensor would have made them.

    Args:
        recording: The recording.
        sensor: The sensor.
        seed: Of its errors.
        hidden: From when to when something hides the object [s].
    """
    h, w = recording.depths.shape[1:]
    fx, fy, cx, cy = recording.intrinsics
    camera = Camera((fx, fy, cx, cy), w, h, sensor.near, sensor.noise.axial(fx))
    for k, X_WC in enumerate(recording.X_WC):
        depth = recording.depth(k)
        depth[depth < sensor.near] = 0.0
        rng = np.random.default_rng([seed, k])
        depth = sensor.noise.apply(depth, recording.intrinsics, rng, near=sensor.near, far=3.0)
        if hidden[0] < recording.times[k] < hidden[1]:
            depth[:] = 0.0
        seen = np.isfinite(depth) & (depth > 0.0)
        points = unproject(np.where(seen, depth, np.inf), camera.intrinsics)
        mask = recording.masks[k]
        used = mask & seen & ~edge_pixels(points, seen, mask, EDGE_JUMP)
        points_W = points[:, used].T @ X_WC[:3, :3].T + X_WC[:3, 3]
        yield k, ObjectView(camera, X_WC, points_W, depth)


def judge(
    trackers: Mapping[str, Tracker],
    recording: Recording,
    sensor: Sensor,
    truth: TrueObject,
    seed: int,
    hidden: tuple[float, float] = (0.0, 0.0),
) -> dict[str, list[Frame]]:
    """Plays a recording to some trackers, and says how far off each was at every image."""
    runs = {name: _Run(tracker, recording, truth) for name, tracker in trackers.items()}
    # One thread, as for `cpu_ms`; to ask for it at every image would take as long as the image.
    with threadpool_limits(1):
        for k, view in images(recording, sensor, seed, hidden):
            for run in runs.values():
                run.play(k, replace(view))  # without what another one has worked out
    return {name: run.judged() for name, run in runs.items()}


class _Run:
    """One tracker, and how far off it was."""

    def __init__(self, tracker: Tracker, recording: Recording, truth: TrueObject) -> None:
        self._frames: list[Frame] = []
        self._tracker, self._recording, self._truth = tracker, recording, truth
        self._X_BO: Array | None = None
        self._poses: list[tuple[Array, Array]] = []  # true ones, and those of O

    def judged(self) -> list[Frame]:
        """The images so far."""
        shown = [
            se3.inverse(X_true) @ X
            for frame, (X_true, X) in zip(self._frames, self._poses, strict=True)
            if frame.hold and frame.points >= IN_VIEW
        ]
        if not shown:
            return self._frames
        R = Rotation.from_matrix([X[:3, :3] for X in shown]).mean().as_matrix()
        X_OB = se3.inverse(se3.make_pose(R, np.mean([X[:3, 3] for X in shown], axis=0)))
        errors = (self._errors(X @ X_OB, X_true) for X_true, X in self._poses)
        return [
            replace(frame, path_mm=surface, path_deg=turn)
            for frame, (surface, turn) in zip(self._frames, errors, strict=True)
        ]

    def _errors(self, X: Array, X_true: Array) -> tuple[float, float]:
        """Mean distance of the surface [mm] and angle [deg], see `Frame`."""
        turned = se3.so3_log(X[:3, :3] @ X_true[:3, :3].T)
        swing, _ = self._truth.split(turned, X_true[:3, :3])
        surface = 1e3 * self._truth.surface_error(X, X_true)
        return surface, float(np.rad2deg(np.linalg.norm(swing)))

    def play(self, k: int, view: ObjectView) -> None:
        """Shows image k of the recording."""
        tracker, recording, truth = self._tracker, self._recording, self._truth
        time = float(recording.times[k])
        began = thread_time()
        tracker.looked(view, time)
        frame_ms = 1e3 * (thread_time() - began)
        if tracker.X_WO is None:
            return
        X_true = recording.X_WO[k]
        if self._X_BO is None:
            self._X_BO = se3.inverse(X_true) @ tracker.X_WO
        X_OB = se3.inverse(self._X_BO)
        X, V = tracker.X_WO @ X_OB, tracker.V_WO
        surface, angle = self._errors(X, X_true)
        w, _ = truth.split(V[:3] - recording.V_WO[k, :3], X_true[:3, :3])
        _, spin = truth.split(V[:3], X[:3, :3])
        v = V[3:] + np.cross(V[:3], X[:3, 3] - tracker.X_WO[:3, 3]) - recording.V_WO[k, 3:]
        prediction, ahead = np.nan, k + round(AHEAD * RATE)
        if ahead < len(recording.times) and recording.hold[ahead]:
            later = tracker.predicted(time, AHEAD) @ X_OB
            prediction = 1e3 * truth.surface_error(later, recording.X_WO[ahead])
        began = thread_time()
        learnt = tracker.learnt()
        keyframe_ms = 1e3 * (thread_time() - began)
        self._poses.append((X_true, tracker.X_WO))
        self._frames.append(
            Frame(
                time=time,
                points=len(view.points_W),
                measured=tracker.measured,
                hold=bool(recording.hold[k]),
                surface_mm=surface,
                rotation_deg=angle,
                path_mm=np.nan,
                path_deg=np.nan,
                spin_rad_s=spin,
                speed_mm_s=1e3 * float(np.linalg.norm(v)),
                turn_rad_s=float(np.linalg.norm(w)),
                prediction_mm=prediction,
                frame_ms=frame_ms,
                keyframe_ms=keyframe_ms if learnt else np.nan,
            )
        )


def lost(frames: list[Frame], beyond_mm: float = 10.0, longer: int = 9) -> bool:
    """Whether the surface was farther off than that in more images, while the object moved."""
    far: Mask = np.array([f.surface_mm > beyond_mm for f in frames if f.hold])
    return int(far.sum()) > longer
