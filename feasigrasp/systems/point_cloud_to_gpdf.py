"""Perception: fuses views, or a tracker's keyframes, in the object frame; fits a field."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.checks import (
    MIN_POINTS,
    MIN_SPREAD,
    ViewFault,
    ViewRecord,
    of_one_depth,
    spread_across,
    usable_points,
)
from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.objects.tracking import Tracking
from feasigrasp.models.quantities import Bound, Count, Positive, Whole
from feasigrasp.models.shape.completion import DEFAULT, complete_shape
from feasigrasp.models.shape.grids import object_grid
from feasigrasp.models.tracking.keyframe import Keyframe
from feasigrasp.models.tracking.tracker import LearntShape
from feasigrasp.scenario.schema import PerceptionConfig
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_input,
    declare_output,
    evaluate,
    optional,
    scalar,
)

#: A view contradicts the earlier ones beyond this share, see `FusedCloud.contradicted`. Source:
#: guessed.
MAX_CONTRADICTION = 0.3
#: Consecutive views that contradict the earlier ones, and not each other, are right if they
#: show this share of the surface that the earlier ones did: a close look at a part is no reason to
#: forget the rest. Source: guessed.
OUTVOTING, OUTVOTING_SHARE = 4, 0.7
#: Points of a view (n, 3), position of the camera (3,) and outline, all in O.
_View = tuple[Array, Array, Outline | None]


@dataclass(frozen=True, eq=False)
class Perceived(LearntShape):
    """State of perception: the shape merged from the views, and what is wrong with them.

    A view that does not show the object is no fault.

    Attributes:
        contradicted: Whether the last look contradicts the earlier views: then the tracked pose is
            wrong, or another object is seen. The view was not merged.
        last_fault: What was wrong with the last look, and with what figures; empty if nothing was.
        rival: The views since then that contradict the earlier ones, and not each other.
    """

    contradicted: bool = False
    last_fault: str = ""
    rival: FusedCloud | None = None

    def without(self, fault: ViewFault, detail: str = "") -> Perceived:
        """The state with one more rejected view."""
        text = f"{fault}: {detail}" if detail else str(fault)
        return replace(self, faults=self.faults + Counter([fault]), last_fault=text)


def declare_perceived(system: LeafSystem, state: PeriodicState) -> None:
    """The output ports ``gpdf``, ``perceived``, ``view_time`` and ``view_faults`` of a perception.

    See `PointCloudToGPDF` for what they are; the ``state`` is a `Perceived`.
    """

    def view_time(context: Context) -> float:
        times = state.Eval(context).views.times
        return times[-1] if len(times) else np.nan

    def view_faults(context: Context) -> int:
        return state.Eval(context).faults.total()

    declare_output(system, "gpdf", lambda context: state.Eval(context).gpdf, {state})
    declare_output(system, "perceived", state.Eval, {state})
    declare_output(system, "view_time", view_time, {state}, size=1)
    declare_output(system, "view_faults", view_faults, {state}, size=1)


class PointCloudToGPDF(LeafSystem):
    """Fits a Gaussian-process distance field to the views of a tracked object.

    .. pydrake_system::

        name: PointCloudToGPDF
        input_ports: [point_cloud, image_time, object_pose, camera_pose, tracking, outline]
        output_ports: [gpdf, perceived, view_time, view_faults]

    ``point_cloud`` shows the object only, in the world frame W, at ``image_time`` (V1) [s], NaN
    before the first image, or now if that is left open; ``object_pose`` X_WO and ``camera_pose``
    X_WC of that instant are ``RigidTransform``. ``tracking`` is a `Tracking` and may be left open:
    while it says that the object is lost, the pose is worth nothing, and no view is compared with
    it. So may ``outline``, an `Outline` in the camera's axes or None, without which all that is
    beside the cloud is taken for free. ``gpdf`` is a `Gpdf` in the object frame O, or None before
    the first usable view; ``perceived`` holds the merged cloud as well, ``view_time`` the time of
    its last view [s], NaN before. The inputs are read every ``period`` seconds. A view with too few
    finite points (object out of sight, or hidden by the hand) changes nothing: the field of the
    earlier views stays valid in O. Nor does one that cannot be used, whatever is wrong with it: it
    is counted in ``view_faults`` (V1) and named in ``perceived``. Outliers are dropped before a
    view is merged. From a side that it has seen ``views_per_side`` times it merges no view until
    ``revisit`` seconds have passed; it looks there (something is rendered, but nothing fitted)
    every ``check`` seconds, to see whether the tracked pose is still true. A view that contradicts
    the earlier ones is not merged; but if `OUTVOTING` in turn do, and agree with each other, they
    replace the earlier ones.

    By default every view is smoothed, registered to the earlier ones and remembered with its
    silhouette, so that the field stays out of space the camera has looked through; ``preset:
    paper`` merges plain voxel means and fits the paper's field.
    """

    @checked(PointCloudError)
    def __init__(
        self,
        period: Positive = PerceptionConfig.period,
        *,
        preset: str = DEFAULT,
        max_points: Count = PerceptionConfig.max_points,
        length_scale: Positive = PerceptionConfig.length_scale,
        voxel_size: Positive = PerceptionConfig.voxel_size,
        hidden_side: bool = True,
        max_views: Whole = 0,
        views_per_side: Whole = 3,
        revisit: Bound = 5.0,
        check: Positive = 1.0,
    ) -> None:
        """A perception that looks every ``period`` seconds.

        Args:
            period: Time between views [s].
            preset: Which field, see `complete_shape`.
            max_points: Surface points that the field is fitted to.
            length_scale: Length scale of the field's kernel [m].
            voxel_size: Resolution at which views are merged [m].
            hidden_side: Whether what lies behind the seen surface is guessed (default preset only).
            max_views: Largest number of views that are merged; 0 for all.
            views_per_side: Number of views from one direction that suffices, see `ViewRecord`.
            revisit: A side not merged for so long is merged again [s]; infinite for never.
            check: The object is looked at at least this often [s].
        """
        super().__init__()
        nothing = FusedCloud.empty(voxel_size, smooth=preset == DEFAULT)
        cap = sphere_points(400, 0.03)
        cap = cap[cap[:, 2] > 0.0]
        twice = nothing.merged(cap, [0.0, 0.0, 0.5]).merged(cap, [0.0, 0.1, 0.5])
        _ = complete_shape(twice, preset=preset).completion  # compiles, before the first tick
        self._nothing = nothing
        self._options: dict[str, Any] = {
            "preset": preset,
            "max_points": max_points,
            "length_scale": length_scale,
            "learnt": hidden_side,
        }
        self._max_views = max_views
        self._views_per_side, self._revisit, self._check = views_per_side, revisit, check
        self._cloud = declare_input(self, "point_cloud", PointCloud())
        self._image_time = self.DeclareVectorInputPort("image_time", 1)
        self._object_pose = declare_input(self, "object_pose", RigidTransform())
        self._camera_pose = declare_input(self, "camera_pose", RigidTransform())
        self._tracking = declare_input(self, "tracking", kind=Tracking)
        self._outline = declare_input(self, "outline", kind=Outline | None)
        self._seen = PeriodicState(self, Perceived(nothing), period, self._look)
        declare_perceived(self, self._seen)

    def _look(self, context: Context) -> Perceived:
        seen: Perceived = self._seen.Eval(context)
        if self._max_views and len(seen.views.times) >= self._max_views:
            return seen
        if self._tracking.HasValue(context) and self._tracking.Eval(context).lost:
            return replace(seen, contradicted=False).without(ViewFault.UNKNOWN_POSE)
        X_OW = self._object_pose.Eval(context).inverse()
        X_WC = self._camera_pose.Eval(context)
        p_OC = X_OW @ X_WC.translation()
        if not (np.isfinite(X_OW.GetAsMatrix4()).all() and np.isfinite(p_OC).all()):
            return seen.without(ViewFault.UNKNOWN_POSE)
        time = scalar(self._image_time, context, context.get_time())
        if not np.isfinite(time):
            return seen
        enough = self._views_per_side, self._revisit
        news = seen.views.adds_information(p_OC, time, *enough)
        if not news and time < seen.looked + self._check - 1e-9:
            return seen
        points_W = self._cloud.Eval(context).xyzs().T
        finite = np.isfinite(points_W).all(axis=1)
        fewest = 4 * MIN_POINTS  # a view with fewer points shows nothing
        if len(finite) >= fewest and not finite.any():
            return seen.without(ViewFault.NOT_FINITE, f"{len(finite)} points of the object's mask")
        points_O = (X_OW @ points_W[finite].T).T
        if len(points_O) < fewest:
            # Whether the pose is wrong is undecided; the hand has to take a view.
            # A contradiction is forgotten when the object has been out of sight for so long [s].
            doubted = seen.contradicted and time < seen.looked + 2.0 - 1e-9
            return replace(seen, contradicted=doubted)
        kept, fault, detail = usable_points(points_O, p_OC, fewest, seen.cloud.points)
        if fault is None and of_one_depth(points_W[finite], X_WC.GetAsMatrix4()):
            fault, detail = ViewFault.ONE_DEPTH, f"{len(points_O)} points"
        if fault is not None:
            return seen.without(fault, detail)
        outline: Outline | None = optional(self._outline, context)
        if outline is not None:
            outline = outline.turned((X_OW @ X_WC).rotation().matrix())
        view = kept, p_OC, outline
        contradicted = seen.cloud.contradicted(*view) > MAX_CONTRADICTION
        looked = replace(seen, looked=time, contradicted=contradicted, last_fault="", rival=None)
        if contradicted:
            looked = self._doubted(looked, seen.rival, view)
        if looked.contradicted or not (news or looked.gpdf is None):
            return looked
        merged = self._merged(looked, view)
        return replace(merged, outliers=seen.outliers + len(points_O) - len(kept))

    def _doubted(self, seen: Perceived, rival: FusedCloud | None, view: _View) -> Perceived:
        """What is known after a view that contradicts it.

        Usually the pose is wrong now, and later views agree again. But it may have been wrong when
        the first views were merged: if all that come after agree, those are forgotten.
        """
        if rival is None or rival.contradicted(*view) > MAX_CONTRADICTION:
            rival = self._nothing
        enough = len(rival.points) > OUTVOTING_SHARE * len(seen.cloud.points)
        if rival.views + 1 < OUTVOTING or not enough:
            return replace(seen, rival=rival.merged(*view[:2], outline=view[2]))
        outvoted = seen.faults + Counter({ViewFault.OUTVOTED: seen.cloud.views})
        return replace(
            seen, cloud=rival, gpdf=None, views=ViewRecord(), contradicted=False, faults=outvoted
        )

    def _merged(self, seen: Perceived, view: _View) -> Perceived:
        """What is known after one more view; without it if no field comes of it."""
        try:
            points_O, p_OC, outline = view
            cloud = seen.cloud.merged(points_O, p_OC, outline=outline)
            if len(cloud.points) < MIN_POINTS or spread_across(cloud.points) < MIN_SPREAD:
                return seen.without(ViewFault.NO_SURFACE)
            gpdf = complete_shape(cloud, **self._options)
            object_grid(gpdf)  # now, and not in the tick of a controller that looks it up
        # Whatever numerics make of a strange cloud (LinAlgError is a ValueError): the run goes on.
        except (ValueError, ArithmeticError) as error:
            return seen.without(ViewFault.NO_FIELD, str(error))
        return replace(seen, cloud=cloud, gpdf=gpdf, views=seen.views.extended(p_OC, seen.looked))


class KeyframesToGPDF(LeafSystem):
    """Fits a distance field to the keyframes of a `FieldTracker`; else as `PointCloudToGPDF`.

    .. pydrake_system::

        name: KeyframesToGPDF
        input_ports: [keyframe]
        output_ports: [gpdf, perceived, view_time, view_faults]

    The tracker says which views are worth merging, and has registered them to the field already:
    they are merged where they are, and O does not move. Where it has begun anew, with another O,
    what was merged is forgotten. A keyframe that cannot be used is counted in ``view_faults``.
    """

    def __init__(self, period: float, config: PerceptionConfig | None = None) -> None:
        """A perception that looks for a new keyframe every ``period`` seconds."""
        super().__init__()
        config = config or PerceptionConfig()
        self._max_views = config.views
        self._options: dict[str, Any] = {
            "preset": config.preset,
            "max_points": config.max_points,
            "length_scale": config.length_scale,
            "learnt": config.hidden_side,
        }
        nothing = Perceived(FusedCloud.empty(config.voxel_size, smooth=config.preset == DEFAULT))
        cap = sphere_points(400, 0.03)
        seen = Keyframe(cap[cap[:, 2] > 0.0], np.array([0.0, 0.0, 0.5]), 0.0)
        compiled = nothing.merged(seen, **self._options).gpdf  # before the first tick
        _ = None if compiled is None else compiled.completion
        self._keyframe = declare_input(self, "keyframe", kind=Keyframe | None)
        self._learnt = PeriodicState(self, nothing, period, self._look)
        declare_perceived(self, self._learnt)

    def _look(self, context: Context) -> LearntShape:
        learnt: Perceived = self._learnt.Eval(context)
        key: Keyframe | None = evaluate(self._keyframe, context)
        enough = self._max_views and len(learnt.views.times) >= self._max_views
        if key is not None and enough and learnt.is_of(key):
            return learnt
        after = learnt.merged(key, **self._options)
        if after.gpdf is not None:
            object_grid(after.gpdf)  # now, and not in the tick of a controller that looks it up
        return after
