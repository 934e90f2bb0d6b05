"""What a simulated cell hears of a controller and its guard, as the messages say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from drake import lcmt_iiwa_command
from pydrake.lcm import DrakeLcm

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware import channels


class HeardCommands:
    """Every command for the arm, and when something was asked of the guard.

    Attributes:
        requests: When each request came [s].
        moved: When the last command came that differed from the one before [s]; 0 before.
        unusable: How many commands were none: not seven finite positions.
        late: How many came when the period that they were for was over.
    """

    def __init__(self, lcm: DrakeLcm, now: Callable[[], float]) -> None:
        """Listens on a bus.

        Args:
            lcm: The bus.
            now: Tells the simulated time [s].
        """
        self.requests: list[float] = []
        self.unusable = self.late = 0
        self.moved = 0.0
        self._now = now
        self._utime: list[int] = []
        self._q: list[Array] = []
        self._subscriptions = [
            lcm.Subscribe(channels.IIWA_COMMAND, self._command),
            lcm.Subscribe(channels.IIWA_REQUEST, lambda data: self.requests.append(now())),
        ]

    def _command(self, data: bytes) -> None:
        command = lcmt_iiwa_command.decode(data)
        q = np.array(command.joint_position)
        if q.shape != (IIWA_7.joints,) or not np.isfinite(q).all():
            self.unusable += 1
            return
        if self._q and np.any(q != self._q[-1]):
            self.moved = self._now()
        self.late += self._now() >= 1e-6 * command.utime + channels.IIWA_PERIOD - 1e-6
        self._utime.append(command.utime)
        self._q.append(q)

    @property
    def first(self) -> float | None:
        """When something was asked of the guard first [s]; None before.

        A guard that serves holds the arm where it is until then.
        """
        return self.requests[0] if self.requests else None

    def positions(self, q_start: Array) -> Array:
        """Where the arm was, then the positions sent, in their order, shape (m + 1, 7) [rad].

        Args:
            q_start: Where the arm was before the first command [rad], shape (7,).
        """
        return np.array([q_start, *self._q])

    def velocities(self, q_start: Array) -> Array:
        """From each of `positions` to the next [rad/s], shape (m, 7).

        NaN where commands were missing in between, sent or not: of what is not heard nothing can be
        said but how often it was so.
        """
        ticks = np.round(np.array(self._utime) / (1e6 * channels.IIWA_PERIOD))
        next_to = np.diff(ticks, prepend=ticks[:1] - 1.0) == 1.0
        velocities = np.diff(self.positions(q_start), axis=0) / channels.IIWA_PERIOD
        return np.where(next_to[:, None], velocities, np.nan)

    @property
    def missing(self) -> int:
        """How many periods of the driver went without a command, from the first to the last."""
        if not self._utime:
            return 0
        lasted = 1e-6 * (self._utime[-1] - self._utime[0]) / channels.IIWA_PERIOD
        return max(0, round(lasted) + 1 - len(set(self._utime)))

    def gaps(self) -> Array:
        """Times between requests [s], shape (n - 1,)."""
        return np.diff(self.requests)
