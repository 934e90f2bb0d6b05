"""Fits the distance field to the keyframes of a tracker."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.shape.completion import DEFAULT
from feasigrasp.models.shape.grids import object_grid
from feasigrasp.models.tracking.keyframe import Keyframe
from feasigrasp.models.tracking.tracker import LearntShape
from feasigrasp.scenario.schema import PerceptionConfig
from feasigrasp.systems.point_cloud_to_gpdf import Perceived, declare_perceived
from feasigrasp.systems.ports import PeriodicState, declare_input, evaluate


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
