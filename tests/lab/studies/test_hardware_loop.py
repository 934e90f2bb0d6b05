"""The study of two processes: what is planned, what is counted, and a network that is bad."""

import os
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_image, lcmt_image_array
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.runs.console import StatusLine
from feasigrasp.runs.hardware import cell as cell_module
from feasigrasp.runs.hardware.cell import ReceivedCommands
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.hardware import channels
from feasigrasp_lab.runs import hardware_network as network
from feasigrasp_lab.runs import hardware_pair as pair
from feasigrasp_lab.runs.hardware_network import Network, Relay, RelayProcess
from feasigrasp_lab.runs.hardware_pair import ProcessFault, workers_of
from feasigrasp_lab.studies import hardware_loop
from feasigrasp_lab.studies.hardware_loop import outcome, outcome_rows, planned_pairs

#: Has another child than its two workers, says their numbers, and waits.
CONTROLLER = """
import subprocess, sys
from feasigrasp.systems.remote.worker import Worker
from tests.remote_counter import Counter

workers = [Worker(Counter) for _ in range(2)]
for worker in workers:
    worker.wait_until_ready()
other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
print(*sorted(worker.pid for worker in workers), flush=True)
input()
"""
STATUS, IMAGES = channels.IIWA_STATUS, channels.image_channel("wrist_camera")
RUNS = [
    SimpleNamespace(id=name, name="A", object_name="mug", scenario=Scenario()) for name in "abc"
]
ITEM = {"scenario": "A", "object": "mug", "seed": 0, "at": 1.0, "text": ""}


def test_every_run_is_planned_once_and_faults_in_turn():
    pairs = planned_pairs(RUNS, 7, 2, seed=0)
    faults = [item["fault"] for item in pairs.values()]
    assert faults[:5] == ["", "", "", "kill", "stop"]
    assert faults[5:10] == ["kill_worker", "stop_worker", "end_guard", "stop_guard", "kill_guard"]
    assert faults[10:] == [str(n) for n in Network for _ in range(2)]
    assert planned_pairs(RUNS, 7, 2, seed=0) == pairs != planned_pairs(RUNS, 7, 2, seed=1)


@pytest.mark.parametrize("option", ["--process-faults", "--blows"])
def test_the_former_option_works_with_a_warning_that_names_the_new_one(option, capsys):
    parser = ArgumentParser()
    hardware_loop.add_arguments(parser)
    assert parser.parse_args([]).process_faults == 100
    assert parser.parse_args([option, "7"]).process_faults == 7
    assert ("--blows is now --process-faults" in capsys.readouterr().err) == (option == "--blows")


def one(fault="", **changes):
    keys = dict.fromkeys(hardware_loop.LIMITS, 0.0)
    report = {"request_gap_ms_max": 10.0, "request_gap_ms_p99": 6.0, "real_time_factor": 1.0}
    report["image_to_grasps_ms"] = 120.0
    plain = {"held": True, "broken": False, "crashed": False, "rest_s": 0.1}
    return keys | report | plain | {"object": "mug", "fault": fault} | changes


def test_rows_count_what_was_broken_and_how_long_it_takes_to_rest():
    runs = [one(), one(held=False, request_gap_ms_max=30.0, image_to_grasps_ms=None)]
    process_faults = [one("kill", rest_s=0.2), one("stop", rest_s=None, broken=True)]
    workers = [one("kill_worker", rest_s=None), one("kill_worker", rest_s=3.0, held=False)]
    rows = {(r.name, r.preset): r.value for r in outcome_rows([*runs, *process_faults, *workers])}
    assert rows["hardware.held_percent", "kill_worker"] == 50.0
    assert rows["hardware.limits_broken", "kill_worker"] == 0
    assert rows["hardware.held_percent", "processes"] == 50.0
    assert rows["hardware.limits_broken", "processes"] == 0
    assert rows["hardware.limits_broken", "blows"] == 1
    assert rows["hardware.command_gap_ms.max", "processes"] == 30.0
    assert rows["hardware.rest_s.max", "blows"] == 0.2
    assert rows["hardware.image_to_grasps_ms", "processes"] == 120.0
    assert rows["hardware.at_rest", "blows"] == 1


@pytest.mark.parametrize(
    ("fault", "change", "broken"),
    [
        ("kill", {}, False),
        ("kill", {"metrics": {"torque_limit_violation_percent": 0.1}}, True),
        ("kill", {"hardware": {"driver_stopped_by_joint": 6}}, True),
        ("kill", {"metrics": {"obstacle_distance_min_mm": -0.1}}, True),
        ("stop", {"hardware": {"rest_s": None}}, True),
        ("rival", {"hardware": {"rest_s": None}}, True),
        ("end_guard", {"hardware": {"rest_s": None}}, True),
        ("stop_worker", {"hardware": {"rest_s": None}}, False),
    ],
)
def test_what_counts_as_broken(monkeypatch, fault, change, broken):
    record = {
        "metrics": dict.fromkeys(hardware_loop.LIMITS, 0.0) | {"grasp_held": None},
        "hardware": dict.fromkeys(hardware_loop._RECEIVED, 0.0),
        "timings": {"real_time_factor": 0.5},
        "error": None,
    }
    for part, values in change.items():
        record[part] |= values
    monkeypatch.setattr(hardware_loop, "run_pair", lambda *a, **k: record)
    (found,) = outcome("x", ITEM | {"fault": fault}, rate=1.0)
    assert found["broken"] is broken and not found["crashed"]


