"""Command guard: rate-limited forwarding of position commands, and braking on timeout.

A driver in position mode keeps the last command for ever. If the controller dies while the arm
moves, that command stops it dead, harder than any limit allows. The guard follows what the
controller asks for within all limits (`drive_step_kernel`), and when nothing has been asked for
``DEADLINE`` seconds it brakes as hard as the acceleration limits allow: what the driver is left
with is then a position at rest. It also keeps the clearances of a `SafetyFilter` of its own.
"""

from collections import deque
from dataclasses import replace

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.driver_clock import JITTER, SHORTEST, DriverClock, Tick
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter
from feasigrasp.models.control.safety.velocity_limits import drive_step_kernel
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.quantities import Positive, PositiveShare
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7


class CommandGuard:
    """Follows requested positions within the limits, and brakes when there are none.

    It takes one step in every cycle of the driver (`DriverClock`), also where its status is missing
    (`coast`). It begins `START_AFTER` seconds after the first status message, at the position that
    the driver holds, and again when they have been missing for `SILENCE`. Where cycles were left
    out, it goes on from rest.

    Attributes:
        clock: The driver's cycles.
        moving: Whether any joint is still commanded to move.
        received: Whether there is a request that is not too old.
        contested: Whether two controllers request positions.
        refused: Why the driver is not served; empty if it is.
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
    #: Controllers' clocks run as the driver's: a request whose stamp is off by more is another's,
    #: and three of those within `DEADLINE` are another controller [s].
    MAX_DRIFT = 0.1
    #: Controllers request once per cycle; the last requests, so many, show it.
    COUNTED = 7

    @checked(ControlError)
    def __init__(
        self,
        period: Positive,
        speed: PositiveShare = 1.0,
        safety: SafetyFilter | None = None,
        obstacles: ObstacleGrid | None = None,
        arm: Arm = IIWA_7,
    ) -> None:
        """A guard that commands in every cycle of a driver.

        Args:
            period: Of the driver, until it is measured [s].
            speed: Share of the velocity limits that may be used, in (0, 1].
            safety: Keeps the arm clear of itself, the table and ``obstacles``; without, none of
                them is kept clear of.
            obstacles: Distances to them, in the frame of the arm's base.
            arm: The arm.

        Raises:
            ControlError: Another period or speed.
        """
        self.clock, self._speed, self._arm = DriverClock(period, self.SILENCE), speed, arm
        self._safety, self._obstacles = safety, obstacles
        self._q, self._v = np.full(self._arm.joints, np.nan), np.zeros(self._arm.joints)
        # By the driver's cycles; stamps of requests are of the clock of whoever sends them.
        self._time, self._since, self._received_at = 0.0, 0.0, -np.inf
        self._requested, self._rate = np.zeros(self._arm.joints), np.zeros(self._arm.joints)
        self._measured, self._coasted = self._q, deque[Array](maxlen=8)
        self._stamp = -np.inf
        self._ahead: float | None = None
        self._recent: dict[float, bytes] = {}
        self._others: deque[float] = deque(maxlen=3)
        self._unanswered = 0
        self._starting = True
        self.moving = self.received = self.contested = False
        self.refused = ""

    @property
    def joints(self) -> int:
        """How many the arm has."""
        return self._arm.joints

    def request(self, stamp: float, q: Array) -> bool:
        """Accepts positions (7,) [rad] with the controller's stamp [s]; returns whether it is used.

        Not used are those that are not finite, not later than the last, or not of the controller
        that is served. That has to be silent for `SILENCE` before another one is served.
        """
        if np.shape(q) != (self._arm.joints,) or not np.isfinite(q).all() or not np.isfinite(stamp):
            return False
        self._unanswered += 1
        if self._unanswered > 2:  # statuses are missing: nothing is commanded, nor does time pass
            return False
        q = np.array(q, dtype=float)
        ahead, step = stamp - self._time, stamp - self._stamp
        if self._time - self._received_at > self.SILENCE:
            self._ahead = None
        if self._ahead is None:  # one that begins, or whose clock was set
            self._ahead, step = ahead, np.inf
            self._recent.clear()
        sent = self._recent.get(stamp, q.tobytes())
        stamps = [*self._recent][1 - self.COUNTED :]
        often = len(stamps) == self.COUNTED - 1 and step > 0.0 and not self._starting
        often = often and stamp - stamps[0] < JITTER * len(stamps) * self.clock.period
        strange = abs(ahead - self._ahead) > self.MAX_DRIFT or 0.0 < abs(step) < 0.5 * SHORTEST
        if strange or often or sent != q.tobytes():
            self._others.append(self._time)
            several = len(self._others) == self._others.maxlen
            self.contested |= often or (several and self._time - self._others[0] <= self.DEADLINE)
            return False
        if step <= 0.0:
            return False
        self._ahead += 0.01 * (ahead - self._ahead)  # clocks drift, by less than this follows
        self._rate = (q - self._requested) / step  # 0 of the first
        self._requested, self._stamp, self._received_at = q, stamp, self._time
        self._recent[stamp] = q.tobytes()
        if len(self._recent) > 64:  # older copies are no newer than the last request anyway
            del self._recent[next(iter(self._recent))]
        return True

    def command(self, time: float, measured: Array, held: Array, now: float) -> Array | None:
        """The positions to send at a status message; None if nothing may be sent.

        Args:
            time: Stamp of the message [s].
            measured: Measured positions [rad], shape (7,).
            held: Positions that the driver holds by its message [rad], shape (7,).
            now: This computer's monotonic clock [s].
        """
        missing = self.clock.missing
        tick = self.clock.tick(time, now)
        self._time += self.clock.passed
        if tick is Tick.BEGIN:
            self._since, self._received_at, self.refused = self._time, -np.inf, ""
            self._starting = True
        if tick in (Tick.STEPPED, Tick.GAP):
            self._ahead = None
        if tick is not Tick.NONE:
            self._unanswered = 0
        if missing and tick is Tick.NEXT and not self._was_received(held):
            tick = Tick.GAP
        if tick in (Tick.BEGIN, Tick.GAP) or self._starting:
            self._rest(measured, held)
        if self._starting and self._time - self._since >= self.START_AFTER - 1e-9:
            self._starting, self.refused = False, self.clock.measure()
            if self._safety is not None and not self.refused:
                options = replace(self._safety.options, period=self.clock.period)
                self._safety = replace(self._safety, options=options)
        if tick is Tick.NONE or self._starting or self.refused:
            return None
        self._coasted.clear()
        self._step(measured)
        return self._q.copy()

    def coast(self, now: float) -> Array | None:
        """The positions to send where a status is missing while the arm moves; None elsewhere.

        They go on as requested, and brake when statuses have been missing for `DEADLINE`. If they
        reach the driver, the arm does not stop dead. ``now`` is as for `command`.
        """
        if self._starting or self.refused or not self.moving or not self.clock.is_missing(now):
            return None
        self._time += self.clock.passed
        self._unanswered = 0
        self._step(self._measured)
        self._coasted.append(self._q)
        return self._q.copy()

    def follow(self, q: Array, last: Array) -> None:
        """Goes on from the position (7,) [rad] that another guard sent, and the one before that."""
        self._q, self._v = q, (q - last) / (self.clock.period * self.clock.rate)
        self.moving = bool(np.any(self._v != 0.0))

    def _was_received(self, held: Array) -> bool:
        """Whether the driver holds one of the positions that were sent while statuses missed."""
        step = 0.5 * self.clock.period * max(np.abs(self._v).max(), 1e-6)
        return any(np.abs(held - q).max() <= step for q in self._coasted)

    def _rest(self, measured: Array, held: Array) -> None:
        """Begins where the driver is: at the position of its message, else at the last command."""
        self._v, self.moving = np.zeros(self._arm.joints), False
        for q, within in ((held, self.MAX_DISTANCE), (self._q, self.MAX_LEAD)):
            if np.abs(q - measured).max() <= within:
                self._q = np.array(q, dtype=float)
                return
        self._q = np.array(measured, dtype=float)

    def _step(self, measured: Array) -> None:
        self._measured = measured
        # Of the time that passes by either clock.
        period, age = self.clock.period * self.clock.rate, self._time - self._received_at
        near = np.abs(self._requested - measured).max() <= self.MAX_DISTANCE
        alone = self.clock.missing * self.clock.period
        recent = max(age, alone) <= self.DEADLINE + 1e-9
        self.received = bool(recent and near and not self.contested)
        wish = np.zeros(self._arm.joints)
        if self.received:
            # What is sent now counts at the end of the period, like the request that is prolonged.
            left = self._requested + (age - period) * self._rate - self._q
            limit = self.SPEED * self._speed * np.array(self._arm.velocity_limits)
            rate, share = np.clip(self._rate, -limit, limit), self.SPEED_GAIN * period
            up = self._v + np.maximum(share * (limit - self._v), -self._v)
            down = self._v - np.maximum(share * (limit + self._v), self._v)
            wish = self._rate + self.GAIN * left
            wish = np.clip(wish, np.minimum(down, rate), np.maximum(up, rate))
        if self._safety is not None:
            wish = self._safety.velocity(self._q, wish, qd_last=self._v, obstacles=self._obstacles)
        q, v = np.empty(self._arm.joints), np.empty(self._arm.joints)
        bounds = period, self.MAX_LEAD, self._speed
        drive_step_kernel(self._arm.chain, self._q, self._v, wish, measured, bounds, q, v)
        self._q, self._v = q, v
        self.moving = bool(np.any(v != 0.0))
