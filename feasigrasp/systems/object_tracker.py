"""Motion-capture tracker: delayed and noisy poses, filtered; and another prediction behind it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.objects.pose_filter import (
    STATE_SIZE,
    Noise,
    empty_state,
    measure_kernel,
    parts,
    pose_kernel,
    twist_kernel,
)
from feasigrasp.models.objects.prediction import Motion, MotionEstimate, predict_kernel
from feasigrasp.models.objects.tracking import TrackerConfig, Tracking, TrackingState, measured_pose
from feasigrasp.systems.ports import (
    declare_cache,
    declare_input,
    declare_output,
    declare_pose_and_velocity,
    optional,
    weakly,
)

#: Time, then the upper three rows of a pose. Source: layout.
_ROW = 13


class ObjectTracker(LeafSystem):
    """Measures a pose at a fixed rate, and estimates pose and twist at present, and the future.

    .. pydrake_system::

        name: ObjectTracker
        input_ports: [pose, stamp]
        output_ports: [object_pose, object_velocity, object_motion, tracking]

    ``pose`` and ``object_pose`` are ``RigidTransform`` X_WO; ``object_velocity`` is a
    ``SpatialVelocity`` V_WO; ``object_motion`` is a `MotionEstimate`, which predicts. All three
    come from a Kalman filter over the measurements that have arrived, whose noise model is how
    noisy they are; ``tracking`` is a `Tracking`, which says what they are worth. Until the first
    measurement has arrived, pose and twist are NaN, by which every system of the pipeline detects
    that they are unknown; the first one is made when the simulation is initialised. When none has
    come for ``silence`` seconds, the pose is held where it was expected by then, and nothing is
    predicted.

    ``stamp`` is V1 and optional: if it is connected, ``pose`` is a measurement already, as noisy
    and as late as it is, and ``stamp`` says when it was made [s]; NaN before the first.
    """

    @checked()
    def __init__(self, config: TrackerConfig | None = None) -> None:
        super().__init__()
        self._config = config = config or TrackerConfig()
        jerks = config.jerk, config.angular_jerk
        self._noise = Noise(config.position_noise, config.rotation_noise, *jerks)
        self._delay = round(config.latency / config.period)
        self._pose = declare_input(self, "pose", RigidTransform())
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        # A discrete state (an abstract one would make every measurement an unrestricted update,
        # which invalidates the caches of the whole diagram): when it measured last, the filter,
        # then the measurements that are on their way, newest first, one row of time and pose each;
        # NaN where there is none.
        rows = np.full((self._delay + 1) * _ROW, np.nan)
        self._state = self.DeclareDiscreteState(np.concatenate([[np.nan], empty_state(), rows]))
        _compile(self._noise)
        # The periodic update at t = 0 comes after other systems' abstract states were updated: they
        # would know of no measurement until their next turn.
        self.DeclareInitializationDiscreteUpdateEvent(weakly(self._measure))
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, weakly(self._measure))
        state, time = self.discrete_state_ticket(self._state), self.time_ticket()
        self._estimated = declare_cache(self, "estimate", self._estimate, {state, time})
        declare_pose_and_velocity(self, self._estimated.Eval, {self._estimated})
        declare_output(self, "object_motion", self._calc_motion, {state, time})
        declare_output(self, "tracking", self.tracking, {state, time})

    def _measure(self, context: Context, discrete_state) -> EventStatus:
        config = self._config
        state = context.get_discrete_state_vector().value().copy()
        time, motion, rows = context.get_time(), state[1 : 1 + STATE_SIZE], state[1 + STATE_SIZE :]
        if time == state[0]:
            return EventStatus.DidNothing()
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        if self._stamp.HasValue(context):
            arrived = np.concatenate([self._stamp.Eval(context), X_WO[:3].ravel()])
        else:
            row, X_WO = np.full(_ROW, np.nan), measured_pose(X_WO, time, config)
            if X_WO is not None:
                row[0], row[1:] = time, X_WO[:3].ravel()
            rows[:] = np.concatenate([row, rows[:-_ROW]])
            arrived = rows[-_ROW:]
        if np.isfinite(arrived[0]):
            measured = np.eye(4)
            measured[:3] = arrived[1:].reshape(3, 4)
            measure_kernel(motion, arrived[0], measured, self._noise)
        state[0] = time
        discrete_state.get_mutable_vector().SetFromVector(state)
        return EventStatus.Succeeded()

    @checked()
    def tracking(self, context: Context) -> Tracking:
        """Quality of the pose at present."""
        s = parts(self._filtered(context))
        due = s.time[0] + (self._delay + 1) * self._config.period
        age = np.inf if np.isnan(due) else max(0.0, context.get_time() - due)
        return Tracking.of_age(age, self._config.silence, not np.isnan(s.far_since[0]))

    def _estimate(self, context: Context) -> tuple[Array, Array]:
        """Pose and twist now, from the measurements that have arrived; NaN before the first."""
        motion, tracking = self._filtered(context), self.tracking(context)
        X_WO, V_WO = np.full((4, 4), np.nan), np.full(6, np.nan)
        if tracking.state is TrackingState.LOST:
            pose_kernel(motion, context.get_time() - tracking.age + self._config.silence, X_WO)
            V_WO[:] = 0.0
        elif tracking.state is not TrackingState.SEARCHING:
            pose_kernel(motion, context.get_time(), X_WO)
            twist_kernel(motion, context.get_time(), V_WO)
        return X_WO, V_WO

    def _calc_motion(self, context: Context) -> MotionEstimate:
        known = not self.tracking(context).lost
        state = self._filtered(context).copy() if known else empty_state()
        return MotionEstimate(state, context.get_time())

    def _filtered(self, context: Context) -> Array:
        """The state of the filter."""
        return context.get_discrete_state_vector().value()[1 : 1 + STATE_SIZE]


def _compile(noise: Noise) -> None:
    """Runs the filter once, so that no kernel is compiled at the first measurement."""
    motion = empty_state()
    for t in (0.0, 0.01):
        measure_kernel(motion, t, np.eye(4), noise)
    X, V = np.empty((4, 4)), np.empty(6)
    pose_kernel(motion, 0.02, X)
    twist_kernel(motion, 0.02, V)
    predict_kernel(motion, 0.02, X, np.zeros(3), np.zeros(1), np.empty((1, 4, 4)))


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
