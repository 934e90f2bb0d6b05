"""Where a camera is believed to be."""

from __future__ import annotations

from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.systems.ports import declare_input, declare_output


class BelievedPose(LeafSystem):
    """Turns the true pose of a camera into what its calibration says.

    .. pydrake_system::

        name: BelievedPose
        input_ports:
        - true_pose
        output_ports:
        - pose

    Both are ``RigidTransform``, X_WC and X_WB.
    """

    def __init__(self, X_CB: Array) -> None:
        """A camera that is believed to be at ``X_CB`` (4, 4) in its own true frame."""
        super().__init__()
        self._X_CB = RigidTransform(X_CB)
        self._pose = declare_input(self, "true_pose", RigidTransform())
        declare_output(self, "pose", self._calc, model=RigidTransform())

    def _calc(self, context: Context) -> RigidTransform:
        return self._pose.Eval(context) @ self._X_CB
