"""What a motion-capture system would tell: the object's pose, late and noisy, and its twist."""

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem, ValueProducer

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
    ``SpatialVelocity`` V_WO, estimated over ``twist_window`` from what has arrived. Until the first
    measurement has arrived, the true pose is passed on, as if the object stood still.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        """A tracker as ``config`` describes it."""
        super().__init__()
        self._config = config = config or TrackerConfig()
        self._imperfect = max(config.position_noise, config.rotation_noise, config.dropout) > 0.0
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
        self._estimated = self.DeclareCacheEntry(
            "estimate",
            ValueProducer(allocate=lambda: Value[object](None), calc=self._estimate),
            prerequisites_of_calc={
                self.discrete_state_ticket(self._state),
                self.time_ticket(),
                self._pose.ticket(),
            },
        )
        estimated = {self._estimated.ticket()}
        self.DeclareAbstractOutputPort(
            "object_pose", Value[RigidTransform], self._calc_pose, estimated
        )
        self.DeclareAbstractOutputPort(
            "object_velocity", Value[SpatialVelocity], self._calc_velocity, estimated
        )

    def _measure(self, context: Context, discrete_state) -> None:  # type: ignore[no-untyped-def]
        config = self._config
        state = context.get_discrete_state_vector().value()
        tick, rows = state[0], state[1:]
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        lost = False
        if self._imperfect:
            rng = np.random.default_rng([config.seed, int(tick)])
            lost = rng.random() < config.dropout
            noise = rng.standard_normal(6)
            X_WO[:3, :3] = se3.so3_exp(config.rotation_noise * noise[:3]) @ X_WO[:3, :3]
            X_WO[:3, 3] += config.position_noise * noise[3:]
        if not lost:
            row = np.concatenate([[context.get_time()], X_WO[:3].ravel()])
            rows = np.concatenate([row, rows[:-_ROW]])
        discrete_state.get_mutable_vector().SetFromVector(np.concatenate([[tick + 1.0], rows]))

    def _estimate(self, context: Context, value: AbstractValue) -> None:
        """Pose and twist now, from the measurements that have arrived."""
        rows = context.get_discrete_state_vector().value()[1:].reshape(-1, _ROW)
        config, X_WO, V_WO = self._config, np.empty((4, 4)), np.zeros(6)
        if not _estimate_kernel(
            rows, context.get_time(), config.latency, config.twist_window, X_WO, V_WO
        ):
            X_WO = self._pose.Eval(context).GetAsMatrix4()
        value.set_value((X_WO, V_WO))

    def _calc_pose(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        output.set_value(RigidTransform(self._estimated.Eval(context)[0]))

    def _calc_velocity(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        output.set_value(SpatialVelocity(self._estimated.Eval(context)[1]))


@nb.njit(cache=True)
def _estimate_kernel(rows, now, latency, window, X_WO, V_WO):  # type: ignore[no-untyped-def]
    """Writes pose and twist extrapolated to ``now``; False if no measurement has arrived.

    The twist is that between the newest measurement and the oldest one within the window, or, if
    there is none, the next older one.
    """
    newest = 0
    while newest < len(rows) and not rows[newest, 0] <= now - latency + 1e-9:
        newest += 1
    if newest == len(rows):
        return False
    X_last = np.eye(4)
    X_last[:3] = rows[newest, 1:].reshape(3, 4)
    oldest = newest
    while oldest + 1 < len(rows) and (
        rows[oldest + 1, 0] >= rows[newest, 0] - window - 1e-9
        or (oldest == newest and not np.isnan(rows[oldest + 1, 0]))
    ):
        oldest += 1
    elapsed = rows[newest, 0] - rows[oldest, 0]
    X_WO[:] = X_last
    if elapsed < 1e-9:
        return True
    R_first = np.ascontiguousarray(rows[oldest, 1:].reshape(3, 4)[:, :3])
    R_last = np.ascontiguousarray(X_last[:3, :3])
    V_WO[:3] = se3.so3_log_kernel(R_last @ R_first.T) / elapsed
    age = now - rows[newest, 0]
    X_WO[:3, :3] = se3.so3_exp_kernel(V_WO[:3] * age) @ R_last
    for i in range(3):
        V_WO[3 + i] = (X_last[i, 3] - rows[oldest, 4 + 4 * i]) / elapsed
        X_WO[i, 3] += V_WO[3 + i] * age
    return True