def command(utime, q):
    message = lcmt_iiwa_command()
    message.utime, message.num_joints, message.joint_position = utime, len(q), list(q)
    return message.encode()


def test_what_was_heard_is_what_was_sent():
    lcm, now = DrakeLcm("memq://"), Namespace(time=0.0)
    received = ReceivedCommands(lcm, lambda: now.time)
    Q = np.arange(28.0).reshape(4, 7)
    for k, comes, q in zip((0, 1, 3, 4), (0, 1, 3, 5), Q, strict=True):
        now.time, utime = 1.0 + 0.005 * comes, 1000000 + 5000 * k
        lcm.Publish(channels.IIWA_COMMAND, command(utime, q))
        lcm.Publish(channels.IIWA_REQUEST, command(utime, q))
        lcm.HandleSubscriptions(0)
    lcm.Publish(channels.IIWA_COMMAND, command(1030000, [np.nan] * 7))
    lcm.HandleSubscriptions(0)
    assert received.first == 1.0
    assert received.missing == received.late == received.unusable == 1
    np.testing.assert_array_equal(received.positions, Q)
    np.testing.assert_allclose(np.diff(received.requests), [0.005, 0.010, 0.010])


@pytest.fixture
def bus(monkeypatch):
    """Buses inside this process, the same for the same URL."""
    buses: dict[str, DrakeLcm] = {}

    def lcm(url):
        return buses.setdefault(url, DrakeLcm("memq://"))

    lcm.forget = buses.clear
    monkeypatch.setattr(network, "DrakeLcm", lcm)
    return lcm


def carried(bus, fault, messages, *, channel="A", begun=True):
    """What arrives at the other end, in its order."""
    relay, came = Relay("one", "other", fault, seed=0), []
    relay.begun = begun
    for message in messages:
        relay._take(1, channel, message)
    subscription = bus("other").Subscribe(channel, came.append)
    end = time.monotonic() + 2.0 * network.LATE
    while time.monotonic() < end:
        relay.step()
        bus("other").HandleSubscriptions(0)
    bus.forget()
    del subscription
    return came


def test_networks_are_as_bad_as_they_say(bus):
    sent = [bytes([k]) for k in range(100)]
    assert carried(bus, Network.LATE, sent, begun=False) == sent
    late = carried(bus, Network.LATE, sent)
    assert sorted(late) == sent != late
    doubled = carried(bus, Network.DOUBLED, sent)
    assert set(doubled) == set(sent) and 105 < len(doubled) < 140
    disordered = carried(bus, Network.DISORDERED, sent)
    assert sorted(disordered) == sent != disordered
    images = "DRAKE_RGBD_CAMERA_IMAGES_c"
    assert carried(bus, Network.NO_IMAGES, sent, channel=images) == []
    assert carried(bus, Network.NO_IMAGES, sent) == sent
    whole = [bytes(20)] * 100
    cut = [data for data in carried(bus, Network.MALFORMED, whole) if data != whole[0]]
    assert 5 < len(cut) < 40 and all(len(data) < 20 for data in cut)


def status(utime, q=(0.0,) * 7):
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = utime, 7
    for name in message.__slots__[2:]:
        setattr(message, name, [0.0] * 7)
    message.joint_position_commanded = list(q)
    return message.encode()


def test_clocks_that_are_set_statuses_that_are_lost_and_strangers(bus):
    sent, q = [status(10_000_000 + 5000 * k) for k in range(200)], np.full(7, 0.3)
    stamps = [
        lcmt_iiwa_status.decode(d).utime
        for d in carried(bus, Network.CLOCK_SET, sent, channel=STATUS)
    ]
    assert len(stamps) == 200 and stamps[0] != 10_000_000
    assert len(carried(bus, Network.STATUS_LOST, sent, channel=STATUS)) == 170
    for fault, channel, off in (
        (Network.RIVAL, channels.IIWA_COMMAND, 0.0),
        (Network.FORGED, channels.IIWA_REQUEST, 0.1),
    ):
        strange, other = [], bus("other")
        listening = other.Subscribe(channel, strange.append)
        assert len(carried(bus, fault, [status(1000, q)], channel=STATUS)) == 1
        del listening
        (asked,) = (lcmt_iiwa_command.decode(data).joint_position for data in strange)
        assert np.abs(np.array(asked) - q).max() <= off


