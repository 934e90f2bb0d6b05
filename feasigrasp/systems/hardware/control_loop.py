"""Lets a diagram's time follow the clock of the arm's status messages."""

from __future__ import annotations

import time

from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from feasigrasp.errors import HardwareError
from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.intake import Intake
from feasigrasp.systems.hardware.station import HardwareStation


class ControlLoop:
    """The pipeline of a scenario behind the drivers' messages, one step for every status.

    Nothing in it looks at the computer's clock: where the drivers are simulated, slowly, it is as
    slow as they are.

    Attributes:
        diagram: The pipeline, see `make_dynamic_grasp`.
        simulator: Advances it.
        intake: What arrives.
        started: Whether anything is asked of the guard yet.
    """

    def __init__(self, scenario: Scenario, lcm: DrakeLcm) -> None:
        """Builds the pipeline.

        Args:
            scenario: What to run; of its object and motion nothing is used.
            lcm: The bus that the drivers are on.
        """
        self._period = scenario.control.period
        # The diagram has a bus of its own, to which the intake hands on what may be used.
        inbox = DrakeLcm("memq://")
        self.intake = Intake(lcm, channels.inbound(scenario), inbox)
        self._station = HardwareStation(scenario, inbox, lcm)
        self.diagram: Diagram = make_dynamic_grasp(scenario, station=self._station)
        self.simulator = Simulator(self.diagram)
        self.started = False
        self._first: int | None = None

    @property
    def time(self) -> float:
        """Time of the newest status message, in the diagram's clock [s]."""
        utime = self.intake.utime(channels.IIWA_STATUS)
        since = 0.0 if utime is None else 1e-6 * (utime - self.intake.zero)
        # Whole periods: the driver's jitter is none of the control's.
        return self._period * round(since / self._period)

    def step(self, timeout: float) -> None:
        """Waits for the next status message, and answers it.

        The first ones are only listened to: then the driver takes commands, and the pipeline starts
        at the measured position.

        Args:
            timeout: How long to wait at most [s].

        Raises:
            HardwareError: None came.
        """
        newest = self._next_status(timeout)
        if self._first is None:
            self._first = newest
        if not self.started:
            if newest - self._first >= 1e6 * CommandGuard.START_AFTER:
                self.started, self.intake.zero = True, newest
                self.intake.hand_on()
                self.simulator.Initialize()
                self._publish()
            return
        self.intake.hand_on()
        if self.time > self.simulator.get_context().get_time():
            self.simulator.AdvanceTo(self.time)
            self.simulator.AdvancePendingEvents()
            self._publish()

    def _next_status(self, timeout: float) -> int:
        """Time stamp of the next status [us], as soon as there is one."""
        last = self.intake.utime(channels.IIWA_STATUS)
        deadline = time.monotonic() + timeout
        while True:
            self.intake.receive(min(0.05, timeout))
            utime = self.intake.utime(channels.IIWA_STATUS)
            if utime is not None and utime != last:
                return utime
            if time.monotonic() >= deadline:
                dropped = self.intake.dropped[channels.IIWA_STATUS]
                of_no_use = f"; {dropped} came that were of no use" if dropped else ""
                raise HardwareError(
                    f"no message on {channels.IIWA_STATUS} for {timeout:g} s{of_no_use}: start the "
                    "arm's driver, or 'feasigrasp sim', on the same --lcm-url, and see 'feasigrasp "
                    "doctor'"
                )

    def _publish(self) -> None:
        request = self._station.request
        request.ForcedPublish(request.GetMyContextFromRoot(self.simulator.get_context()))
