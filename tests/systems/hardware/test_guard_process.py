"""The guard as a process of its own, on the computer of the arm's driver."""

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.lcm import DrakeLcm

from feasigrasp.cli import main
from feasigrasp.errors import HardwareError
from feasigrasp.runs.console import StatusLine
from feasigrasp.runs.hardware import control
from feasigrasp.runs.hardware.control import WAIT_FOR_GUARD, _Commands, run_hardware
from feasigrasp.scenario import load_scenario
from feasigrasp.systems.hardware import channels, control_loop
from feasigrasp.systems.hardware import guard as guard_module
from feasigrasp.systems.hardware.guard import Guard, Standby, refuse_if_commanded
from feasigrasp.systems.hardware.priority import Priority, real_time

RESET = getattr(os, "SCHED_RESET_ON_FORK", 0)
URL = "udpm://239.255.76.68:7668?ttl=0"


@pytest.fixture
def alone():
    """``feasigrasp guard``, once it serves."""
    try:
        DrakeLcm(URL).Publish("FEASIGRASP_TEST", b"")
    except RuntimeError as error:
        pytest.skip(f"no multicast on this computer: {error}")
    command = [sys.executable, "-m", "feasigrasp.cli", "guard", "--lcm-url", URL]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert URL in process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.wait()


def threads(pid):
    """Numbers of the threads of a process."""
    return {int(thread.name) for thread in Path(f"/proc/{pid}/task").iterdir()}


def is_urgent(thread):
    """Whether a thread has a priority of real time."""
    return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


def urgent_threads(pid):
    """How many threads of a process have a priority of real time."""
    return sum(map(is_urgent, threads(pid)))


def may_have_priority():
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


IN_PROC = pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="threads are looked for in /proc"
)


@IN_PROC
def test_whoever_receives_its_messages_has_its_priority(alone):
    """One that waits for other work hands statuses on late, however quick the guard itself is."""
    if not may_have_priority():
        pytest.skip("no priority of real time is granted here: see rtprio in limits.conf")
    assert urgent_threads(alone.pid) >= 2


@IN_PROC
@pytest.mark.parametrize("main_thread", [True, False])
def test_a_controller_has_priority_and_what_it_starts_has_none(main_thread):
    if not may_have_priority():
        pytest.skip("no priority of real time is granted here: see rtprio in limits.conf")
    done, said = threading.Event(), []
    other = threading.Thread(target=done.wait)
    other.start()
    show = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0) == os.SCHED_OTHER)"]
    before, there = urgent_threads(os.getpid()), threads(os.getpid())
    with real_time(Priority.CONTROL, main=main_thread):
        there &= threads(os.getpid())  # those of other tests may have ended
        within = set(filter(is_urgent, there))
        said.append(subprocess.run(show, capture_output=True, text=True, check=True).stdout)
    done.set()
    other.join()
    assert before == 0 == urgent_threads(os.getpid())
    assert within == there - ({os.getpid()} if not main_thread else set())
    assert len(within) >= 1
    assert said == ["True\n"]


def test_whoever_had_a_policy_has_it_again(monkeypatch):
    """Nothing is asked for in the name of threads that were refused."""
    asked, usual = [], SimpleNamespace(sched_priority=0)

    def set_policy(thread, policy, _):
        if thread != os.getpid():
            raise PermissionError
        asked.append(policy & ~RESET)

    idle = getattr(os, "SCHED_IDLE", 5)
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: idle, raising=False)
    monkeypatch.setattr(os, "sched_getparam", lambda _: usual, raising=False)
    monkeypatch.setattr(os, "sched_setscheduler", set_policy, raising=False)
    with real_time(Priority.CONTROL):
        assert asked == [os.SCHED_FIFO]
    assert asked == [os.SCHED_FIFO, idle]
    monkeypatch.delattr(os, "sched_getscheduler")  # as on macOS
    with real_time(Priority.CONTROL):
        assert len(asked) == 2


def test_one_that_is_told_to_end_brakes_whatever_is_requested():
    bus, sent = DrakeLcm("memq://"), []
    listening = bus.Subscribe(channels.IIWA_COMMAND, sent.append)
    k, q = 0, np.zeros(7)
    guard = Guard(bus, clock=lambda: k * channels.IIWA_PERIOD)
    for k in range(400):
        if k == 200:
            assert guard._guard.moving
            guard.end()
        bus.Publish(channels.IIWA_REQUEST, a_request(k, 0.5 * k * channels.IIWA_PERIOD))
        bus.Publish(channels.IIWA_STATUS, a_status(k, q))
        while bus.HandleSubscriptions(0):
            pass
        q = np.array(lcmt_iiwa_command.decode(sent[-1]).joint_position) if sent else q
    assert not guard._guard.moving
    guard.serve()  # it is over
    del listening


RIVAL = "commands this arm already; .* --no-guard"


def test_where_somebody_commands_already_it_does_not_begin(alone):
    """It commands the arm as soon as there is one, wanted or not."""
    bus, other = DrakeLcm(URL), [sys.executable, "-m", "feasigrasp.cli", "guard", "--lcm-url", URL]
    second = subprocess.Popen(other, stderr=subprocess.PIPE, text=True)
    for tick in range(10000):
        bus.Publish(channels.IIWA_STATUS, a_status(tick, np.zeros(7)))
        if second.poll() is not None:
            break
        time.sleep(0.005)
    assert second.wait(1.0) == 2 and re.search(RIVAL, second.stderr.read())
    assert alone.poll() is None


