"""The process that commands the arm: it outlives the controller, and brakes when that is silent."""

from __future__ import annotations

import math
import signal
import struct
import time

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.priority import DRIVER, real_time

#: A guard ends when nothing has been requested for so long, and its arm rests [s].
QUIET = 30.0


class Guard:
    """Listens to the arm's driver and to a controller, and commands the arm."""

    def __init__(
        self, lcm: DrakeLcm, period: float = channels.IIWA_PERIOD, quiet: float = QUIET
    ) -> None:
        """A guard on a bus.

        Args:
            lcm: The bus that driver and controller are on.
            period: Of the driver [s].
            quiet: It ends when nothing has been requested for so long, and its arm rests [s].
        """
        self._lcm, self._quiet = lcm, quiet
        self._guard = CommandGuard(period)
        self._utime, self._dismissed = -1, False
        self._commands, self._rival = 0, False
        self._heard_at = self._answered_at = time.monotonic()
        self._subscriptions = [
            lcm.Subscribe(channels.IIWA_REQUEST, self._request),
            lcm.Subscribe(channels.IIWA_STATUS, self._answer),
            lcm.Subscribe(channels.IIWA_COMMAND, self._hear),
        ]

    def serve(self) -> None:
        """Works until it is told to end, or nothing has been requested for long.

        It never leaves an arm that moves, unless there is no driver to tell any more.

        Raises:
            HardwareError: Somebody commands the arm already.
        """
        while not self._wanted_to_end() or self._in_charge():
            self._lcm.HandleSubscriptions(100)
            if self._rival:
                raise HardwareError(
                    f"messages on {channels.IIWA_COMMAND}: somebody commands this arm already; "
                    "with a 'feasigrasp guard' that serves, give --no-guard to the controller"
                )

    def end(self, *_: object) -> None:
        """Ends the service: the arm brakes, whatever is requested, and then it is over."""
        self._dismissed = True

    def _wanted_to_end(self) -> bool:
        return self._dismissed or time.monotonic() - self._heard_at >= self._quiet

    def _in_charge(self) -> bool:
        """Whether the arm moves, and its driver listens."""
        return self._guard.moving and time.monotonic() - self._answered_at < 1.0

    def _hear(self, _: bytes) -> None:
        # What it says itself it hears, too, but not before.
        self._rival |= self._commands == 0

    def _request(self, data: bytes) -> None:
        if self._dismissed:
            return
        try:
            request = lcmt_iiwa_command.decode(data)
        except (ValueError, struct.error):  # of another program, or cut off
            return
        if self._guard.request(1e-6 * request.utime, np.array(request.joint_position)):
            self._heard_at = time.monotonic()

    def _answer(self, data: bytes) -> None:
        try:
            status = lcmt_iiwa_status.decode(data)
        except (ValueError, struct.error):
            return
        measured = np.array(status.joint_position_measured)
        usable = len(measured) == IIWA_7.joints and np.isfinite(measured).all()
        late = 0 <= self._utime - status.utime < 1e6 * CommandGuard.SILENCE
        if not usable or status.utime < 0 or late:
            return
        self._utime = status.utime
        q = self._guard.command(1e-6 * status.utime, measured)
        if q is None:
            return
        command = lcmt_iiwa_command()
        command.utime, command.num_joints = status.utime, IIWA_7.joints
        command.joint_position = q.tolist()
        self._commands += 1
        self._lcm.Publish(channels.IIWA_COMMAND, command.encode())
        self._answered_at = time.monotonic()


def main(url: str, *, alone: bool = False) -> None:
    """A guard as a process of its own, which SIGTERM ends as soon as its arm rests.

    Args:
        url: Where driver and controller are.
        alone: Whether no controller has started it: then it says that it serves, one after the
            other, and Ctrl-C is meant for it.

    Raises:
        HardwareError: Somebody commands the arm already.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _rehearse()
    guard = Guard(channels.open_lcm(url), quiet=math.inf if alone else QUIET)
    signal.signal(signal.SIGTERM, guard.end)
    if alone:
        signal.signal(signal.SIGINT, guard.end)
    with real_time(DRIVER):
        if alone:
            print(f"guarding the arm on {url}; Ctrl-C ends it at rest", flush=True)
        guard.serve()


def _rehearse() -> None:
    """Lets all be compiled that a guard calls."""
    guard = CommandGuard(channels.IIWA_PERIOD)
    for time_ in np.arange(0.0, 2.0 * CommandGuard.START_AFTER, channels.IIWA_PERIOD):
        guard.command(time_, np.zeros(IIWA_7.joints))