def test_a_depth_that_is_not_a_number(bus):
    image = lcmt_image()
    image.width, image.height, image.pixel_format = 4, 3, lcmt_image.PIXEL_FORMAT_DEPTH
    message = lcmt_image_array()
    message.num_images, message.images = 1, [image]
    for each in (message, image):
        each.header.frame_name = "camera"
    channel = "DRAKE_RGBD_CAMERA_IMAGES_c"
    (data,) = carried(bus, Network.DEPTH_NAN, [message.encode()], channel=channel)
    (found,) = lcmt_image_array.decode(data).images
    assert np.isnan(np.frombuffer(bytes(found.data), "<f4")).all() and found.size == 48


def test_those_who_work_for_a_controller_are_found_and_struck():
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    controller = subprocess.Popen([sys.executable, "-c", CONTROLLER], text=True, **pipes)
    try:
        pids = [int(word) for word in controller.stdout.readline().split()]
        assert workers_of(controller.pid) == pids
        pair._strike(controller, ProcessFault.KILL_WORKER, 3)
        deadline = time.monotonic() + 20.0
        while psutil.Process(pids[1]).status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert controller.poll() is None and psutil.pid_exists(pids[0])
    finally:
        controller.kill()
        controller.wait()


def test_a_controller_that_does_all_by_itself_has_no_workers():
    with pytest.raises(HardwareError, match="no process that perceives"):
        workers_of(os.getpid())


def test_a_network_in_a_process_of_its_own_begins_when_it_is_told_to():
    urls = ["udpm://239.255.76.69:7669?ttl=0", "udpm://239.255.76.70:7670?ttl=0"]
    try:
        cell, control = map(DrakeLcm, urls)
    except RuntimeError as error:
        pytest.skip(f"no multicast on this computer: {error}")
    came = []
    subscriptions = [control.Subscribe(name, came.append) for name in (IMAGES, STATUS)]
    relay = RelayProcess(*urls, Network.NO_IMAGES, seed=0)
    try:
        both = [b"image", b"status"]
        assert soon(lambda: passed(cell, control, came) == both)
        # What is sent at the same instant is not lost on the way.
        assert sum(passed(cell, control, came) == both for _ in range(20)) > 15
        relay.begin()
        assert soon(lambda: passed(cell, control, came) == [b"status"])
    finally:
        relay.close()
    del subscriptions


def passed(cell, control, came):
    """What gets through of an image and a status after it, within 0.2 s."""
    while control.HandleSubscriptions(0):
        pass
    came.clear()
    cell.Publish(IMAGES, b"image")
    cell.Publish(STATUS, b"status")
    while b"status" not in came and control.HandleSubscriptions(200):
        pass
    return list(came)


def soon(happens):
    deadline = time.monotonic() + 20.0
    while not happens():
        if time.monotonic() > deadline:
            return False
    return True


class Clock:
    """Time that passes where somebody sleeps or works."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now

    def sleep(self, duration):
        assert duration >= 0.0
        self.now += duration


def test_a_guard_alone_is_no_controller():
    """One that serves holds the arm; the scenario's time does not count before it is asked."""
    lcm, scenario = DrakeLcm("memq://"), Scenario(simulation_duration=3.0)
    now = SimpleNamespace(time=0.0, get_time=lambda: now.time)
    received = ReceivedCommands(lcm, now.get_time)
    handover = SimpleNamespace(
        GetOutputPort=lambda name: SimpleNamespace(Eval=lambda context: [0]),
        GetMyContextFromRoot=lambda context: context,
    )
    diagram = SimpleNamespace(GetSubsystemByName=lambda name: handover)
    ends = []
    monitor = cell_module._Monitor(diagram, scenario, received, lambda: False, StatusLine(), 1e6)
    monitor._end = lambda error: ends.append((now.time, error))
    for k in range(1, 2000):
        now.time = 0.005 * k
        lcm.Publish(channels.IIWA_COMMAND, command(5000 * k, np.zeros(7)))
        if now.time > 5.0:
            lcm.Publish(channels.IIWA_REQUEST, command(5000 * k, np.zeros(7)))
        while lcm.HandleSubscriptions(0):
            pass
        if not ends:
            monitor(now)
    assert ends == [(pytest.approx(8.0, abs=0.1), None)]


def test_a_status_that_was_sent_late_leaves_time_for_its_answer(monkeypatch):
    clock, cell = Clock(), SimpleNamespace(GetSubsystemByName=lambda name: None)
    monkeypatch.setattr(cell_module, "time", clock)
    monitor = cell_module._Monitor(cell, Scenario(), None, None, StatusLine(), 0.5)
    sent, period = [], channels.IIWA_PERIOD / 0.5
    for k, work in enumerate([0.0, 1e-3, 1e-3, 2.5 * period, 1e-3, 1e-3], start=1):
        clock.now += work  # the simulation's, before the status of this tick is sent
        sent.append(clock.now)
        monitor._pace(k * channels.IIWA_PERIOD)
    gaps = np.diff(sent)
    np.testing.assert_allclose(gaps[[1, 4]], period, atol=1e-3)
    assert gaps[2] == pytest.approx(2.5 * period + period - 1e-3, abs=1.5e-3)  # it was late itself
    assert gaps[3] >= 0.5 * period
