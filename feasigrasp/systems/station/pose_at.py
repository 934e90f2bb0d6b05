"""Delayed poses of object and arm, at the time of an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.systems.ports import declare_input, declare_output, weakly

#: How far back a pose is remembered [s]. Source: guessed.
REMEMBERED = 0.5
#: Time, then the upper three rows of a pose. Source: layout.
_ROW = 13


class PoseAt(LeafSystem):
    """Buffers poses, and returns the one at a recent time.

    .. pydrake_system::

        name: PoseAt
        input_ports: [pose, stamp]
        output_ports: [pose]

    Both poses are ``RigidTransform``; ``stamp`` is V1 [s]. Between the instants at which the pose
    was remembered it is a screw; before the first of them, and for a stamp that is NaN, it is the
    oldest that is known; after the last one, the present one.
    """

    def __init__(self, period: float) -> None:
        """Remembers the pose every ``period`` seconds."""
        super().__init__()
        self._pose = declare_input(self, "pose", RigidTransform())
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        rows = np.full((round(REMEMBERED / period), _ROW), np.nan)
        state = self.DeclareDiscreteState(rows.ravel())
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._remember))
        sources = {self.discrete_state_ticket(state), self._stamp.ticket(), self._pose.ticket()}
        declare_output(self, "pose", self._calc, sources, model=RigidTransform())

    def _remember(self, context: Context, state) -> EventStatus:
        rows = context.get_discrete_state_vector().value()
        X = self._pose.Eval(context).GetAsMatrix4()
        row = np.concatenate([[context.get_time()], X[:3].ravel()])
        state.get_mutable_vector().SetFromVector(np.concatenate([row, rows[:-_ROW]]))
        return EventStatus.Succeeded()

    def _calc(self, context: Context) -> RigidTransform:
        rows = context.get_discrete_state_vector().value().reshape(-1, _ROW)
        known = rows[np.isfinite(rows).all(axis=1)]
        stamp = self._stamp.Eval(context)[0]
        if len(known) == 0 or stamp > known[0, 0]:
            return RigidTransform(self._pose.Eval(context))
        return RigidTransform(_interpolated(known, stamp))


class PositionAt(LeafSystem):
    """As `PoseAt`, of joint positions.

    .. pydrake_system::

        name: PositionAt
        input_ports: [position, measured_at, stamp]
        output_ports: [position]

    Positions are V``n`` [rad]; ``measured_at``, when the present ones were measured, and ``stamp``
    are V1 [s]. Between two measurements positions change evenly, however far they are apart.
    """

    def __init__(self, period: float, n: int) -> None:
        """Remembers ``n`` positions every ``period`` seconds."""
        super().__init__()
        self._size = 1 + n
        self._position = self.DeclareVectorInputPort("position", n)
        self._measured_at = self.DeclareVectorInputPort("measured_at", 1)
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        rows = np.full((round(REMEMBERED / period), self._size), np.nan)
        state = self.DeclareDiscreteState(rows.ravel())
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._remember))
        sources = {self.discrete_state_ticket(state), self._stamp.ticket(), self._position.ticket()}
        declare_output(self, "position", self._calc, sources, size=n)

    def _remember(self, context: Context, state) -> EventStatus:
        rows = context.get_discrete_state_vector().value()
        row = np.concatenate([self._measured_at.Eval(context), self._position.Eval(context)])
        if row[0] <= rows[0]:
            return EventStatus.DidNothing()
        state.get_mutable_vector().SetFromVector(np.concatenate([row, rows[: -self._size]]))
        return EventStatus.Succeeded()

    def _calc(self, context: Context) -> ArrayLike:
        rows = context.get_discrete_state_vector().value().reshape(-1, self._size)
        known = rows[np.isfinite(rows).all(axis=1)][::-1]
        position, stamp = self._position.Eval(context), self._stamp.Eval(context)[0]
        if len(known) == 0 or stamp > known[-1, 0]:
            return position
        at = known[0, 0] if np.isnan(stamp) else stamp
        return [np.interp(at, known[:, 0], values) for values in known[:, 1:].T]


def _interpolated(rows: Array, stamp: float) -> Array:
    """The pose (4, 4) at a time; the rows are newest first."""
    older = int(np.searchsorted(-rows[:, 0], -stamp))
    if older == 0 or older == len(rows) or not np.isfinite(stamp):
        return _matrix(rows[0 if older == 0 else -1])
    X_a, X_b = _matrix(rows[older]), _matrix(rows[older - 1])
    share = (stamp - rows[older, 0]) / (rows[older - 1, 0] - rows[older, 0])
    return se3.interpolate(X_a, X_b, share)


def _matrix(row: Array) -> Array:
    X = np.eye(4)
    X[:3] = row[1:].reshape(3, 4)
    return X
