"""What the camera sees beside robot and object becomes a scene that grasps keep clear of."""

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
from feasigrasp.models.grasps.grasp_set import FLIP, GraspSet, Rejection
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.scene_field import SceneField, fit_scene, scene_clear


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
        self, ignored_labels: Iterable[int], *, period: float = 1.0, resolution: float = 0.01
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


class SceneFilter(LeafSystem):
    """Drops the grasps at which the open hand would be in the scene.

    .. pydrake_system::

        name: SceneFilter
        input_ports:
        - grasps
        - object_pose
        - scene
        output_ports:
        - grasps

    ``grasps`` are in the object frame O, before and after; ``object_pose`` X_WO is a
    ``RigidTransform``; ``scene`` a `SceneField` in W, or None, which drops nothing. What is dropped
    is counted as "hits the scene".
    """

    def __init__(
        self, gripper: ParallelGripper, *, margin: float = 0.005, either_way_round: bool = False
    ) -> None:
        """A filter for one hand.

        Args:
            gripper: The hand.
            margin: Least distance of the hand from every surface [m].
            either_way_round: Whether a grasp stays if the hand is clear after half a turn about
                the approach direction; for sets whose grasps have not been turned yet.
        """
        super().__init__()
        self._gripper, self._margin, self._either = gripper, margin, either_way_round
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self._scene = self.DeclareAbstractInputPort("scene", Value[object](None))
        self.DeclareAbstractOutputPort(
            "grasps",
            lambda: AbstractValue.Make(GraspSet.empty()),
            self._calc,
            {self._grasps.ticket(), self._pose.ticket(), self._scene.ticket()},
        )

    def _calc(self, context: Context, output) -> None:
        grasps: GraspSet = self._grasps.Eval(context)
        scene: SceneField | None = self._scene.Eval(context)
        if scene is not None and len(grasps) > 0:
            X_WG = self._pose.Eval(context).GetAsMatrix4() @ grasps.X_OG
            clear = scene_clear(scene, X_WG, self._gripper, self._margin)
            if self._either:
                other = np.flatnonzero(~clear)
                clear[other] = scene_clear(scene, X_WG[other] @ FLIP, self._gripper, self._margin)
            grasps = grasps.select(clear, Rejection.HITS_SCENE)
        output.set_value(grasps)
