"""Advances a diagram with the clock of the arm's status messages."""

import math
import struct
import time
from collections import Counter, deque
from collections.abc import Mapping
from typing import Any

from drake import lcmt_iiwa_status, lcmt_image_array
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from feasigrasp.errors import HardwareError
from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import Connect, make_dynamic_grasp
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.channels import decode
from feasigrasp.systems.hardware.station import HardwareStation
from feasigrasp.systems.remote.remote_stage import remote_stages

#: A time stamp in a message [us].
_STAMP = struct.Struct(">q")
#: How far a stamp may be ahead of the last one and the time since [s], and ahead of the last arm
#: status at all: the pipeline would have to make up for more. Source: reasoned.
AHEAD, FARTHEST = 0.25, 2.5
#: A sender whose messages were out of step for so long, and so many, has set its clock [s, 1].
#: Source: guessed.
SET_AFTER, SET_COUNT = 0.5, 5


class Intake:
    """Keeps the newest message of each channel, and hands them on to a diagram's own bus.

    Of the arm's status it keeps all that it gets, in their order. Of those that come while no one
    listens, pydrake's bus keeps the newest.

    A diagram that listened itself would take whatever comes last: a message that was overtaken, one
    that came twice, or one of another program on the same channel.

    Attributes:
        dropped: How many messages were not used, by channel.
        begun: Whether the run has begun: then the driver's clock must not be set any more.
        clock_set: By how much the clock of the arm's driver was set since [s]; None if it was not.
        zero: The time stamp that is zero of the diagram's clock [us]; what is handed on is stamped
            relative to it.
    """

    def __init__(
        self, lcm: DrakeLcm, kinds: Mapping[str, type], inbox: DrakeLcm, joints: int = 7
    ) -> None:
        """Listens on a bus, and hands on to ``inbox``, a bus inside this process.

        Channels have messages of these ``kinds``; ``joints`` is the number of the arm's.
        """
        self._lcm, self._inbox, self._joints = lcm, inbox, joints
        self.zero = 0
        # A message begins with the fingerprint of its type, 8 bytes; then comes the stamp, but for
        # images, which have a running number of 4 bytes before it.
        self._stamp_at = {k: 12 if kind is lcmt_image_array else 8 for k, kind in kinds.items()}
        self._newest: dict[str, tuple[int, bytes]] = {}
        self._utime: dict[str, int] = {}
        self._pictures: dict[str, list[bytes]] = {}
        #: When the last message of a channel that was used came [s], and how many were not since.
        self._used: dict[str, tuple[float, int]] = {}
        self.begun = False
        self.clock_set: float | None = None
        self._statuses: deque[tuple[int, bytes]] = deque()
        self.dropped: Counter[str] = Counter()
        self._subscriptions = [
            channels.subscribe(lcm, channel, self._take, channel, kind)
            for channel, kind in kinds.items()
        ]

    def receive(self, timeout: float) -> None:
        """Processes arrived messages; waits up to a timeout [s] for the first."""
        self._lcm.HandleSubscriptions(round(1e3 * timeout))

    def oldest(self) -> int | None:
        """Time stamp of the oldest status that waits [us]; None if there is none."""
        return self._statuses[0][0] if self._statuses else None

    def skip(self) -> None:
        """Drops the oldest status."""
        self._statuses.popleft()

    def forward(self) -> None:
        """Gives the diagram the oldest status, and the newest of everything else; once each."""
        utime, data = self._statuses.popleft()
        self._forward(channels.IIWA_STATUS, utime, data)
        for channel, newest in self._newest.items():
            self._forward(channel, *newest)
        self._newest.clear()

    def _forward(self, channel: str, utime: int, data: bytes) -> None:
        stamped = bytearray(data)
        _STAMP.pack_into(stamped, self._stamp_at[channel], utime - self.zero)
        self._inbox.Publish(channel, bytes(stamped))
        self._inbox.HandleSubscriptions(0)

    def _take(self, channel: str, kind: type, data: bytes) -> None:
        message: Any = decode(kind, data, self._joints)
        stamped = message.header if isinstance(message, lcmt_image_array) else message
        # The arm's driver sends -1 until its clock and the robot's are synchronized.
        if message is None or stamped.utime < 0 or not self._in_step(channel, stamped.utime):
            self.dropped[channel] += 1
            return
        self._utime[channel] = stamped.utime
        if isinstance(message, lcmt_image_array):
            before, pictures = self._pictures.get(channel), [each.data for each in message.images]
            self._pictures[channel] = pictures
            if pictures and pictures == before:  # noise makes two images of a camera differ
                self.dropped[channel] += 1
                return
        if kind is lcmt_iiwa_status:
            self._statuses.append((stamped.utime, data))
        else:
            self._newest[channel] = stamped.utime, data

    def _in_step(self, channel: str, utime: int) -> bool:
        """Whether a stamp [us] follows on the last one of its channel, as far as time has passed.

        Of the arm's driver, whose clock is that of the run, a clock that was set is noted.
        """
        now = time.monotonic()
        used, unused = self._used.get(channel, (now, 0))
        passed = 1e-6 * (utime - self._utime.get(channel, utime - 1))
        arm = channel == channels.IIWA_STATUS
        farthest = min(AHEAD + now - used, FARTHEST if arm else math.inf)
        if 0.0 < passed <= (farthest if self.begun else math.inf):
            self._used[channel] = now, 0
            return True
        self._used[channel] = used, unused + (passed != 0.0)
        steady = now - used < SET_AFTER or unused < SET_COUNT or passed == 0.0
        if steady or self.clock_set is not None:
            return False
        if arm and self.begun:
            self.clock_set = passed - (now - used)
            return False
        self._used[channel] = now, 0
        return True


