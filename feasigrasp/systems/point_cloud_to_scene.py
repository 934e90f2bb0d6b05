"""What the camera sees beside robot and object becomes a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.arrays import Frozen
from feasigrasp.models.clouds.checks import MIN_POINTS
from feasigrasp.models.clouds.edges import edge_pixels
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.control.safety.obstacle_grid import obstacle_grid
from feasigrasp.models.shape.scene_field import SceneField, fit_scene
from feasigrasp.scenario.schema import SceneConfig
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output

#: Points of neighbouring pixels that are farther apart lie on different surfaces [m]; those of a
#: table seen at a slant from a metre away do not.
SCENE_EDGE_JUMP = 0.05


@dataclass(frozen=True, eq=False)
class _Surroundings(Frozen):
    """The merged views of the surroundings, in W, and the field fitted to them."""

    cloud: FusedCloud
    scene: SceneField | None


class PointCloudToScene(LeafSystem):
    """Fits a scene field to everything that a camera sees apart from some bodies.

    .. pydrake_system::

        name: PointCloudToScene
        input_ports:
        - point_cloud
        - label_image
        - camera_pose
        output_ports:
        - scene

    ``point_cloud`` is pixel-ordered, in the world frame W, ``label_image`` of the same camera,
    ``camera_pose`` X_WC a ``RigidTransform``. ``scene`` is a `SceneField` in W, or None before
    anything was seen. Views are merged, so what the camera has turned away from stays. Pixels on
    the edge of a surface are dropped: a real camera mixes the depths of two surfaces there, and
    what seems to stand between the hand and the table would hold up the arm.
    """

    def __init__(
        self,
        ignored_labels: Iterable[int],
        *,
        period: float = SceneConfig.period,
        resolution: float = SceneConfig.resolution,
    ) -> None:
        """A perception of the surroundings that looks every ``period`` seconds.

        Args:
            ignored_labels: Labels of the bodies that are no part of the scene: robot and object.
            period: Time between views [s].
            resolution: Resolution of the scene [m].
        """
        super().__init__()
        self._ignored, self._resolution = np.array(sorted(set(ignored_labels))), resolution
        self._cloud = declare_input(self, "point_cloud", PointCloud())
        self._labels = declare_input(self, "label_image", ImageLabel16I(1, 1))
        self._pose = declare_input(self, "camera_pose", RigidTransform())
        nothing = _Surroundings(FusedCloud.empty(resolution), None)
        self._seen = PeriodicState(self, nothing, period, self._look)
        state = {self._seen.ticket()}
        declare_output(self, "scene", lambda context: self._seen.Eval(context).scene, state)

    def _look(self, context: Context) -> _Surroundings:
        before: _Surroundings = self._seen.Eval(context)
        xyz = self._cloud.Eval(context).xyzs()
        labels = self._labels.Eval(context).data[:, :, 0]
        finite = np.isfinite(xyz).all(axis=0).reshape(labels.shape)
        surroundings = ~np.isin(labels, self._ignored)
        edges = edge_pixels(xyz.reshape(3, *labels.shape), finite, surroundings, SCENE_EDGE_JUMP)
        seen = finite & surroundings & ~edges
        if np.count_nonzero(seen) < MIN_POINTS:
            return before
        p_WC = self._pose.Eval(context).translation()
        cloud = before.cloud.merged(xyz[:, seen.ravel()].T, p_WC)
        scene = before.scene
        if len(cloud.points) >= MIN_POINTS:
            scene = fit_scene(cloud.points, cloud.directions, resolution=self._resolution)
            obstacle_grid(scene)  # now, and not in the tick of a controller that looks it up
        return _Surroundings(cloud, scene)
