"""Command guard process: outlives the controller, and brakes on its timeout."""

from __future__ import annotations

import multiprocessing
import signal
import struct
import time
from collections.abc import Callable

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.priority import DRIVER, real_time

#: For so long a guard listens whether there is another one [s]. Source: guessed.
LISTENS = 0.1
_RIVAL = (
    f"messages on {channels.IIWA_COMMAND}: somebody commands this arm already; with a 'feasigrasp "
    "guard' that serves, give --no-guard to the controller"
)


class Guard:
    """Listens to the arm's driver and to a controller, and commands the arm."""

    def __init__(self, lcm: DrakeLcm, speed: float = 1.0) -> None:
        """A guard on the bus that driver and controller are on.

        Args:
            lcm: The bus.
            speed: Share of the arm's velocity limits that may be used, in (0, 1].
        """
        self._lcm = lcm
        self._guard = CommandGuard(channels.IIWA_PERIOD, speed)
        self._utime, self._dismissed = -1, False
        self._reported, self._received, self._rival = 0, 0, False
        self._answered_at = time.monotonic()
        self._subscriptions = [
            lcm.Subscribe(channels.IIWA_REQUEST, self._request),
            lcm.Subscribe(channels.IIWA_STATUS, self._answer),
            lcm.Subscribe(channels.IIWA_COMMAND, self._receive),
        ]

    def serve(self) -> None:
        """Works until it is terminated, or its controller has ended.

        It never leaves an arm that moves, unless there is no driver any more.

        Raises:
            HardwareError: Somebody commands the arm already.
        """
        while not self._wanted_to_end() or self._in_charge():
            self._lcm.HandleSubscriptions(100)
            if self._rival:
                raise HardwareError(_RIVAL)

    def end(self, *_: object) -> None:
        """Ends the service: the arm brakes, whatever is requested, and then it is over."""
        self._dismissed = True

    def _wanted_to_end(self) -> bool:
        owner = multiprocessing.parent_process()
        return self._dismissed or (owner is not None and not owner.is_alive())

    def _in_charge(self) -> bool:
        """Whether the arm moves, and its driver listens."""
        return self._guard.moving and time.monotonic() - self._answered_at < 1.0

    def _receive(self, _: bytes) -> None:
        # It receives its own messages, too: more than that is another sender's. Only at rest: who
        # commands an arm that moves does not leave it.
        self._received += 1
        self._rival |= self._received > self._reported and not self._guard.moving

    def _request(self, data: bytes) -> None:
        if self._dismissed:
            return
        try:
            request = lcmt_iiwa_command.decode(data)
        except (ValueError, struct.error):  # of another program, or cut off
            return
        self._guard.request(1e-6 * request.utime, np.array(request.joint_position))

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
        self._reported += 1
        self._lcm.Publish(channels.IIWA_COMMAND, command.encode())
        self._answered_at = time.monotonic()


def refuse_if_commanded(lcm: DrakeLcm) -> None:
    """Listens for other commands to the arm, and raises an error if there are any.

    Raises:
        HardwareError: Somebody does.
    """
    received: list[bytes] = []
    subscription = lcm.Subscribe(channels.IIWA_COMMAND, received.append)
    deadline = time.monotonic() + LISTENS
    while time.monotonic() < deadline and not received:
        lcm.HandleSubscriptions(10)
    del subscription
    if received:
        raise HardwareError(_RIVAL)


def main(url: str, begun: Callable[[], None], *, speed: float = 1.0, alone: bool = False) -> None:
    """Process of a guard; SIGTERM ends it as soon as its arm rests.

    Args:
        url: Where driver and controller are.
        begun: Called when it serves.
        speed: Share of the arm's velocity limits that may be used, in (0, 1].
        alone: Whether no controller has started it: then it serves one after the other, and Ctrl-C
            is meant for it.

    Raises:
        HardwareError: Somebody commands the arm already.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _warm_up()
    lcm = channels.open_lcm(url)
    refuse_if_commanded(lcm)
    guard = Guard(lcm, speed)
    signal.signal(signal.SIGTERM, guard.end)
    if alone:
        signal.signal(signal.SIGINT, guard.end)
    with real_time(DRIVER):
        begun()
        guard.serve()


def _warm_up() -> None:
    """Lets all be compiled that a guard calls."""
    guard = CommandGuard(channels.IIWA_PERIOD)
    for time_ in np.arange(0.0, 2.0 * CommandGuard.START_AFTER, channels.IIWA_PERIOD):
        guard.command(time_, np.zeros(IIWA_7.joints))
