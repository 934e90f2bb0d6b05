"""Grasps that the hand cannot take without touching the scene, or what may be, are dropped."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.grasps.grasp_set import FLIP, GraspSet, Rejection
from feasigrasp.models.grasps.scene_clear import scene_clear, unseen_clear
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.scene_field import SceneField
from feasigrasp.systems.ports import declare_input, declare_output, evaluate


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
    is counted as "hits the scene", as "in space that was never seen" where the hand would stand in
    what may belong to the scene, or as "the object's pose is unknown" while that is not finite.
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
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._scene = declare_input(self, "scene", kind=SceneField | None)
        inputs = {self._grasps.ticket(), self._pose.ticket(), self._scene.ticket()}
        declare_output(self, "grasps", self._calc, inputs)

    def _calc(self, context: Context) -> GraspSet:
        grasps: GraspSet = self._grasps.Eval(context)
        scene: SceneField | None = evaluate(self._scene, context)
        if scene is None or len(grasps) == 0:
            return grasps
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        if not np.isfinite(X_WO).all():
            return grasps.select(np.zeros(len(grasps), dtype=bool), Rejection.UNKNOWN_POSE)
        for judge, reason in (
            (scene_clear, Rejection.HITS_SCENE),
            (unseen_clear, Rejection.UNSEEN),
        ):
            X_WG = X_WO @ grasps.X_OG
            clear = judge(scene, X_WG, self._gripper, self._margin)
            if self._either:
                other = np.flatnonzero(~clear)
                clear[other] = judge(scene, X_WG[other] @ FLIP, self._gripper, self._margin)
            grasps = grasps.select(clear, reason)
        return grasps
