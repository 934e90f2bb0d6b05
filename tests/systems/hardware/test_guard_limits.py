"""What a driver holds keeps the limits: other rates, lost messages, clocks that are set, rivals.

Judged by the positions that the driver of `Rig` holds.
"""

import signal

import numpy as np
import pytest

from feasigrasp.errors import HardwareError
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp.systems.hardware import channels, guard
from feasigrasp.systems.hardware.guard import GuardedCell
from tests.driver_rig import PERIODS, START, Rig, cases


def far(rig):
    """Always 0.2 rad ahead."""
    rig.ticks(0.31, 0.0)
    for _ in range(round(0.5 / rig.T)):
        rig.asked = rig.q + 0.2 * np.eye(7)[0]
        rig.tick(0.0)


def step(rig):
    rig.ticks(0.31, 0.0)
    rig.asked = rig.asked + 0.2
    rig.ticks(0.5, 0.0)


def slow_controller(rig):
    """It asks every 5 ms."""
    rig.ticks(0.31, 0.0)
    every = max(1, round(0.005 / rig.T))
    for k in range(round(0.4 / rig.T)):
        if k % every == 0:
            rig.asked = rig.asked + min(1.0, k * rig.T * 5.0) * every * rig.T * np.eye(7)[0]
            rig.speed = 0.0
        rig.tick(0.0, asks=k % every == 0)


def smooth(rig):
    rig.moving()


@pytest.mark.parametrize("asked", [far, step, slow_controller, smooth])
@pytest.mark.parametrize("period", [0.001, 0.002, 0.004, 0.005, 0.010])
def test_at_every_rate(period, asked):
    rig = Rig(period)
    asked(rig)
    rig.rests()
    rig.keeps_limits()
    assert np.abs(rig.held[-1] - START).max() > 0.05


@pytest.mark.parametrize("period, asked, apart", [
    (0.015, smooth, 1.0), (0.020, far, 1.0), (0.050, far, 1.0), (0.0005, smooth, 1.0),
    (0.005, smooth, 0.2), (0.005, far, 0.4)])  # fmt: skip
def test_other_drivers_are_refused(period, asked, apart):
    """Of another period, or with stamps that time does not follow."""
    rig = Rig(period)
    rig.guard._clock = lambda: apart * rig.now
    rig.ticks(max(0.4, 0.4 / apart), 0.0)
    np.testing.assert_array_equal(rig.held[-1], START)
    with pytest.raises(HardwareError, match="IIWA_STATUS has (a period|stamps) .* ms"):
        rig.guard.serve()


@pytest.mark.parametrize(
    "period, arrival, stamps, seed",
    cases((0.0, 0.2, 0.4), (0.0, 0.1), (1, 2)) + cases((0.0, 0.1), (0.3,), (1, 2)),
)
def test_late_messages_and_stamps_with_noise(period, arrival, stamps, seed):
    rig = Rig(period, arrival, stamps, seed)
    rig.moving()
    rig.ticks(0.2)
    rig.rests()
    rig.keeps_limits()


STEPS = (0.001, 0.01, 0.05, 0.1, 0.24, 1.0, 60.0, 3600.0)


@pytest.mark.parametrize("follows", [True, False])
@pytest.mark.parametrize("period, by", cases([s * sign for s in STEPS for sign in (1, -1)]))
def test_a_clock_that_is_set_is_no_silence(period, by, follows):
    """Whether the controller's clock follows or not: the arm slows down at most."""
    rig = Rig(period)
    rig.moving()
    rig.offset += by
    if follows:
        rig.ticks(0.1)
        assert rig.guard._guard.received
    else:
        rig.ticks(0.1, asks=False)
    rig.rests()
    rig.keeps_limits()
    assert not rig.guard._error()


@pytest.mark.parametrize("period, seconds", cases((0.006, 0.01, 0.02, 0.05, 0.15, 0.24, 0.3, 2.0)))
@pytest.mark.parametrize("clock", [0.0, -0.1])
def test_after_a_gap_it_starts_from_rest(period, seconds, clock):
    """A guard that was stopped: the driver has held its position."""
    if clock and seconds < 4.5 * period:
        pytest.skip("a clock that is set while the computer is late: taken for the latter")
    rig = Rig(period)
    rig.moving()
    for _ in range(max(2, round(seconds / period))):
        rig.tick(stopped=True)
    since = len(rig.held)
    rig.offset += clock
    rig.speed, rig.asked = 0.0, rig.q.copy()
    rig.ticks(0.31, 0.0)
    rig.ticks(0.2)
    rig.keeps_limits(since, at_rest=True)
    assert np.abs(rig.held[-1] - rig.held[since]).max() > 0.02


