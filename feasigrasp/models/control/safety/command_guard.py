"""Command guard: rate-limited forwarding of position commands, and braking on timeout.

A driver in position mode keeps the last command for ever. If the controller dies while the arm
moves, that command stops it dead, harder than any limit allows. The guard follows what the
controller asks for within all limits (`drive_step_kernel`), and when nothing has been asked for
``DEADLINE`` seconds it brakes as hard as the acceleration limits allow: what the driver is left
with is then a position at rest.
"""

from __future__ import annotations

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.velocity_limits import drive_step_kernel
from feasigrasp.models.quantities import Positive, PositiveShare
from feasigrasp.models.robot.iiwa import IIWA_7


class CommandGuard:
    """Follows requested positions within the limits, and brakes when there are none.

    Its clock is that of the arm's status messages. It begins `START_AFTER` seconds after the first
    of them, at the measured position, and again whenever they have been missing.

    Attributes:
        moving: Whether any joint is still commanded to move.
        received: Whether there is a request that is not too old.
    """

    #: The driver stops for good when it is commanded sooner than 0.25 s after its first status [s].
    START_AFTER = 0.3
    #: A request is good for so long [s].
    DEADLINE = 0.02
    #: After a pause of so long between status messages the guard begins anew [s].
    SILENCE = 0.25
    #: How fast what is left to a request is made up for [1/s].
    GAIN = 20.0
    #: Share of the allowed velocities that it uses, and rate at which that is approached where
    #: something has to be made up for, since requests came late [1/s]: an arm overshoots a speed
    #: that is reached in a hurry.
    SPEED, SPEED_GAIN = 0.95, 10.0
    #: A request farther from the measured position is none [rad].
    MAX_DISTANCE = 0.25
    #: The command waits for the arm when it is this much ahead of it [rad].
    MAX_LEAD = 0.10

    @checked(ControlError)
    def __init__(self, period: Positive, speed: PositiveShare = 1.0) -> None:
        """A guard that commands every ``period`` seconds.

        Args:
            period: Between commands [s].
            speed: Share of the velocity limits that may be used, in (0, 1].

        Raises:
            ControlError: Another period or speed.
        """
        self._period, self._speed = period, speed
        self._q, self._v = np.zeros(IIWA_7.joints), np.zeros(IIWA_7.joints)
        self._time = self._since = self._received_at = -np.inf
        self._requested, self._rate = np.zeros(IIWA_7.joints), np.zeros(IIWA_7.joints)
        self._stamp = -np.inf
        self.moving = self.received = False

    def request(self, stamp: float, q: Array) -> bool:
        """Accepts requested positions; returns whether they are valid.

        One that is not finite is none, nor is one that is not later than the last, unless there has
        been none for so long that another controller has begun.

        Args:
            stamp: When, by the controller's clock [s].
            q: Positions [rad], shape (7,).
        """
        if np.shape(q) != (IIWA_7.joints,) or not np.isfinite(q).all():
            return False
        step = stamp - self._stamp
        if step <= 0.0 and self._time - self._received_at <= self.SILENCE:
            return False
        known = 0.0 < step <= self.SILENCE
        self._rate = (q - self._requested) / step if known else np.zeros(IIWA_7.joints)
        self._requested, self._stamp = np.array(q, dtype=float), stamp
        self._received_at = self._time
        return True

    def command(self, time: float, measured: Array) -> Array | None:
        """The positions to send at a time; None while nothing may be sent.

        Args:
            time: Of the status message [s].
            measured: Measured positions [rad], shape (7,).
        """
        if not 0.0 <= time - self._time <= self.SILENCE:
            self._since, self._received_at = time, -np.inf
            self._q, self._v = np.array(measured, dtype=float), np.zeros(IIWA_7.joints)
        self._time = time
        if time - self._since < self.START_AFTER:
            self._q = np.array(measured, dtype=float)
            return None
        # One step, however long ago the last one was: the driver held its position meanwhile.
        self._step(time, measured)
        return self._q.copy()

    def _step(self, time: float, measured: Array) -> None:
        age = time - self._received_at
        near = np.abs(self._requested - measured).max() <= self.MAX_DISTANCE
        self.received = bool(age <= self.DEADLINE + 1e-9 and near)
        wish = np.zeros(IIWA_7.joints)
        if self.received:
            # What is sent now counts at the end of the period, like the request that is prolonged.
            left = self._requested + (age - self._period) * self._rate - self._q
            limit = self.SPEED * self._speed * np.array(IIWA_7.velocity_limits)
            rate, share = np.clip(self._rate, -limit, limit), self.SPEED_GAIN * self._period
            up = self._v + np.maximum(share * (limit - self._v), -self._v)
            down = self._v - np.maximum(share * (limit + self._v), self._v)
            wish = np.clip(
                self._rate + self.GAIN * left, np.minimum(down, rate), np.maximum(up, rate)
            )
        q, v = np.empty(IIWA_7.joints), np.empty(IIWA_7.joints)
        bounds = self._period, self.MAX_LEAD, self._speed
        drive_step_kernel(self._q, self._v, wish, measured, bounds, q, v)
        self._q, self._v = q, v
        self.moving = bool(np.any(v != 0.0))
