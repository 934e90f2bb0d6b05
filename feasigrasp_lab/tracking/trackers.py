"""Trackers on recordings: ours, and other registrations in its place.

Peers register image against model, point to plane. They get what ours gets: the same images and
points, the pose expected from the last two, and a model that grows by the same rule of keyframes,
fused in voxels as ours is.
"""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.checks import ViewRecord
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.tracking.keyframe import KEY_PERIOD, KEY_VIEWS
from feasigrasp.models.tracking.tracker import SequenceTracker
from feasigrasp.models.tracking.view import ObjectView


class OurTracker:
    """`SequenceTracker`, image by image."""

    def __init__(self) -> None:
        self._now = SequenceTracker()

    def looked(self, view: ObjectView, time: float) -> None:
        """Takes in an image, at a time [s]."""
        self._now = self._now.looked(view, time)

    def learnt(self) -> bool:
        """Merges the last view if it is informative; whether it did."""
        before, self._now = self._now, self._now.learnt()
        return self._now is not before

    @property
    def X_WO(self) -> Array | None:
        """The pose at the time of the last image, shape (4, 4); None before the first view."""
        estimate = self._now.track.estimate
        return None if estimate is None else estimate.X_WO

    @property
    def V_WO(self) -> Array:
        """The twist, shape (6,)."""
        estimate = self._now.track.estimate
        return np.zeros(6) if estimate is None else estimate.V_WO

    def predicted(self, time: float, ahead: float) -> Array:
        """The pose ``ahead`` seconds later, as the motion of the last seconds goes on, (4, 4)."""
        track = self._now.track
        X_WO = None if track.estimate is None else track.estimate.pose(time)
        X: Array = MotionEstimate(track.motion, time, X_WO).predict([ahead])[0]
        return X


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
        self._measured = False

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
        self._view, self._measured, self._fit = view, False, 0.0
        if not self._poses:
            if len(view.points_W) >= first:
                X = se3.make_pose(np.eye(3), np.median(view.points_W, axis=0))
                self._poses, self._measured, self._fit = [(time, X)], True, 1.0
            return
        X = se3.extrapolate(self._poses[-1][1], self.V_WO, time - self._poses[-1][0])
        if len(view.points_W) >= least and len(self._cloud.points):
            points = view.points_W[:: -(-len(view.points_W) // _POINTS)]
            X_OW, self._fit = self._registration(
                points, self._cloud.points, self._cloud.normals, se3.inverse(X)
            )
            if self._fit >= _ACCEPTED:
                X, self._measured = se3.inverse(X_OW), True
        # The twist is the mean over so many images.
        self._poses = [*self._poses[1 - 6 :], (time, X)]

    def learnt(self) -> bool:
        """Merges the last image where the same rule as ours asks for it."""
        if not self._measured or self._fit < _MERGED or self._view is None:
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


#: What plays a recording; ``V_WO`` and ``predicted`` want a first view.
Tracker = OurTracker | PeerTracker