@pytest.mark.parametrize("period, seconds", cases((0.002, 0.006, 0.01, 0.02, 0.05, 0.15, 2.0)))
@pytest.mark.parametrize("asks, arrival", [(True, 0.0), (True, 0.2), (False, 0.2), (True, 0.5)])
def test_where_statuses_are_lost_the_arm_does_not_stop_dead(period, seconds, asks, arrival):
    """It goes on as requested, or brakes: the driver receives the commands."""
    rig = Rig(period, arrival)
    rig.moving()
    for _ in range(3):
        before = rig.q[0]
        rig.ticks(max(period, seconds), lost=True, asks=asks)
        assert rig.q[0] > before or seconds > 0.2
        rig.asked = rig.q.copy()
        rig.ticks(0.2)
    rig.rests()
    rig.keeps_limits()


@pytest.mark.parametrize("period, share, seed", cases((0.1, 0.3), (1, 2)))
def test_single_statuses_that_are_lost_or_late_change_nothing(period, share, seed):
    rig = Rig(period, 0.2, seed=seed)
    rig.moving()
    for _ in range(round(0.5 / period)):
        rig.tick(lost=rig.rng.random() < share)
    v = np.diff(np.array(rig.held), axis=0)[-round(0.3 / period) :, 0] / period
    assert v.min() > 0.8
    rig.rests()
    rig.keeps_limits()


@pytest.mark.parametrize("period", PERIODS)
def test_a_driver_that_received_nothing_either_is_not_chased(period):
    """Neither its statuses nor the commands came through: it holds its position."""
    rig = Rig(period)
    rig.moving()
    q = rig.q.copy()
    for _ in range(round(0.03 / period)):
        rig.tick(lost=True)
        rig.q = q.copy()
    since = len(rig.held)
    rig.speed, rig.asked = 0.0, rig.q.copy()
    rig.ticks(0.31, 0.0)
    rig.keeps_limits(since, at_rest=True)


@pytest.mark.parametrize("period, copies, seed", cases((2, 3, 9), (1, 2)))
def test_copies_are_no_cycles(period, copies, seed):
    rig = Rig(period, arrival=0.2, seed=seed)
    rig.ticks(0.31, 0.0, copies=copies)
    rig.ticks(0.4, copies=copies)
    late = rig.status()
    rig.ticks(0.1, between=[(0.4, channels.IIWA_STATUS, late)])
    rig.rests()
    rig.keeps_limits()


FORGED = {
    "ahead": dict(ahead=0.2),
    "far-ahead": dict(ahead=1000.0),
    "behind": dict(ahead=-0.03),
    "soon": dict(ahead=1e-6),
    "elsewhere": dict(ahead=1e-6, q=START + 0.3),
    "far-elsewhere": dict(ahead=1e9, q=np.ones(7)),
    "huge": dict(ahead=9e12),
}


@pytest.mark.parametrize("period, kind, at", cases(FORGED, (0.1, 0.5)))
def test_forged_statuses(period, kind, at):
    rig = Rig(period)
    rig.moving()
    one = [(at, channels.IIWA_STATUS, lambda: rig.status(**FORGED[kind]))]
    for k in range(round(0.3 / period)):
        rig.tick(between=one if k % 20 == 0 else ())
    rig.rests()
    rig.keeps_limits()
    assert rig.guard._error() == ""


@pytest.mark.parametrize("period, at", cases((0.1, 0.5, 0.9)))
@pytest.mark.parametrize("moves", [True, False])
def test_a_rival_is_noticed(period, at, moves):
    """At once; the guard brakes, and ends with words."""
    rig = Rig(period)
    if moves:
        rig.moving()
    else:
        rig.ticks(0.4, 0.0)
    rig.tick(between=[(at, channels.IIWA_COMMAND, lambda: rig.request(rig.q + 1e-3))])
    since = len(rig.held)
    assert rig.guard._error()
    rig.q = rig.held[-1] + (rig.held[-1] - rig.held[-2])  # the rival's position is not counted
    rig.ticks(0.4)
    rig.keeps_limits(since)
    with pytest.raises(HardwareError, match="somebody commands this arm"):
        rig.guard.serve()


OFFSETS = (1e-4, 0.004, 0.1, 0.5, 3.0, -3.0, 1000.0)


