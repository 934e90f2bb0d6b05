"""A simulated cell and its controller as two processes, with process faults."""

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
import zlib
from contextlib import ExitStack, suppress
from enum import StrEnum
from pathlib import Path
from typing import Any

import psutil
from drake import lcmt_iiwa_status
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.remote.worker import SERVING
from feasigrasp_lab.runs.hardware_network import LOST, Network, RelayProcess


class ProcessFault(StrEnum):
    """Process fault: a signal to the controller, to one of its workers, or to the guard."""

    KILL = "kill"
    STOP = "stop"
    KILL_WORKER = "kill_worker"
    STOP_WORKER = "stop_worker"
    END_GUARD = "end_guard"
    STOP_GUARD = "stop_guard"
    KILL_GUARD = "kill_guard"

    @property
    def at_guard(self) -> bool:
        """Whether it is the guard's."""
        return self.endswith("_guard")

    @property
    def at_worker(self) -> bool:
        """Whether the controller itself goes on."""
        return self in (ProcessFault.KILL_WORKER, ProcessFault.STOP_WORKER)

    @property
    def signal(self) -> signal.Signals:
        """What is sent."""
        if self is ProcessFault.END_GUARD:
            return signal.SIGHUP
        return signal.SIGKILL if self.startswith("kill") else signal.SIGSTOP


def run_pair(
    name: str, scenario_yaml: str, *, rate: float, fault: str = "", at: float = 0.0
) -> dict[str, Any]:
    """Runs ``feasigrasp sim`` and ``feasigrasp run --hardware``; returns what the former recorded.

    What the latter says of itself, ``on_hardware``, comes along if it exists. With a bad
    network between the two, ``feasigrasp guard`` is on the side of the cell, or as the network has
    it (`Network.at_driver`).

    Args:
        name: A name that no other pair has at the same time; its seed is made of it.
        scenario_yaml: What to run.
        rate: Of the simulation, at most.
        fault: A `ProcessFault` or a `Network`; empty for none.
        at: When it begins, after the controller's first request [simulated s].

    Raises:
        HardwareError: The simulated cell came to no end; the message has its last words.
    """
    number = zlib.crc32(name.encode())
    apart, at_guard = fault in list(Network), fault in [f for f in ProcessFault if f.at_guard]
    cell, control = _url(name, 0), _url(name, int(apart))
    with tempfile.TemporaryDirectory(prefix="feasigrasp-") as folder:
        file, results = Path(folder, "pair.yaml"), Path(folder, "sim.json")
        own = Path(folder, "run.json")
        file.write_text("Pair:\n" + textwrap.indent(scenario_yaml, "  "))
        both = ["Pair", "--scenario-file", str(file)]
        rated = ["--rate", str(rate), "--results", str(results)]
        driven = ["--hardware", "--lcm-url", control, "--results", str(own)]
        with Path(folder, "words").open("w+") as words:
            with ExitStack() as running:
                relay = guard = None
                if apart:
                    relay = RelayProcess(cell, control, Network(fault), number)
                    running.callback(relay.close)
                if apart or at_guard:
                    bus = control if apart and Network(fault).at_driver else cell
                    guard = _start("guard", *both, "--speed", "1", "--lcm-url", bus, output=None)
                    running.callback(_end, guard)
                    driven += ["--no-guard"]
                controller = _start("run", *both, *driven, output=None)
                running.callback(_end, controller)
                sim = _start("sim", *both, *rated, "--lcm-url", cell, output=words)
                running.callback(_end, sim)
                _watch(
                    sim, guard if guard and at_guard else controller, cell, relay, fault, at, number
                )
                if fault not in list(ProcessFault) or ProcessFault(fault).at_worker:
                    # It ends by itself, as its messages stop, within this time [s].
                    with suppress(subprocess.TimeoutExpired):
                        controller.wait(60.0)
            if not results.exists():
                words.seek(0)
                raise HardwareError(
                    f"the simulated cell of {name} ended early: {words.read()[-500:]}"
                )
        record: dict[str, Any] = json.loads(results.read_text())
        if own.exists():
            record["on_hardware"] = json.loads(own.read_text())["on_hardware"]
    return record


def _url(name: str, side: int) -> str:
    """The URL of an unused bus on this computer."""
    number = zlib.crc32(f"{name} {os.getpid()}".encode())
    return f"udpm://239.255.{100 + side}.{1 + number % 250}:{20000 + number // 250 % 40000}?ttl=0"


def _start(*words: str, output: Any) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "feasigrasp.cli", *words]
    where = subprocess.DEVNULL if output is None else output
    # A session of its own: the guard, which outlives its controller, is ended with it.
    return subprocess.Popen(command, stdout=where, stderr=where, start_new_session=True)


def _watch(
    sim: subprocess.Popen[bytes],
    target: subprocess.Popen[bytes],
    url: str,
    relay: RelayProcess | None,
    fault: str,
    at: float,
    number: int,
) -> None:
    """Waits for the end of the simulation; does to controller or guard what is to be done, in time.

    The number says which of its worker processes receives the signal.
    """
    lcm, times = DrakeLcm(url), _Times()
    subscriptions = [
        lcm.Subscribe(channels.IIWA_STATUS, times.status),
        lcm.Subscribe(channels.IIWA_REQUEST, times.request),
    ]
    # How long a pair of processes may take from its start to its end [s].
    faulted, deadline = False, time.monotonic() + 900.0
    while sim.poll() is None and time.monotonic() < deadline:
        lcm.HandleSubscriptions(20)
        if not faulted and fault and times.now >= times.first + at:
            faulted = True
            if relay is not None:
                relay.begin()
            else:
                _strike(target, ProcessFault(fault), number)
        if target.poll() not in (None, 0) and times.first == math.inf:
            return  # it has never begun: the simulation would wait for ever
    del subscriptions


def _strike(target: subprocess.Popen[bytes], process_fault: ProcessFault, number: int) -> None:
    if target.poll() is not None:
        return
    with suppress(ProcessLookupError, psutil.NoSuchProcess):
        pids = workers_of(target.pid) if process_fault.at_worker else [target.pid]
        os.kill(pids[number % len(pids)], process_fault.signal)
        if process_fault is ProcessFault.STOP_GUARD:
            time.sleep(LOST)
            target.send_signal(signal.SIGCONT)


def workers_of(pid: int) -> list[int]:
    """The processes that perceive and plan for a controller, in the order of their start.

    Args:
        pid: Of the controller.

    Raises:
        HardwareError: There are none.
    """
    children = psutil.Process(pid).children()
    workers = [child.pid for child in children if SERVING in " ".join(child.cmdline())]
    if not workers:
        raise HardwareError(f"process {pid} has no process that perceives or plans for it")
    return sorted(workers)


class _Times:
    """The time of the simulation, and when something was asked of the arm's guard first."""

    def __init__(self) -> None:
        self.now, self.first = 0.0, math.inf

    def status(self, data: bytes) -> None:
        self.now = 1e-6 * lcmt_iiwa_status.decode(data).utime

    def request(self, data: bytes) -> None:
        self.first = min(self.first, self.now)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends a process and those that it has started, gently but for one that does not listen."""
    try:
        os.killpg(process.pid, signal.SIGCONT)
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(20.0)
    except ProcessLookupError:
        process.wait()
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
