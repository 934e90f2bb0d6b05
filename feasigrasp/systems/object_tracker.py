"""What a motion-capture system would tell about the object: its pose, late and noisy, and a twist."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models import se3

FloatArray = NDArray[np.float64]


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


@dataclass(frozen=True, eq=False)
class _Track:
    """Measurements (time, pose), oldest first, as they were taken; arrived or not."""

    samples: tuple[tuple[float, FloatArray], ...]
    tick: int

    def __deepcopy__(self, memo: dict[int, Any]) -> "_Track":
        return self


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
        self._late = round(config.latency / config.period)
        self._length = 2 + self._late + max(1, round(config.twist_window / config.period))
        self._pose = self.DeclareAbstractInputPort("pose", Value[RigidTransform]())
        self._track = self.DeclareAbstractState(AbstractValue.Make(_Track((), 0)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(config.period, 0.0, self._measure)
        prerequisites = {
            self.abstract_state_ticket(self._track),
            self.time_ticket(),
            self._pose.ticket(),
        }
        self.DeclareAbstractOutputPort(
            "object_pose", Value[RigidTransform], self._calc_pose, prerequisites
        )
        self.DeclareAbstractOutputPort(
            "object_velocity", Value[SpatialVelocity], self._calc_velocity, prerequisites
        )

    def _measure(self, context: Context, state) -> None:  # type: ignore[no-untyped-def]
        config = self._config
        track: _Track = context.get_abstract_state(int(self._track)).get_value()
        rng = np.random.default_rng([config.seed, track.tick])
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        lost = rng.random() < config.dropout
        noise = rng.standard_normal(6)
        if config.rotation_noise > 0.0:
            X_WO[:3, :3] = se3.so3_exp(config.rotation_noise * noise[:3]) @ X_WO[:3, :3]
        X_WO[:3, 3] += config.position_noise * noise[3:]
        samples = track.samples if lost else (*track.samples, (context.get_time(), X_WO))
        updated = _Track(samples[-self._length :], track.tick + 1)
        state.get_mutable_abstract_state(int(self._track)).set_value(updated)

    def _estimate(self, context: Context) -> tuple[FloatArray, FloatArray]:
        """Pose and twist now, from the measurements that have arrived."""
        config = self._config
        track: _Track = context.get_abstract_state(int(self._track)).get_value()
        now = context.get_time()
        arrived = [s for s in track.samples if s[0] <= now - config.latency + 1e-9]
        if not arrived:
            return self._pose.Eval(context).GetAsMatrix4(), np.zeros(6)
        t_last, X_last = arrived[-1]
        recent = [s for s in arrived if s[0] >= t_last - config.twist_window - 1e-9]
        t_first, X_first = recent[0] if len(recent) > 1 else arrived[max(0, len(arrived) - 2)]
        if t_last - t_first < 1e-9:
            return X_last, np.zeros(6)
        omega = se3.so3_log(X_last[:3, :3] @ X_first[:3, :3].T) / (t_last - t_first)
        velocity = (X_last[:3, 3] - X_first[:3, 3]) / (t_last - t_first)
        V_WO = np.concatenate([omega, velocity])
        return se3.extrapolate(X_last, V_WO, now - t_last), V_WO

    def _calc_pose(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        X_WO, _ = self._estimate(context)
        output.set_value(RigidTransform(RotationMatrix.ProjectToRotationMatrix(X_WO[:3, :3]), X_WO[:3, 3]))

    def _calc_velocity(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        output.set_value(SpatialVelocity(self._estimate(context)[1]))