@pytest.mark.parametrize("period, ahead", cases(OFFSETS))
def test_a_second_controller_is_noticed(period, ahead):
    rig = Rig(period)
    rig.moving()
    other = [(0.1, channels.IIWA_REQUEST, lambda: rig.request(START, ahead - 0.1 * period))]
    before = rig.cycle
    while not rig.guard._error():
        rig.tick(between=other)
        within = 0.02 if abs(ahead) > 0.1 or ahead < 1e-3 else ahead + 0.02
        assert (rig.cycle - before) * period <= within + 1e-9
    rig.rests()
    rig.keeps_limits()
    with pytest.raises(HardwareError, match="two controllers"):
        rig.guard.serve()


def forged_requests(rig):
    yield "ahead", rig.request(ahead=10.0)
    yield "behind", rig.request(ahead=-10.0)
    yield "nan", rig.request(np.full(7, np.nan))
    yield "inf", rig.request(np.full(7, np.inf))
    yield "far", rig.request(START + 3.0, 1e-3)
    yield "huge", rig.request(ahead=9e12)


@pytest.mark.parametrize("period, kind", cases(("ahead", "behind", "nan", "inf", "far", "huge")))
def test_single_forged_requests(period, kind):
    """They do not displace the controller that is served."""
    rig = Rig(period)
    since = rig.moving()
    forged = [(0.5, channels.IIWA_REQUEST, lambda: dict(forged_requests(rig))[kind])]
    for k in range(round(0.4 / period)):
        rig.tick(between=forged if k % round(0.1 / period) == 0 else ())
    assert rig.guard._error() == ""
    assert rig.held[-1][0] - rig.held[since][0] > 0.2
    rig.rests()
    rig.keeps_limits()


def malformed(data, rng):
    yield b""
    yield data[:7]
    yield data[: rng.integers(8, len(data))]
    yield data + b"\0"
    yield data[:16] + b"\x7f\xff\xff\xff" + data[20:]
    yield data[:16] + b"\xff\xff\xff\xff" + data[20:]
    yield bytes(rng.integers(0, 256, len(data), dtype=np.uint8))
    changed = bytearray(data)
    for at in rng.integers(8, len(data), 6):
        changed[at] = rng.integers(0, 256)
    yield bytes(changed)


@pytest.mark.parametrize("channel", [channels.IIWA_STATUS, channels.IIWA_REQUEST])
@pytest.mark.parametrize("period, kind, seed", cases(range(8), (1, 2)))
def test_malformed_messages(period, kind, seed, channel):
    rig = Rig(period)
    rig.moving()
    rng = np.random.default_rng(seed)
    status = channel == channels.IIWA_STATUS

    def message():
        return list(malformed(rig.status() if status else rig.request(ahead=1e-3), rng))[kind]

    for k in range(round(0.2 / period)):
        rig.tick(between=[(0.5, channel, message)] if k % 10 == 0 else ())
    rig.rests()
    rig.keeps_limits()
    if kind < 6:
        assert rig.guard.dropped[channel] >= 2


@pytest.mark.parametrize("alone", [True, False])
def test_every_signal_that_ends_a_process_ends_it_at_rest(monkeypatch, alone):
    """The arm rests first; one that a controller started is out of reach of its terminal."""
    handlers, left = {}, []
    monkeypatch.setattr(guard, "_warm_up", lambda guard: None)
    monkeypatch.setattr(guard.Guard, "serve", lambda self: None)
    monkeypatch.setattr(guard, "_start_standby", lambda *given: None)
    monkeypatch.setattr(guard.signal, "signal", handlers.__setitem__)
    monkeypatch.setattr(guard.os, "setsid", lambda: left.append(True))
    cell = GuardedCell(SafetyOptions(), WSG_50, None)
    guard.main("memq://", lambda: None, cell, alone=alone)
    assert left == [True] * (not alone)
    for name in ("HUP", "QUIT", "TERM", "TSTP", "USR1", "USR2", "ALRM", "ABRT", "VTALRM", "PROF"):
        assert handlers[getattr(signal, f"SIG{name}")].__name__ == "end", name
    assert (handlers[signal.SIGINT] == signal.SIG_IGN) is not alone
    assert not {signal.SIGKILL, signal.SIGSTOP, signal.SIGCHLD, signal.SIGWINCH} & set(handlers)


@pytest.mark.parametrize("period", PERIODS)
def test_one_that_ends_brakes(period):
    rig = Rig(period)
    rig.moving()
    rig.guard.end()
    rig.ticks(0.4)
    assert not rig.guard._guard.moving
    rig.keeps_limits()
    rig.guard.serve()
