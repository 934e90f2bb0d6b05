"""Another prediction of the object's motion, behind any tracker."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.systems.ports import declare_input, declare_output, optional

#: Poses (k, 4, 4) of the object at times (k,) [s] from now, from its pose (4, 4), its twist (6,)
#: [angular; linear] and the tracker's own `Motion`, or None.
PredictFn = Callable[[Array, Array, Array, Motion | None], Array]


@dataclass(frozen=True, eq=False)
class CustomMotion(Frozen):
    """A `Motion` that a function predicts.

    Attributes:
        function: The function.
        X_WO: Pose of the object now, shape (4, 4) [m].
        V_WO: Its twist, shape (6,).
        estimate: What the tracker predicts; None if it does not.
    """

    function: PredictFn
    X_WO: Array
    V_WO: Array
    estimate: Motion | None

    @property
    def known(self) -> bool:
        """Whether the object's pose and twist are."""
        return bool(np.isfinite(self.X_WO).all() and np.isfinite(self.V_WO).all())

    def predict(self, ahead: ArrayLike, v_WO: ArrayLike | None = None) -> Array:
        """Poses (k, 4, 4) of the object at times (k,) [s] from now, see `Motion`.

        Raises:
            ScenarioError: The function returns another shape.
        """
        times, V_WO = np.asarray(ahead, dtype=float).reshape(-1), self.V_WO
        if v_WO is not None:
            V_WO = np.concatenate([V_WO[:3], np.asarray(v_WO, dtype=float)])
        poses = np.asarray(self.function(times, self.X_WO, V_WO, self.estimate), dtype=float)
        if poses.shape != (len(times), 4, 4):
            raise ScenarioError(
                f"the predictor returns an array of shape {poses.shape}; return one pose for each "
                f"of the {len(times)} times, shape ({len(times)}, 4, 4)"
            )
        return poses


class MotionPredictor(LeafSystem):
    """Predicts the object's motion by a function, in place of the tracker.

    .. pydrake_system::

        name: MotionPredictor
        input_ports: [object_pose, object_velocity, object_motion]
        output_ports: [object_motion]

    Inputs are outputs of a tracker; its ``object_motion`` is optional. The output is a
    `CustomMotion`.
    """

    @checked(ScenarioError)
    def __init__(self, function: PredictFn) -> None:
        """A predictor of a function ``predict(ahead, X_WO, V_WO, estimate)``, see `PredictFn`.

        Raises:
            ScenarioError: It cannot be called.
        """
        super().__init__()
        self._function = function
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._twist = declare_input(self, "object_velocity", SpatialVelocity.Zero())
        self._motion = declare_input(self, "object_motion", kind=Motion | None)
        declare_output(self, "object_motion", self._calc, {self._pose, self._twist, self._motion})

    def _calc(self, context: Context) -> CustomMotion:
        return CustomMotion(
            self._function,
            self._pose.Eval(context).GetAsMatrix4(),
            np.array(self._twist.Eval(context).get_coeffs()),
            optional(self._motion, context),
        )
