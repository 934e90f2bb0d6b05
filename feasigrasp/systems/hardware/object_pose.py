"""Publishes motion-capture measurements as messages."""

from __future__ import annotations

import numpy as np
from drake import lcmt_robot_state
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.tracker_config import TrackerConfig, measured_pose
from feasigrasp.systems.hardware.channels import POSE_NAMES
from feasigrasp.systems.ports import declare_input, declare_output, weakly

#: Time, then the pose as it is sent. Source: layout.
_ROW = 8


class ObjectPoseSender(LeafSystem):
    """Publishes object poses of a simulated motion-capture system, with noise, delay and loss.

    .. pydrake_system::

        name: ObjectPoseSender
        input_ports: [pose]
        output_ports: [message]

    ``pose`` is the true ``RigidTransform`` X_WO; ``message`` an ``lcmt_robot_state`` of a
    measurement, with the time at which it was made. It stays the same where one is lost.
    """

    def __init__(self, config: TrackerConfig) -> None:
        """A system as ``config`` describes it."""
        super().__init__()
        self._config = config
        self._pose = declare_input(self, "pose", RigidTransform())
        rows = np.full((round(config.latency / config.period) + 1) * _ROW, np.nan)
        state = self.DeclareDiscreteState(rows)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, 0.0, weakly(self._measure))
        declare_output(
            self,
            "message",
            self._calc,
            {self.discrete_state_ticket(state)},
            model=lcmt_robot_state(),
        )

    def _measure(self, context: Context, state) -> EventStatus:
        rows, time = context.get_discrete_state_vector().value(), context.get_time()
        X_WO = measured_pose(self._pose.Eval(context).GetAsMatrix4(), time, self._config)
        row = rows[:_ROW]  # one that is lost: the same once more
        if X_WO is not None:
            row = np.concatenate([[time], se3.quaternions(X_WO), X_WO[:3, 3]])
        state.get_mutable_vector().SetFromVector(np.concatenate([row, rows[:-_ROW]]))
        return EventStatus.Succeeded()

    def _calc(self, context: Context) -> lcmt_robot_state:
        time, *values = context.get_discrete_state_vector().value()[-_ROW:]
        return pose_message(time, np.array(values))


class ObjectPoseReceiver(LeafSystem):
    """The pose that a motion-capture system measured, and when.

    .. pydrake_system::

        name: ObjectPoseReceiver
        input_ports: [message]
        output_ports: [pose, stamp]

    ``message`` is an ``lcmt_robot_state`` with the positions `POSE_NAMES` in that order, ``pose``
    the ``RigidTransform`` X_WO, NaN where the message has none, ``stamp`` its time stamp, V1 [s].
    """

    def __init__(self) -> None:
        """A receiver of one object's pose."""
        super().__init__()
        self._message = self.DeclareAbstractInputPort("message", Value(lcmt_robot_state()))
        ticket = {self._message.ticket()}
        declare_output(self, "pose", self._calc_pose, ticket, model=RigidTransform())
        declare_output(self, "stamp", self._calc_stamp, ticket, size=1)

    def _calc_pose(self, context: Context) -> RigidTransform:
        message = self._message.Eval(context)
        X = np.full((4, 4), np.nan)
        if list(message.joint_name) == POSE_NAMES:
            values = np.array(message.joint_position, dtype=float)
            size = np.linalg.norm(values[:4])
            if np.isfinite(values).all() and size > 0.5:
                X = se3.make_pose(se3.rotations(values[:4] / size), values[4:])
        return RigidTransform(X)

    def _calc_stamp(self, context: Context) -> float:
        message = self._message.Eval(context)
        return 1e-6 * message.utime if message.num_joints else np.nan


def pose_message(time: float, values: Array) -> lcmt_robot_state:
    """The message of a pose that was measured at a time [s]; ``values`` as in `POSE_NAMES`.

    Without a measurement yet (NaN) its time stamp is -1, which no receiver uses.
    """
    message = lcmt_robot_state()
    message.utime = -1 if np.isnan(time) else round(1e6 * time)
    message.num_joints, message.joint_name = len(POSE_NAMES), POSE_NAMES
    message.joint_position = values.tolist()
    return message
