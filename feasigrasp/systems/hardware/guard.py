"""Command guard process: outlives the controller, and brakes on its timeout."""

import multiprocessing
import os
import signal
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.control.safety.driver_clock import SHORTEST
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import make_static_grid
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.channels import decode
from feasigrasp.systems.hardware.priority import Priority, real_time


class GuardedCell(NamedTuple):
    """Clearances of a guard, and the arm's speed, in a form that goes to another process.

    The ``obstacles`` are distances to the bodies of the cell, in the frame of the arm's base.
    """

    options: SafetyOptions
    gripper: Gripper
    obstacles: ObstacleGrid | None

    def make_guard(self) -> CommandGuard:
        """A guard of the arm."""
        safety = SafetyFilter(self.options, self.gripper)
        given = self.options.speed, safety, self.obstacles, self.options.arm
        return CommandGuard(channels.IIWA_PERIOD, *given)


def make_guarded_cell(scenario: Scenario) -> GuardedCell:
    """The cell of a scenario, at half the clearances that its controller keeps.

    Bodies are approached as fast as the arm can still brake. So the guard changes hardly anything
    that a controller in mode ``safe`` asks for.
    """
    cell, default, speed = scenario.cell, SafetyOptions, scenario.control.speed
    arm = load_arm(scenario.arm)
    options = SafetyOptions(
        arm=arm,
        acceleration_scale=arm.acceleration_share,
        position_margin=arm.position_margin,
        speed=speed,
        velocity_scale=CommandGuard.SPEED,
        approach_gain=arm.braking_rate(speed * CommandGuard.SPEED, arm.acceleration_share),
        clearance=0.5 * default.clearance,
        obstacle_clearance=0.5 * default.obstacle_clearance,
        table_clearance=0.5 * cell.table_clearance,
        table_height=cell.table_height,
        speed_gain=1.0 / SHORTEST,  # no bound: the guard has its own
    )
    return GuardedCell(options, load_gripper(scenario.gripper), make_static_grid(scenario))


#: A guard answers a status within this share of a cycle, or leaves the arm to its standby.
#: Source: reasoned: what is left of the cycle is enough for a command that is ready.
ANSWER = 0.6
_RIVAL = (
    f"messages on {channels.IIWA_COMMAND}: somebody commands this arm already; with a 'feasigrasp "
    "guard' that serves, give --no-guard to the controller"
)
_CONTESTED = (
    f"messages on {channels.IIWA_REQUEST} of two controllers: the arm was braked; end one of them, "
    "and start 'feasigrasp guard' again"
)
#: Signals that have their usual effect: those that cannot be caught, do nothing by default, or say
#: that this process itself is broken.
_USUAL = {"KILL", "STOP", "CHLD", "CONT", "URG", "WINCH", "SEGV", "BUS", "FPE", "ILL", "PIPE"}
_Clock = Callable[[], float]


