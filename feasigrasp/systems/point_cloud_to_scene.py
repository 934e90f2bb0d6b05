"""What the camera sees beside robot and object becomes a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.arrays import Frozen
from feasigrasp.models.clouds.checks import MIN_POINTS
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.shape.scene_field import SceneField, fit_scene
from feasigrasp.scenario.schema import SceneConfig


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
    anything was seen. Views are merged, so what the camera has turned away from stays.
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
        self._cloud = self.DeclareAbstractInputPort("point_cloud", AbstractValue.Make(PointCloud()))
        self._labels = self.DeclareAbstractInputPort(
            "label_image", AbstractValue.Make(ImageLabel16I(1, 1))
        )
        self._pose = self.DeclareAbstractInputPort("camera_pose", Value[RigidTransform]())
        nothing = _Surroundings(FusedCloud.empty(resolution), None)
        self._state = self.DeclareAbstractState(AbstractValue.Make(nothing))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._look)
        self.DeclareAbstractOutputPort(
            "scene", Value[object], self._calc, {self.abstract_state_ticket(self._state)}
        )

    def _look(self, context: Context, state) -> None:
        xyz = self._cloud.Eval(context).xyzs()
        labels = self._labels.Eval(context).data.reshape(-1)
        seen = np.isfinite(xyz).all(axis=0) & ~np.isin(labels, self._ignored)
        if np.count_nonzero(seen) < MIN_POINTS:
            return
        before: _Surroundings = context.get_abstract_state(int(self._state)).get_value()
        p_WC = self._pose.Eval(context).translation()
        cloud = before.cloud.merged(xyz[:, seen].T, p_WC)
        scene = before.scene
        if len(cloud.points) >= MIN_POINTS:
            scene = fit_scene(cloud.points, cloud.directions, resolution=self._resolution)
        state.get_mutable_abstract_state(int(self._state)).set_value(_Surroundings(cloud, scene))

    def _calc(self, context: Context, output) -> None:
        output.set_value(context.get_abstract_state(int(self._state)).get_value().scene)
