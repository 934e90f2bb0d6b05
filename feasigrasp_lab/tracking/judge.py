"""Evaluates a tracker on recordings, by the object's true surface.

The frame O is the tracker's own, so at the first view it is aligned with the object once; from then
on every error is the tracker's. A pose is judged by the mean distance of the surface at the tracked
pose from that at the true one (ADD-S, by the mesh itself).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from time import thread_time

import numpy as np
from threadpoolctl import threadpool_limits

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.tracking.model import jacobian
from feasigrasp.models.tracking.view import ObjectView
from feasigrasp_lab.tracking.recording import RATE, Recording, Sensor, images
from feasigrasp_lab.tracking.trackers import Tracker
from feasigrasp_lab.training.data.raycasting import Raycaster

#: How far ahead poses are predicted [s]. Source: definition.
HORIZON = 0.5
#: An image with fewer points of the object does not show it. Source: definition.
IN_VIEW = 300


@dataclass(frozen=True)
class Frame:
    """One image, judged.

    Attributes:
        time: [s].
        points: Points of the object in it.
        hold: Whether the object still moved by itself.
        surface_mm: Mean distance of the surface from where it is.
        rotation_deg: Angle of the orientation's error, without a turn about an axis of symmetry.
        speed_mm_s: Error of the velocity of the object's middle.
        prediction_mm: As the first, `HORIZON` seconds later by the tracker's prediction; NaN where
            the recording ends before.
        frame_ms: Processor time of the image.
        keyframe_ms: That of merging it; NaN if it was not merged.
    """

    time: float
    points: int
    hold: bool
    surface_mm: float
    rotation_deg: float
    speed_mm_s: float
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
        # Points of the true surface that are compared.
        points, faces = self._mesh.sample(400, return_index=True, seed=0)
        return np.asarray(points), np.asarray(self._mesh.face_normals[faces])

    @cached_property
    def axes(self) -> Array:
        """Axes of symmetry in the object's frame: one of a can, three of a ball, shape (k, 3)."""
        # Points for the test of symmetry.
        points, faces = self._mesh.sample(3000, return_index=True, seed=0)
        lever = np.asarray(points) - np.mean(points, axis=0)
        size = float(np.sqrt(np.square(lever).sum(axis=1).mean()))
        rows = jacobian(lever / size, np.asarray(self._mesh.face_normals[faces]))
        H = rows.T @ rows / len(rows)
        # What is left of a turn if the object is shifted back as well as can be.
        turns = H[:3, :3] - H[:3, 3:] @ np.linalg.solve(H[3:, 3:], H[3:, :3])
        values, vectors = np.linalg.eigh(turns)
        # Mean square of what a turn moves the surface across itself, over the square of its size,
        # below which the object is round: the built-in ones are below 0.002 or above 0.02.
        return np.asarray(vectors[:, values < 5e-3].T)

    def surface_error(self, X: Array, X_true: Array) -> float:
        """Mean distance of the surface at one pose from that at the other [m]."""
        E = se3.inverse(X_true) @ X
        points = self._samples[0] @ E[:3, :3].T + E[:3, 3]
        return float(self._surface.distance(points).mean())

    def without_symmetric(self, w: Array, R: Array) -> Array:
        """A rotation vector in the world without its part about axes of symmetry, shape (3,).

        Args:
            w: The vector, shape (3,).
            R: Orientation of the object, shape (3, 3).
        """
        axes = self.axes @ R.T
        return np.asarray(w - axes.T @ (axes @ w))


def judge(
    trackers: Mapping[str, Tracker],
    recording: Recording,
    sensor: Sensor,
    truth: TrueObject,
    seed: int,
) -> dict[str, list[Frame]]:
    """Plays a recording to some trackers, and says how far off each was at every image."""
    runs = {name: _Run(tracker, recording, truth) for name, tracker in trackers.items()}
    # To ask for one thread at every image would take as long as the image.
    with threadpool_limits(1):
        for k, view in images(recording, sensor, seed):
            for run in runs.values():
                run.play(k, replace(view))  # without what another one has worked out
    return {name: run.frames for name, run in runs.items()}


class _Run:
    """One tracker, and how far off it was."""

    def __init__(self, tracker: Tracker, recording: Recording, truth: TrueObject) -> None:
        self.frames: list[Frame] = []
        self._tracker, self._recording, self._truth = tracker, recording, truth
        self._X_BO: Array | None = None

    def _errors(self, X: Array, X_true: Array) -> tuple[float, float]:
        """Mean distance of the surface [mm] and angle [deg], see `Frame`."""
        turned = se3.so3_log(X[:3, :3] @ X_true[:3, :3].T)
        swing = self._truth.without_symmetric(turned, X_true[:3, :3])
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
        v = V[3:] + np.cross(V[:3], X[:3, 3] - tracker.X_WO[:3, 3]) - recording.V_WO[k, 3:]
        prediction, ahead = np.nan, k + round(HORIZON * RATE)
        if ahead < len(recording.times) and recording.hold[ahead]:
            later = tracker.predicted(time, HORIZON) @ X_OB
            prediction = 1e3 * truth.surface_error(later, recording.X_WO[ahead])
        began = thread_time()
        learnt = tracker.learnt()
        keyframe_ms = 1e3 * (thread_time() - began)
        self.frames.append(
            Frame(
                time=time,
                points=len(view.points_W),
                hold=bool(recording.hold[k]),
                surface_mm=surface,
                rotation_deg=angle,
                speed_mm_s=1e3 * float(np.linalg.norm(v)),
                prediction_mm=prediction,
                frame_ms=frame_ms,
                keyframe_ms=keyframe_ms if learnt else np.nan,
            )
        )


def lost(frames: list[Frame]) -> bool:
    """Whether the surface was more than 10 mm off in 10 images, while the object moved."""
    return sum(frame.surface_mm > 10.0 for frame in frames if frame.hold) >= 10
