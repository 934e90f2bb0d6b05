"""A standby brakes the arm where the guard is stopped or killed; the driver's positions are judged.

Guard and standby are on buses of their own, between which messages are carried: one that is stopped
receives what has come meanwhile when it goes on.
"""

import numpy as np
import pytest
from drake import lcmt_iiwa_command
from pydrake.lcm import DrakeLcm

from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.guard import Guard, Standby
from tests.driver_rig import START, Rig, cases


class Pair(Rig):
    """Driver, controller, guard and standby."""

    def __init__(self, period):
        super().__init__(period)
        self.guard = Guard(self.lcm, clock=lambda: self.now, backed=True)
        self.other = DrakeLcm("memq://")
        self.standby = Standby(self.other, clock=lambda: self.now)
        channels.subscribe(self.other, channels.IIWA_COMMAND, self.take_over)
        channels.subscribe(self.other, channels.IIWA_STANDBY, self.announce)
        self.carried, self.waiting, self.taken = set(), [], 0

    def command(self, data):
        super().command(data)
        if data not in self.carried:
            self.carried.add(data)
            self.other.Publish(channels.IIWA_COMMAND, data)

    def take_over(self, data):
        if data not in self.carried:
            self.taken += 1
            self.carried.add(data)
            self.q = np.array(lcmt_iiwa_command.decode(data).joint_position)
            self.waiting.append((channels.IIWA_COMMAND, data))

    def announce(self, data):
        self.waiting.append((channels.IIWA_STANDBY, data))

    def pump(self):
        while self.lcm.HandleSubscriptions(0) or self.other.HandleSubscriptions(0):
            pass

    def cycle_with(self, stopped, speed=1.0):
        """One cycle; the guard is stopped from a share of it until another, (0, 0) for never."""
        self.held.append(self.q.copy())
        self.cycle += 1
        begin = self.now = self.cycle * self.T
        self.speed += np.clip(speed - self.speed, -5.0 * self.T, 5.0 * self.T)
        self.asked = self.asked + self.speed * self.T * np.eye(7)[0]
        status = self.status()
        self.waiting += [(channels.IIWA_STATUS, status), (channels.IIWA_REQUEST, self.request())]
        self.other.Publish(channels.IIWA_STATUS, status)
        for share in np.arange(0.0, 0.999, 0.1):
            self.now = begin + share * self.T
            if not stopped[0] - 1e-6 <= share < stopped[1] - 1e-6:
                waiting, self.waiting = self.waiting, []
                for channel, data in waiting:
                    self.lcm.Publish(channel, data)
                self.pump()
                self.guard.coast()
            self.pump()
            self.standby.coast()
            self.pump()

    def start(self):
        for k in range(round(0.62 / self.T)):
            self.cycle_with((0, 0), speed=float(k * self.T > 0.31))
        assert self.q[0] - self.held[-1][0] > 0.9 * self.T and self.taken == 0


@pytest.mark.parametrize("period, seconds, share", cases((0.01, 0.05, 0.3), (0.0, 0.5)))
def test_a_guard_that_is_stopped(period, seconds, share):
    """The arm brakes within its limits, and goes on from rest when the guard is back."""
    rig = Pair(period)
    rig.start()
    rig.cycle_with((share, 1))
    for _ in range(round(seconds / period)):
        rig.cycle_with((0, 1))
    rig.cycle_with((0, share))
    while rig.guard._gave_way:
        rig.cycle_with((0, 0))
    rested, count = rig.q.copy(), rig.taken
    rig.asked, rig.speed = rested.copy(), 0.0
    for _ in range(round(0.7 / period)):
        rig.cycle_with((0, 0))
    rig.keeps_limits()
    assert 0 < count == rig.taken
    assert rig.q[0] - rested[0] > 0.03
    assert rig.guard._error() == ""


@pytest.mark.parametrize("period", [0.001, 0.002, 0.005, 0.010])
def test_a_guard_that_is_killed(period):
    rig = Pair(period)
    rig.start()
    assert rig.standby._in_charge()  # it goes on without the guard
    for _ in range(round(0.5 / period)):
        rig.cycle_with((0, 1))
    rig.keeps_limits()
    np.testing.assert_array_equal(rig.held[-1], rig.held[-2])
    assert rig.q[0] - START[0] > 0.05
    assert not rig.standby._in_charge()


@pytest.mark.parametrize("period", [0.002, 0.005])
def test_a_guard_that_is_held_up_between_two_statuses_keeps_the_arm(period):
    """It is stopped for 0.9 cycles, but answers each status within 0.4 of one."""
    rig = Pair(period)
    rig.start()
    for k in range(90):
        rig.cycle_with(((0, 0), (0.5, 1), (0, 0.4))[k % 3])
    assert rig.taken == 0 and not rig.guard._gave_way
    assert rig.q[0] - rig.held[-1][0] > 0.9 * rig.T
    rig.keeps_limits()


def test_a_standby_that_is_held_up_looks_at_the_bus_before_it_takes_over():
    """The guard has answered in time; that command waits while the standby does not run."""
    rig = Pair(0.005)
    rig.start()
    rig.cycle += 1
    rig.now = rig.cycle * rig.T
    status = rig.status()
    rig.other.Publish(channels.IIWA_STATUS, status)
    rig.other.HandleSubscriptions(0)
    rig.lcm.Publish(channels.IIWA_STATUS, status)
    while rig.lcm.HandleSubscriptions(0):
        pass
    rig.now += 0.9 * rig.T
    rig.standby.coast()
    rig.pump()
    assert rig.taken == 0 and not rig.standby._in_place


@pytest.mark.parametrize("lasts", [0.1, 0.3])
def test_a_guard_that_answers_in_time_keeps_the_arm(lasts):
    rig = Pair(0.005)
    rig.start()
    for k in range(60):
        rig.cycle_with((0, lasts if k % 3 == 0 else 0))
    assert rig.taken == 0
    assert rig.q[0] - rig.held[-1][0] > 0.9 * rig.T
