"""Runs the simulated cell behind driver messages, and evaluates the run."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from drake import lcmt_iiwa_command
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.one_thread import one_thread
from feasigrasp.runs.console import StatusLine
from feasigrasp.runs.metrics.motion_limits import share_beyond
from feasigrasp.runs.results.interrupts import postponed_interrupt
from feasigrasp.runs.run import INTERRUPTED, crash_record, measured, timings_of
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.channels import decode
from feasigrasp.systems.hardware.priority import Priority, real_time
from feasigrasp.systems.hardware.simulated_cell import make_simulated_cell
from feasigrasp.systems.metrics import SAMPLE_PERIOD


class ReceivedCommands:
    """Every command for the arm, and when something was asked of the guard.

    Attributes:
        requests: When each request came [s].
        moved: When the last command came that differed from the one before [s]; 0 before.
        unusable: How many commands were none: not seven finite positions.
        late: How many came when the period that they were for was over.
    """

    def __init__(
        self, lcm: DrakeLcm, now: Callable[[], float], joints: int = IIWA_7.joints
    ) -> None:
        """Listens on a bus for commands to ``joints`` joints; ``now`` is a simulated clock [s]."""
        self.requests: list[float] = []
        self.unusable = self.late = 0
        self.moved = 0.0
        self._now, self._joints = now, joints
        self._utime: list[int] = []
        self._q: list[Array] = []
        self._subscriptions = [
            channels.subscribe(lcm, channels.IIWA_COMMAND, self._command),
            channels.subscribe(lcm, channels.IIWA_REQUEST, self._request),
        ]

    def _request(self, _: bytes) -> None:
        self.requests.append(self._now())

    def _command(self, data: bytes) -> None:
        command = decode(lcmt_iiwa_command, data, self._joints)
        if command is None:
            self.unusable += 1
            return
        q = np.array(command.joint_position)
        if self._q and np.any(q != self._q[-1]):
            self.moved = self._now()
        self.late += self._now() >= 1e-6 * command.utime + channels.IIWA_PERIOD - 1e-6
        self._utime.append(command.utime)
        self._q.append(q)

    @property
    def first(self) -> float | None:
        """Time of the first request to the guard [s], which holds the arm until then; or None."""
        return self.requests[0] if self.requests else None

    @property
    def positions(self) -> Array:
        """The commanded positions, in order, shape (m, 7) [rad]."""
        return np.array(self._q).reshape(-1, self._joints)

    @property
    def missing(self) -> int:
        """Number of driver periods without a command, from the first to the last."""
        if not self._utime:
            return 0
        lasted = 1e-6 * (self._utime[-1] - self._utime[0]) / channels.IIWA_PERIOD
        return max(0, round(lasted) + 1 - len(set(self._utime)))


def simulate_cell(
    scenario: Scenario,
    name: str,
    lcm_url: str,
    rate: float,
    keep: Callable[[dict[str, Any]], None],
    line: StatusLine,
) -> dict[str, Any]:
    """Simulates a cell until the grasp is over, or the controller gone, and judges it.

    The scenario's duration counts from the controller's first request. Messages go to ``lcm_url``.
    Simulated time is at most ``rate`` times as fast as the clock on the wall, and no period of the
    driver is shorter than that. Other arguments are those of `run`.

    Returns:
        The record of a run; the controller's internal state (grasps, status) is not in it, and what
        was received from the controller is under ``hardware``.
    """
    record = crash_record(scenario, name, "")
    error = None
    with one_thread(), postponed_interrupt() as interrupted:
        built = time.perf_counter()
        lcm = channels.open_lcm(lcm_url)
        received = ReceivedCommands(
            lcm, lambda: simulator.get_context().get_time(), load_arm(scenario.arm).joints
        )
        # The simulation may be slow, but a driver receives its commands.
        with real_time(Priority.DRIVER, main=False):
            diagram = make_simulated_cell(scenario, lcm)
            simulator = Simulator(diagram)
            ApplySimulatorConfig(scenario.simulator_config, simulator)
            monitor = _Monitor(diagram, scenario, received, interrupted.is_set, line, rate)
            simulator.set_monitor(monitor)
            started = time.perf_counter()
            try:
                simulator.Initialize()
                simulator.AdvanceTo(np.inf)
            except RuntimeError as failure:
                error = str(failure)
    if error is None:
        error = monitor.error
    ended = time.perf_counter()
    context = simulator.get_context()
    metrics, report = _judged(diagram, context, scenario, received, broke_off=error is not None)
    timings = timings_of(built, started, ended, context.get_time())
    record |= {"timings": timings, "metrics": metrics, "error": error, "hardware": report}
    keep(record)
    return record


def _judged(
    diagram: Diagram,
    context: Context,
    scenario: Scenario,
    received: ReceivedCommands,
    *,
    broke_off: bool,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The metrics of a run, and what was received from the controller."""
    log = diagram.GetSubsystemByName("log(arm)").FindLog(context)
    q, v = np.split(log.data().T, 2, axis=1)
    _, _, metrics = measured(diagram, context, scenario, broke_off=broke_off, sent=q)
    # What the driver held in each of its cycles, those without a command among them.
    held = diagram.GetSubsystemByName("log(driver)").FindLog(context).data().T
    velocity = np.diff(held, axis=0) / channels.IIWA_PERIOD
    accelerations = np.diff(velocity, axis=0, prepend=0.0) / channels.IIWA_PERIOD
    arm = load_arm(scenario.arm)
    accelerations = np.abs(accelerations / arm.acceleration_limits)
    speeds = (np.abs(each / arm.velocity_limits) for each in (velocity, v))
    metrics["velocity_limit_violation_percent"] = max(map(share_beyond, speeds))
    metrics["acceleration_limit_violation_percent"] = share_beyond(accelerations)
    metrics["acceleration_peak_percent"] = 100.0 * float(accelerations.max(initial=0.0))
    sent = received.positions
    beyond = (sent < arm.driver.lower) | (sent > arm.driver.upper)
    driver = diagram.GetSubsystemByName("driver")
    stopped = driver.GetOutputPort("stopped").Eval(driver.GetMyContextFromRoot(context))
    gaps = 1e3 * np.diff(received.requests)
    report = {
        "first_request_s": received.first,
        "commands": len(sent),
        "commands_missing": received.missing,
        "commands_late": received.late,
        "commands_unusable": received.unusable,
        "commands_clamped": int(beyond.any(axis=1).sum()),
        "driver_stopped_by_joint": int(stopped[0]),
        "requests": len(received.requests),
        "request_gap_ms_max": float(gaps.max()) if len(gaps) else None,
        "request_gap_ms_p99": float(np.percentile(gaps, 99)) if len(gaps) else None,
        "last_request_s": received.requests[-1] if received.requests else None,
        "rest_s": _rest(received, context.get_time()),
    }
    return metrics, report


