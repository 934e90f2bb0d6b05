"""Perception: views of the object, merged in its own frame, become a distance field."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Frozen
from feasigrasp.models.clouds.checks import MIN_POINTS, MIN_SPREAD, spread_across
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.view_record import ViewRecord
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.shape.completion import Preset, complete_shape
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.scenario.schema import PerceptionConfig
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output


@dataclass(frozen=True, eq=False)
class Perceived(Frozen):
    """What has been seen of the object.

    Attributes:
        cloud: The merged views, in the object frame O.
        gpdf: The field fitted to them, in O; None until the object was seen.
        views: From where it has been seen.
        seen_at: Time of the last view that was merged [s]; NaN before.
    """

    cloud: FusedCloud
    gpdf: Gpdf | None
    views: ViewRecord = field(default_factory=ViewRecord)
    seen_at: float = float("nan")


class PointCloudToGPDF(LeafSystem):
    """Fits a Gaussian-process distance field to the views of a tracked object.

    .. pydrake_system::

        name: PointCloudToGPDF
        input_ports:
        - point_cloud
        - object_pose
        - camera_pose
        output_ports:
        - gpdf
        - perceived
        - seen_at

    ``point_cloud`` shows the object only, in the world frame W; ``object_pose`` X_WO and
    ``camera_pose`` X_WC are ``RigidTransform``. ``gpdf`` is a `Gpdf` in the object frame O, or None
    before the first usable view; ``perceived`` holds the merged cloud as well; ``seen_at`` is the
    time of its last view [s], NaN before. The inputs are read every ``period`` seconds. A view with
    too few finite points (object out of sight, or hidden by the hand) changes nothing: the field of
    the earlier views stays valid in O. From a side that it has seen ``views_per_side`` times it
    does not look at all (nothing is rendered and nothing fitted), until ``revisit`` seconds have
    passed.

    By default every view is smoothed, registered to the earlier ones and remembered with its
    silhouette, so that the field stays out of space the camera has looked through; ``preset:
    paper`` merges plain voxel means and fits the paper's field.
    """

    def __init__(
        self,
        period: float = PerceptionConfig.period,
        *,
        preset: str = PerceptionConfig.preset,
        max_points: int = PerceptionConfig.max_points,
        length_scale: float = PerceptionConfig.length_scale,
        voxel_size: float = PerceptionConfig.voxel_size,
        views_per_side: int = 3,
        revisit: float = 5.0,
        min_points: int = 4 * MIN_POINTS,
    ) -> None:
        """A perception that looks every ``period`` seconds.

        Args:
            period: Time between views [s].
            preset: ``default`` or ``paper``, see `complete_shape`.
            max_points: Surface points that the field is fitted to.
            length_scale: Length scale of the field's kernel [m].
            voxel_size: Resolution at which views are merged [m].
            views_per_side: So many views from one direction suffice, see `ViewRecord`.
            revisit: A side not looked at for so long is looked at again [s].
            min_points: A view with fewer finite points is ignored.
        """
        super().__init__()
        nothing = FusedCloud.empty(voxel_size, smooth=preset == Preset.DEFAULT)
        cap = sphere_points(400, 0.03)
        cap = cap[cap[:, 2] > 0.0]
        twice = nothing.merged(cap, [0.0, 0.0, 0.5]).merged(cap, [0.0, 0.1, 0.5])
        _ = complete_shape(twice, preset=preset).completion  # compiles, before the first tick
        self._options: dict[str, Any] = {
            "preset": preset,
            "max_points": max_points,
            "length_scale": length_scale,
        }
        self._views_per_side, self._revisit = views_per_side, revisit
        self._min_points = min_points
        self._cloud = declare_input(self, "point_cloud", PointCloud())
        self._object_pose = declare_input(self, "object_pose", RigidTransform())
        self._camera_pose = declare_input(self, "camera_pose", RigidTransform())
        self._seen = PeriodicState(self, Perceived(nothing, None), period, self._look)
        state = {self._seen.ticket()}
        declare_output(self, "gpdf", lambda context: self._seen.Eval(context).gpdf, state)
        declare_output(self, "perceived", self._seen.Eval, state)
        self.DeclareVectorOutputPort("seen_at", 1, self._calc_seen_at, state)

    def _look(self, context: Context) -> Perceived:
        seen: Perceived = self._seen.Eval(context)
        X_OW = self._object_pose.Eval(context).inverse()
        p_OC = X_OW @ self._camera_pose.Eval(context).translation()
        if not (np.isfinite(X_OW.GetAsMatrix4()).all() and np.isfinite(p_OC).all()):
            return seen
        time = context.get_time()
        if not seen.views.tells_more(p_OC, time, self._views_per_side, self._revisit):
            return seen
        points_W = self._cloud.Eval(context).xyzs().T
        points_W = points_W[np.isfinite(points_W).all(axis=1)]
        if len(points_W) < self._min_points:
            return seen
        cloud = seen.cloud.merged((X_OW @ points_W.T).T, p_OC)
        if len(cloud.points) < MIN_POINTS or spread_across(cloud.points) < MIN_SPREAD:
            return seen
        gpdf = complete_shape(cloud, **self._options)
        return Perceived(cloud, gpdf, seen.views.extended(p_OC, time), time)

    def _calc_seen_at(self, context: Context, output) -> None:
        output.SetAtIndex(0, self._seen.Eval(context).seen_at)