def test_two_that_wait_for_the_same_driver_find_each_other():
    bus = DrakeLcm("memq://")
    k = 0
    guards = [Guard(bus, clock=lambda: k * channels.IIWA_PERIOD) for _ in range(2)]
    for k in range(100):
        bus.Publish(channels.IIWA_STATUS, a_status(k, np.zeros(7)))
        while bus.HandleSubscriptions(0):
            pass
    for guard in guards:
        with pytest.raises(HardwareError, match=RIVAL):
            guard.serve()


def test_one_whose_controller_is_no_more_ends(monkeypatch):
    for alive in (True, False):
        owner = SimpleNamespace(is_alive=lambda alive=alive: alive)
        monkeypatch.setattr(multiprocessing, "parent_process", lambda owner=owner: owner)
        assert Guard(DrakeLcm("memq://"))._wanted_to_end() is not alive


def test_a_controller_does_not_begin_where_somebody_commands():
    bus = DrakeLcm("memq://")
    refuse_if_commanded(bus)
    bus.Publish(channels.IIWA_COMMAND, a_request())
    subscribed = bus.Subscribe(channels.IIWA_COMMAND, lambda data: None)
    threading.Timer(0.02, bus.Publish, (channels.IIWA_COMMAND, a_request())).start()
    with pytest.raises(HardwareError, match=RIVAL):
        refuse_if_commanded(bus)
    del subscribed


def test_of_what_comes_later_nothing_is_kept():
    bus = DrakeLcm("memq://")
    refuse_if_commanded(bus)
    tracemalloc.start()
    for _ in range(100):
        bus.Publish(channels.IIWA_COMMAND, bytes(100_000))
        bus.HandleSubscriptions(0)
    assert tracemalloc.get_traced_memory()[0] < 1_000_000
    tracemalloc.stop()


def test_a_standby_that_refuses_the_driver_ends_without_an_error(monkeypatch):
    """The guard beside it says why."""

    def serve(_):
        raise HardwareError("IIWA_STATUS has a period of 50 ms")

    monkeypatch.setattr(Standby, "serve", serve)
    monkeypatch.setattr(guard_module, "end_at_signals", lambda *_, **__: None)
    guard_module._brake("memq://", SimpleNamespace(make_guard=lambda: None), True)


def test_ctrl_c_ends_it(alone):
    alone.send_signal(signal.SIGINT)
    assert alone.wait(20.0) == 0


def test_one_that_was_started_by_hand_waits_for_the_next_controller():
    bus = DrakeLcm("memq://")
    patient = Guard(bus)
    assert not patient._wanted_to_end()
    patient.end()
    bus.Publish(channels.IIWA_REQUEST, a_request())  # the last one, which was under way already
    bus.HandleSubscriptions(0)
    patient.serve()


def a_request(tick=1, q=0.0):
    message = lcmt_iiwa_command()
    message.utime, message.num_joints, message.joint_position = 5000 * tick, 7, [q] * 7
    return message.encode()


def a_status(tick, q):
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = 5000 * tick, 7
    for name in ("measured", "commanded", "ipo"):
        setattr(message, f"joint_position_{name}", list(q))
    message.joint_velocity_estimated = [0.0] * 7
    for name in ("measured", "commanded", "external"):
        setattr(message, f"joint_torque_{name}", [0.0] * 7)
    return message.encode()


def test_a_controller_without_a_guard_says_so():
    bus = DrakeLcm("memq://")
    commands = _Commands(bus)
    commands.expect(0.9 * WAIT_FOR_GUARD)
    with pytest.raises(HardwareError, match="no message on IIWA_COMMAND.*'feasigrasp guard'"):
        commands.expect(1.1 * WAIT_FOR_GUARD)
    bus.Publish(channels.IIWA_COMMAND, b"")
    bus.HandleSubscriptions(0)
    commands.expect(1.1 * WAIT_FOR_GUARD)


def test_no_guard_is_for_hardware(capsys):
    assert main(["run", "ReachCircularMocap", "--no-guard"]) != 0
    assert "--no-guard says who commands an arm; give it with --hardware" in capsys.readouterr().err


def the_run(kept):
    """A run on a bus without a driver; kept gets its record."""
    text = "{perception: {execution: inline}, grasp: {close: false}}"
    scenario = load_scenario("ReachLinearMocap", text)
    shown = StatusLine()
    return run_hardware(scenario, "", "memq://", False, log=True, keep=kept.append, line=shown)


def test_what_breaks_a_run_off_is_in_its_record_and_leaves_the_log(monkeypatch):
    def broken(loop, timeout):
        raise ValueError("broken part")

    monkeypatch.setattr(control, "WAIT_FOR_DRIVER", control.SILENCE)
    monkeypatch.setattr(control.ControlLoop, "step", broken)
    kept = []
    result = the_run(kept)
    assert kept == [result.record] and "time" in result.log
    assert result.record["error"].startswith("ValueError: broken part (")


@pytest.fixture
def ctrl_c():
    """Ctrl-C as usual; a shell's background processes ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_the_wait_for_a_driver(monkeypatch):
    receive = control_loop.Intake.receive

    def interrupted(intake, timeout):
        signal.raise_signal(signal.SIGINT)
        monkeypatch.setattr(control_loop.Intake, "receive", receive)

    monkeypatch.setattr(control_loop.Intake, "receive", interrupted)
    record = the_run([]).record
    assert record["error"] == control.INTERRUPTED and record["timings"]["wall_s"] < 3.0


def test_ctrl_c_ends_the_wait_for_the_own_guard():
    own, asked = object.__new__(control._OwnGuard), threading.Event()
    own._begun, own._process = threading.Event(), SimpleNamespace(is_alive=lambda: True)
    asked.set()
    began = time.monotonic()
    own.wait_until_it_serves(asked)
    assert time.monotonic() - began < 3.0