def _rest(received: ReceivedCommands, ended: float) -> float | None:
    """How long after the last request the arm was sent to rest [s]; None if it was not.

    By the commands, since an object that is carried on may push an arm that stands.
    """
    if not received.requests or ended - received.moved < 2.0 * channels.IIWA_PERIOD:
        return None
    return max(0.0, received.moved - received.requests[-1])


class _Monitor:
    """Ends the run: the grasp is over, the time is up, the controller gone, or Ctrl-C.

    Attributes:
        error: What was wrong; None where the run came to its end.
    """

    def __init__(
        self,
        diagram: Diagram,
        scenario: Scenario,
        received: ReceivedCommands,
        interrupted: Callable[[], bool],
        line: StatusLine,
        rate: float,
    ) -> None:
        self.error: str | None = None
        self._tick = channels.IIWA_PERIOD / rate
        self._ticks, self._tick_ends = 0, 0.0
        self._scenario, self._received = scenario, received
        self._interrupted, self._line = interrupted, line
        self._handover = diagram.GetSubsystemByName("handover")
        self._next, self._done_at = 0.0, np.inf

    def __call__(self, context: Context) -> EventStatus:
        now = context.get_time()
        self._pace(now)
        if self._interrupted():
            return self._end(INTERRUPTED)
        if now < self._next:
            return EventStatus.DidNothing()
        self._next = now + 0.5 * SAMPLE_PERIOD
        waits = "waiting for a controller" if self._received.first is None else "controlled"
        self._line.show(f"simulating {now:6.1f} s  {waits}", patient=True)
        if self._received.first is None:
            return EventStatus.DidNothing()
        phase = self._handover.GetOutputPort("phase").Eval(
            self._handover.GetMyContextFromRoot(context)
        )[0]
        if phase == Phase.DONE:
            self._done_at = min(self._done_at, now)
        out_of_time = now - self._received.first >= self._scenario.simulation_duration
        if now >= self._done_at + SAMPLE_PERIOD or out_of_time:
            return self._end(None)
        # A controller that has said nothing for so long is gone [s].
        if now - self._received.requests[-1] >= 2.0:
            return self._end("the controller is gone: it asks for nothing any more")
        return EventStatus.DidNothing()

    def _pace(self, now: float) -> None:
        """Lets every period of the driver last as long as it should.

        One that took longer is not made up for by shorter ones, as Drake's own rate would: a
        driver's messages do not come in bursts. Whoever answers a status, which has been sent
        at present, has half a period at least, however late the simulation was with it.
        """
        ticks = int(now / channels.IIWA_PERIOD + 1e-6)
        if ticks > self._ticks:
            sent = time.monotonic()
            self._tick_ends = max(self._tick_ends + self._tick, sent + 0.5 * self._tick)
            time.sleep(self._tick_ends - sent)
            self._ticks, self._tick_ends = ticks, time.monotonic()

    def _end(self, error: str | None) -> EventStatus:
        self.error = error
        return EventStatus.ReachedTermination(self._handover, error or "the run is over")
