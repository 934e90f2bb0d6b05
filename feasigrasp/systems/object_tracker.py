"""What a motion-capture system would tell: the object's pose, late and noisy, and its twist."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models import se3

FloatArray = NDArray[np.float64]

_ROW = 13  # time, then the upper three rows of a pose


@dataclass
class TrackerConfig:
    """A motion-capture system; the default is a perfect one.

    Attributes:
        period: Time between measurements [s].
        latency: Age of a measurement when it arrives [s], rounded to periods.
        position_noise: Standard deviation [m].
        rotation_noise: Standard deviation [rad].
        dropout: Probability that a measurement is lost.
        twist_window: Time over which the twist is estimated [s].
        seed: Seed of noise and losses.
    """

    period: float = 0.005
    latency: float = 0.0
    position_noise: float = 0.0
    rotation_noise: float = 0.0
    dropout: float = 0.0
    twist_window: float = 0.02
    seed: int = 0


class ObjectTracker(LeafSystem):
    """Measures a pose at a fixed rate, estimates the twist, and extrapolates to the present.

    .. pydrake_system::

        name: ObjectTracker
        input_ports:
        - pose
        output_ports:
        - object_pose
        - object_velocity

    ``pose`` and ``object_pose`` are ``RigidTransform`` X_WO; ``object_velocity`` is a
    ``SpatialVelocity`` V_WO, estimated over ``twist_window`` from what has arrived.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        """A tracker as ``config`` describes it."""
        super().__init__()
        self._config = config = config or TrackerConfig()
        window = max(1, round(config.twist_window / config.period))
        self._rows = 2 + window + round(config.latency / config.period)
        self._pose = self.DeclareAbstractInputPort("pose", Value[RigidTransform]())
        # A discrete state (an abstract one would make every measurement an unrestricted update,
        # which invalidates the caches of the whole diagram): the tick, then the measurements as
        # they were taken, newest first, one row of time and pose each; NaN where there is none.
        self._state = self.DeclareDiscreteState(
            np.concatenate([[0.0], np.full(self._rows * _ROW, np.nan)])
        )
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, self._measure)
        prerequisites = {
            self.discrete_state_ticket(self._state),
            self.time_ticket(),
            self._pose.ticket(),
        }
        self.DeclareAbstractOutputPort(
            "object_pose", Value[RigidTransform], self._calc_pose, prerequisites
        )
        self.DeclareAbstractOutputPort(
            "object_velocity", Value[SpatialVelocity], self._calc_velocity, prerequisites
        )

    def _measure(self, context: Context, discrete_state) -> None:  # type: ignore[no-untyped-def]
        config = self._config
        state = context.get_discrete_state_vector().value()
        tick, rows = state[0], state[1:]
        rng = np.random.default_rng([config.seed, int(tick)])
        if rng.random() >= config.dropout:
            X_WO = self._pose.Eval(context).GetAsMatrix4()
            noise = rng.standard_normal(6)
            X_WO[:3, :3] = se3.so3_exp(config.rotation_noise * noise[:3]) @ X_WO[:3, :3]
            X_WO[:3, 3] += config.position_noise * noise[3:]
            row = np.concatenate([[context.get_time()], X_WO[:3].ravel()])
            rows = np.concatenate([row, rows[:-_ROW]])
        discrete_state.get_mutable_vector().SetFromVector(np.concatenate([[tick + 1.0], rows]))

    def _estimate(self, context: Context) -> tuple[FloatArray, FloatArray]:
        """Pose and twist now, from the measurements that have arrived."""
        rows = context.get_discrete_state_vector().value()[1:].reshape(-1, _ROW)
        now = context.get_time()
        arrived = rows[rows[:, 0] <= now - self._config.latency + 1e-9]
        if len(arrived) == 0:
            return self._pose.Eval(context).GetAsMatrix4(), np.zeros(6)
        last = _as_pose(arrived[0])
        recent = arrived[arrived[:, 0] >= arrived[0, 0] - self._config.twist_window - 1e-9]
        first = recent[-1] if len(recent) > 1 else arrived[min(1, len(arrived) - 1)]
        elapsed = arrived[0, 0] - first[0]
        if elapsed < 1e-9:
            return last, np.zeros(6)
        R_change = last[:3, :3] @ _as_pose(first)[:3, :3].T
        V_WO = np.concatenate([se3.so3_log_kernel(R_change), last[:3, 3] - first[[4, 8, 12]]])
        V_WO /= elapsed
        return se3.extrapolate(last, V_WO, now - arrived[0, 0]), V_WO

    def _calc_pose(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        output.set_value(RigidTransform(self._estimate(context)[0]))

    def _calc_velocity(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        output.set_value(SpatialVelocity(self._estimate(context)[1]))


def _as_pose(row: FloatArray) -> FloatArray:
    X = np.eye(4)
    X[:3] = row[1:].reshape(3, 4)
    return X