class Guard:
    """Listens to the arm's driver and to a controller, and commands the arm.

    Attributes:
        dropped: How many messages could not be used, by channel.
    """

    def __init__(
        self,
        lcm: DrakeLcm,
        guard: CommandGuard | None = None,
        clock: _Clock | None = None,
        *,
        backed: bool = False,
    ) -> None:
        """A guard on the bus that driver and controller are on.

        Args:
            lcm: The bus.
            guard: Follows requests; the default one keeps limits alone, no clearances.
            clock: Monotonic clock [s]; the arm goes no farther than the time that it shows.
            backed: Whether a `Standby` brakes the arm where this one does not answer in time.
        """
        self._lcm, self._clock = lcm, clock or time.monotonic
        self._guard = guard or CommandGuard(channels.IIWA_PERIOD)
        self.dropped: Counter[str] = Counter()
        self._dismissed, self._rival = False, False
        #: The last commands, and how often each was received; how many came twice in a row.
        self._sent: OrderedDict[bytes, int] = OrderedDict()
        self._doubled = 0
        self._answered_at, self._utime = self._clock(), 0
        #: When it last had nothing to do; whether it has left the arm to the standby since.
        self._backed, self._idle_at, self._gave_way = backed, self._clock(), False
        self._held, self._quiet = np.zeros(0), 0
        self._subscriptions = [
            channels.subscribe(lcm, channels.IIWA_REQUEST, self._request),
            channels.subscribe(lcm, channels.IIWA_STATUS, self._answer),
            channels.subscribe(lcm, channels.IIWA_COMMAND, self._receive),
            channels.subscribe(lcm, channels.IIWA_STANDBY, self._give_way),
        ]

    def serve(self) -> None:
        """Works until it is terminated, or its controller has ended.

        It never leaves an arm that moves, unless there is no driver any more.

        Raises:
            HardwareError: Somebody else commands the arm, or requests positions, or the arm's
                driver is none that can be served.
        """
        while not self._wanted_to_end() or self._in_charge():
            if not self._guard.moving:
                self._lcm.HandleSubscriptions(100)
            elif not self._lcm.HandleSubscriptions(0):
                self.coast()
                time.sleep(0.1 * self._guard.clock.period)
        if error := self._error():
            raise HardwareError(error)

    def coast(self) -> None:
        """Commands the arm where the status of a cycle is missing."""
        self._idle_at = self._clock()
        q = None if self._gave_way else self._guard.coast(self._idle_at)
        if q is not None:
            self._utime += 1
            self._send(q)

    def end(self, *_: object) -> None:
        """Ends the service: the arm brakes, whatever is requested, and then it is over."""
        self._dismissed = True

    def _error(self) -> str:
        if self._rival:
            return _RIVAL
        if self._guard.refused:
            return f"{channels.IIWA_STATUS} {self._guard.refused}"
        return _CONTESTED if self._guard.contested else ""

    def _wanted_to_end(self) -> bool:
        owner = multiprocessing.parent_process()
        orphan = owner is not None and not owner.is_alive()
        return self._dismissed or orphan or bool(self._error())

    def _in_charge(self) -> bool:
        """Whether the arm moves, and its driver listens."""
        return self._guard.moving and self._clock() - self._answered_at < 1.0

    def _gives_way(self) -> bool:
        """Whether it was stopped for so long that the standby has the arm."""
        came_at = np.fmax(self._idle_at, self._guard.clock.due)
        late = self._clock() - came_at > ANSWER * self._guard.clock.shortest
        self._gave_way |= bool(self._backed and self._guard.moving and late)
        return self._gave_way

    def _give_way(self, _: bytes) -> None:
        self._gave_way, self._quiet = self._backed, 0

    def _receive(self, data: bytes) -> None:
        # It receives its own messages, too. What it has not sent is another sender's; so is what
        # comes twice each time, from one that does the same.
        if data not in self._sent:
            self._rival |= not self._gives_way()
            return
        self._sent[data] += 1
        if self._sent[data] == 2:
            self._doubled += 1
            self._rival |= self._doubled >= 10  # in a row

    def _request(self, data: bytes) -> None:
        if self._dismissed or self._rival:
            return
        request = decode(lcmt_iiwa_command, data, self._guard.joints)
        used = request is not None and self._guard.request(
            1e-6 * request.utime, np.array(request.joint_position)
        )
        self.dropped[channels.IIWA_REQUEST] += not used

    def _answer(self, data: bytes) -> None:
        status = decode(lcmt_iiwa_status, data, self._guard.joints)
        if status is None or status.utime < 0:
            self.dropped[channels.IIWA_STATUS] += 1
            return
        measured = np.array(status.joint_position_measured)
        held = np.array(status.joint_position_commanded)
        if self._gives_way():
            # Until the standby has braked: the driver holds one position for three cycles.
            self._quiet = self._quiet + 1 if np.array_equal(held, self._held) else 0
            self._held, self._gave_way = held, self._quiet < 3
            return
        if not self._guard.moving:
            self._idle_at = self._clock()
        q = self._guard.command(1e-6 * status.utime, measured, held, self._clock())
        if q is not None:
            self._utime = status.utime
            self._send(q)
            self._answered_at = self._clock()

    def _send(self, q: Array) -> None:
        command = lcmt_iiwa_command()
        command.utime, command.num_joints = self._utime, len(q)
        command.joint_position = q.tolist()
        encoded = command.encode()
        if self._sent and next(reversed(self._sent.values())) < 2:
            self._doubled = 0
        self._sent[encoded] = 0
        if len(self._sent) > 64:  # so many are remembered
            self._sent.popitem(last=False)
        self._lcm.Publish(channels.IIWA_COMMAND, encoded)


