"""True pose of the object frame that a tracker has chosen."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.tracking.tracker import FieldTrack
from feasigrasp.systems.ports import declare_input, declare_output, optional, weakly


class TrueFrame(LeafSystem):
    """Follows the object frame O of a tracker as if it were painted on the object.

    .. pydrake_system::

        name: TrueFrame
        input_ports: [object_pose, pose_at_view, tracked_pose, track]
        output_ports: [frame_pose]

    ``object_pose`` is the true pose X_WB of the object's own frame, ``pose_at_view`` the one at the
    exposure of the image that was tracked last, and ``tracked_pose`` X_WO of the frame that the
    tracker chose at the first view, NaN before. Where O is on the object, X_BO, is
    taken from both once, as soon as there is a tracked pose, and again if the tracker's ``track``
    (`FieldTrack`, optional) begins a new O; from then on ``frame_pose`` is X_WB X_BO, whatever the
    tracker says: by it is judged how well the hand follows grasps that are in O. Before it is X_WB.
    """

    def __init__(self, period: float) -> None:
        """Ground truth for evaluation; no evaluated system may read it.

        Args:
            period: Time between looks for the first tracked pose [s]; so long, at most, the object
                has moved since. Between two steps of the physics it does not move.
        """
        super().__init__()
        self._object_pose = declare_input(self, "object_pose", RigidTransform())
        self._at_view = declare_input(self, "pose_at_view", RigidTransform())
        self._tracked_pose = declare_input(self, "tracked_pose", RigidTransform())
        self._track = declare_input(self, "track", FieldTrack())
        # X_BO, and when O was begun [s]; discrete, since an abstract state invalidates all caches.
        self.DeclareDiscreteState(np.full(13, np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._align))
        declare_output(self, "frame_pose", self._calc, model=RigidTransform())

    def _align(self, context: Context, state) -> EventStatus:
        track = optional(self._track, context)
        begun_at = -np.inf if track is None else track.begun_at
        if context.get_discrete_state_vector().value()[12] == begun_at:
            return EventStatus.DidNothing()
        X_WO = self._tracked_pose.Eval(context).GetAsMatrix4()
        if not np.isfinite(X_WO).all():
            return EventStatus.DidNothing()
        X_BO = inverse_kernel(self._at_view.Eval(context).GetAsMatrix4()) @ X_WO
        state.get_mutable_vector().SetFromVector([*X_BO[:3].ravel(), begun_at])
        return EventStatus.Succeeded()

    def _calc(self, context: Context) -> RigidTransform:
        gauge = context.get_discrete_state_vector().value()[:12]
        X_WB = self._object_pose.Eval(context)
        if not np.isfinite(gauge).all():
            return X_WB
        X_BO = np.eye(4)
        X_BO[:3] = gauge.reshape(3, 4)
        return RigidTransform(X_WB.GetAsMatrix4() @ X_BO)
