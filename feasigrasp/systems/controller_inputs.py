"""The inputs of a controller of the arm at one instant."""

from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.planning.search_pose import SearchTarget
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.objects.tracking import Tracking
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.systems.ports import evaluate, optional


class ControllerInputs:
    """The inputs of a `GraspController` at one instant: what `update` and `velocity` are given.

    Every property reads its port when it is asked for: at control rate a port without use
    costs as much as the law itself.
    """

    __slots__ = ("_context", "_controller")

    def __init__(self, controller: Any, context: Context) -> None:
        self._controller, self._context = controller, context

    @property
    def time(self) -> float:
        """Now [s]."""
        return float(self._context.get_time())

    @property
    def q(self) -> Array:
        """Joint positions [rad], shape (7,)."""
        return self._controller._position.Eval(self._context)

    @property
    def grasps(self) -> GraspSet:
        """Reachable grasps in the object frame."""
        return self._controller._grasps.Eval(self._context)

    @property
    def X_WO(self) -> Array:
        """Object pose, shape (4, 4) [m]; not finite while it is unknown."""
        return self._controller._pose.Eval(self._context).GetAsMatrix4()

    @property
    def V_WO(self) -> Array:
        """Object twist [angular; linear], shape (6,)."""
        return self._controller._twist.Eval(self._context).get_coeffs()

    @property
    def motion(self) -> Motion | None:
        """Predicts the object's poses; without it they follow its twist."""
        return optional(self._controller._motion, self._context)

    @property
    def committed(self) -> bool:
        """Whether the hand is closing, or has closed, on the one grasp there is."""
        phase: Array | None = optional(self._controller._phase, self._context)
        return phase is not None and phase[0] > Phase.APPROACH

    @property
    def gpdf(self) -> Gpdf | None:
        """The object's distance field, in its frame; None while there is none."""
        return optional(self._controller._gpdf, self._context)

    @property
    def qd_last(self) -> Array | None:
        """The last command as the drive carried it out [rad/s], shape (7,)."""
        return optional(self._controller._last, self._context)

    @property
    def touch(self) -> Array:
        """Torques of a contact that the arm gives way to [Nm], shape (7,); zero without one."""
        touch: Array | None = optional(self._controller._touch, self._context)
        return np.zeros(self._controller.reachability.arm.joints) if touch is None else touch

    @property
    def X_WC(self) -> Array | None:
        """Pose of the camera on the hand, shape (4, 4) [m]; None without one."""
        X_WC: RigidTransform | None = optional(self._controller._camera_pose, self._context)
        return None if X_WC is None else X_WC.GetAsMatrix4()

    @property
    def search_target(self) -> SearchTarget | None:
        """The search target; None while the object is in sight."""
        return optional(self._controller._search_target, self._context)

    @property
    def seen_by_arm(self) -> bool:
        """Whether the object is tracked with the camera on the hand."""
        tracking: Tracking | None = optional(self._controller._tracking, self._context)
        return self.X_WC is not None and tracking is not None and tracking.expected is not None

    @property
    def obstacles(self) -> ObstacleGrid | None:
        """Distances to scene and static obstacles, which the arm keeps clear of.

        None where there are none.
        """
        return evaluate(self._controller._obstacles, self._context)

    @property
    def surface(self) -> ObstacleGrid | None:
        """Distances to the object's surface, in its frame; None while there is no field.

        Without unobserved surface, if the grasp that the hand is nearly at is in there.
        """
        return evaluate(self._controller._surface, self._context)