class Standby(Guard):
    """Hot standby of a guard: brakes the arm where a status is not answered in time.

    A driver that holds its last command stops a moving arm dead, if the guard is stopped or killed.
    """

    def __init__(
        self, lcm: DrakeLcm, guard: CommandGuard | None = None, clock: _Clock | None = None
    ) -> None:
        super().__init__(lcm, guard, clock)
        self._in_place, self._due = False, 0.0
        self._ready: Array | None = None
        self._last: Array | None = None

    def coast(self) -> None:
        """Commands the arm where the guard has not."""
        if self._in_place:
            super().coast()
        elif self._guard.moving and self._ready is not None and self._clock() >= self._due:
            # The guard's command may have come since the bus was looked at.
            while self._lcm.HandleSubscriptions(0):
                pass
            if self._ready is not None and self._clock() >= self._due:
                self._in_place = True
                self._send(self._ready)
                self._ready = None

    def _request(self, data: bytes) -> None:
        """It only brakes."""

    def _receive(self, data: bytes) -> None:
        command = decode(lcmt_iiwa_command, data, self._guard.joints)
        if data not in self._sent and command is not None:
            q, self._ready = np.array(command.joint_position), None
            self._guard.follow(q, q if self._last is None else self._last)
            self._last = q

    def _send(self, q: Array) -> None:
        if self._in_place:
            self._lcm.Publish(channels.IIWA_STANDBY, b"")
            super()._send(q)
            self._last, self._in_place = q, self._guard.moving
        else:
            self._ready, self._due = q, self._clock() + ANSWER * self._guard.clock.shortest


def refuse_if_commanded(lcm: DrakeLcm) -> None:
    """Listens for other commands to the arm, and raises an error if there are any.

    Raises:
        HardwareError: Somebody does.
    """
    received: deque[bytes] = deque(maxlen=1)  # the bus never ends a subscription
    lcm.Subscribe(channels.IIWA_COMMAND, received.append)
    deadline = time.monotonic() + 0.1  # many cycles of the driver
    while time.monotonic() < deadline and not received:
        lcm.HandleSubscriptions(10)
    if received:
        raise HardwareError(_RIVAL)


def main(url: str, begun: Callable[[], None], cell: GuardedCell, *, alone: bool = False) -> None:
    """Process of a guard; any signal that ends processes ends it as soon as its arm rests.

    It calls ``begun`` when it serves. If it is ``alone``, no controller has started it: then it
    serves one after the other, and Ctrl-C is meant for it. Else it leaves the terminal, whose
    signals are the controller's.

    Raises:
        HardwareError: Somebody commands the arm already.
    """
    if not alone:
        os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _warm_up(cell.make_guard())
    _start_standby(url, cell, alone)
    lcm = channels.open_lcm(url)
    refuse_if_commanded(lcm)
    guard = Guard(lcm, cell.make_guard(), backed=True)
    end_at_signals(guard.end, alone=alone)
    with real_time(Priority.DRIVER):
        begun()
        guard.serve()


def _start_standby(*given: Any) -> None:
    # A copy of this process: there at once, with all that is compiled.
    multiprocessing.get_context("fork").Process(target=_brake, args=given, daemon=True).start()


def _brake(url: str, cell: GuardedCell, alone: bool) -> None:
    """Process of the standby."""
    standby = Standby(channels.open_lcm(url), cell.make_guard())
    end_at_signals(standby.end, alone=alone)
    # The guard itself reports why it refuses the driver.
    with real_time(Priority.DRIVER), suppress(HardwareError):
        standby.serve()


def end_at_signals(end: Callable[..., None], *, alone: bool) -> None:
    """Lets every signal that would end the process call a function that ends it in order.

    Unless it is ``alone``, Ctrl-C is for the process that has started it.
    """
    for number in signal.valid_signals() - {getattr(signal, f"SIG{n}", 0) for n in _USUAL}:
        signal.signal(number, end)
    for name in ("SIGTTIN", "SIGTTOU") if alone else ("SIGTTIN", "SIGTTOU", "SIGINT"):
        signal.signal(getattr(signal, name), signal.SIG_IGN)


def _warm_up(guard: CommandGuard) -> None:
    """Lets all be compiled that a guard calls."""
    q = np.zeros(guard.joints)
    for time_ in np.arange(0.0, 2.0 * CommandGuard.START_AFTER, channels.IIWA_PERIOD):
        guard.command(time_, q, q, time_)