class ControlLoop:
    """The pipeline of a scenario behind the drivers' messages, one step for every status.

    By the computer's clock it only gives up waiting: where the drivers are simulated, slowly, it is
    as slow as they are.

    Attributes:
        diagram: The pipeline, see `make_dynamic_grasp`.
        simulator: Advances it.
        intake: What arrives.
        started: Whether anything is asked of the guard yet.
        image_to_grasps: From an image to its grasps, each time that there were other ones [s].
    """

    def __init__(self, scenario: Scenario, lcm: DrakeLcm, connect: Connect | None = None) -> None:
        """Builds the pipeline, and waits for the processes of perception to be there.

        Of the scenario's object and motion nothing is used; the drivers are on the bus ``lcm``;
        ``connect`` is that of `make_dynamic_grasp`.

        Raises:
            WorkerError: One of them does not start.
        """
        self._period = scenario.control.period
        # The diagram has a bus of its own, to which the intake hands on what may be used.
        inbox = DrakeLcm("memq://")
        self._station = HardwareStation(scenario, inbox, lcm)
        self.diagram: Diagram = make_dynamic_grasp(scenario, station=self._station, connect=connect)
        self.simulator = Simulator(self.diagram)
        self._remote = remote_stages(self.diagram)
        for stage in self._remote:
            stage.worker.wait_until_ready()
        # Now: what comes while no one listens is old when it is received.
        self.intake = Intake(lcm, channels.inbound(scenario), inbox, self._station.arm.joints)
        self.started = False
        self.image_to_grasps: list[float] = []
        self._first: int | None = None

    def step(self, timeout: float) -> None:
        """Waits for a status message, at most ``timeout`` [s]; answers all that have come by then.

        The first ones are only listened to: then the driver takes commands, and the pipeline starts
        at the measured position.

        Raises:
            HardwareError: None came, or the driver's clock was set.
        """
        utime: int | None = self._wait(timeout)
        while utime is not None:
            if self._first is None:
                self._first = utime
            if self.started:
                self.intake.forward()
                self._advance(utime)
            elif utime - self._first >= 1e6 * CommandGuard.START_AFTER:
                self._begin(utime)
            else:
                self.intake.skip()
            utime = self.intake.oldest()
        if self.started:
            request = self._station.request
            request.ForcedPublish(request.GetMyContextFromRoot(self.simulator.get_context()))

    def _begin(self, utime: int) -> None:
        """Starts the pipeline, whose time is zero from now on."""
        self.intake.zero, self.intake.begun, self.started = utime, True, True
        self.intake.forward()
        self.simulator.Initialize()

    def _advance(self, utime: int) -> None:
        """Lets the pipeline do what is due at a status."""
        # Whole periods: the driver's jitter is none of the control's.
        now = round(1e-6 * (utime - self.intake.zero) / self._period) * self._period
        context = self.simulator.get_mutable_context()
        if now > context.get_time():
            # What perception's processes have found; none of them is waited for.
            for stage in self._remote:
                self.image_to_grasps += stage.take(stage.GetMyMutableContextFromRoot(context), now)
            self.simulator.AdvanceTo(now)
            self.simulator.AdvancePendingEvents()

    def _wait(self, timeout: float) -> int:
        """Time stamp of the next status [us], as soon as there is one."""
        deadline = time.monotonic() + timeout
        self.intake.receive(0.0)
        while (utime := self.intake.oldest()) is None:
            if (by := self.intake.clock_set) is not None:
                raise HardwareError(
                    f"stamps on {channels.IIWA_STATUS} jump by {by:+.3g} s: the clock of the arm's "
                    "driver was set, or this program was stopped meanwhile; start it again"
                )
            if time.monotonic() >= deadline:
                dropped = self.intake.dropped[channels.IIWA_STATUS]
                of_no_use = f"; {dropped} came that were of no use" if dropped else ""
                raise HardwareError(
                    f"no message on {channels.IIWA_STATUS} for {timeout:g} s{of_no_use}: start the "
                    "arm's driver, or 'feasigrasp sim', on the same --lcm-url, and see 'feasigrasp "
                    "doctor'"
                )
            self.intake.receive(min(0.05, timeout))
        return utime
