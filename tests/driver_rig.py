"""An arm's driver with cycles of its own, a controller and a guard, for the tests of guards.

In each cycle the driver holds the newest command. Accelerations and velocities are those of the
positions held, from cycle to cycle, whatever the stamps say.
"""

import itertools

import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.lcm import DrakeLcm

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware import channels, guard

V, A = np.array(IIWA_7.velocity_limits), np.array(IIWA_7.acceleration_limits)
START = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0])
PERIODS = (0.001, 0.002, 0.005)


class Rig:
    """Driver, controller and guard on a bus; time passes in cycles of the driver."""

    def __init__(self, period, arrival=0.0, stamps=0.0, seed=0):
        self.T, self.arrival, self.noise = period, arrival, stamps
        self.rng = np.random.default_rng(seed)
        self.lcm, self.now, self.offset = DrakeLcm("memq://"), 0.0, 1e5
        self.q, self.asked, self.speed = START.copy(), START.copy(), 0.0
        self.held, self.cycle, self.behind = [START.copy()], 0, 0.0
        self.guard = guard.Guard(self.lcm, clock=lambda: self.now + self.behind)
        channels.subscribe(self.lcm, channels.IIWA_COMMAND, self.command)

    def command(self, data):
        self.q = np.array(lcmt_iiwa_command.decode(data).joint_position)

    def pump(self):
        while self.lcm.HandleSubscriptions(0):
            pass

    def status(self, ahead=0.0, q=None):
        message = lcmt_iiwa_status()
        message.utime, message.num_joints = round(1e6 * (self.now + self.offset + ahead)), 7
        for name in message.__slots__[2:]:
            setattr(message, name, [0.0] * 7)
        q = self.q if q is None else q
        message.joint_position_measured = message.joint_position_commanded = list(q)
        return message.encode()

    def send(self, channel, *messages):
        for message in messages:
            self.lcm.Publish(channel, message)
            self.pump()

    def request(self, q=None, ahead=0.0):
        message = lcmt_iiwa_command()
        message.utime = round(1e6 * (self.now + self.offset + ahead))
        message.num_joints, message.joint_position = 7, list(self.asked if q is None else q)
        return message.encode()

    def tick(self, speed=1.0, *, lost=False, stopped=False, copies=1, between=(), asks=True):
        """One cycle: the driver holds what has come, and sends a status.

        Args:
            speed: That the controller takes joint 0 to [rad/s].
            lost: Whether the status is lost.
            stopped: Whether the guard is stopped; its messages are lost.
            copies: Of the status.
            between: Share of the cycle, channel and message of what others send in it.
            asks: Whether the controller requests a position.
        """
        self.held.append(self.q.copy())
        self.cycle += 1
        begin = self.cycle * self.T
        self.now = begin
        data = self.status(ahead=self.T * self.noise * self.rng.uniform(-1, 1))
        self.behind = self.T * self.arrival * self.rng.uniform(0, 1)
        if not lost and not stopped:
            self.send(channels.IIWA_STATUS, *[data] * copies)
        if asks:
            change = np.clip(speed - self.speed, -5.0 * self.T, 5.0 * self.T)
            self.speed += change
            self.asked = self.asked + self.speed * self.T * np.eye(7)[0]
            self.send(channels.IIWA_REQUEST, self.request())
        self.behind = 0.0
        looks = 0.0 if stopped else self.rng.uniform(0.05, 0.15)
        missing = [(k * looks, None, None) for k in range(1, int(looks and 0.999 / looks) + 1)]
        for share, channel, message in sorted([*between, *missing], key=lambda event: event[0]):
            self.now = begin + share * self.T
            if channel is None:
                self.guard.coast()
                self.pump()
            else:
                self.send(channel, message() if callable(message) else message)

    def ticks(self, seconds, speed=1.0, **how):
        for _ in range(round(seconds / self.T)):
            self.tick(speed, **how)

    def moving(self):
        """At 1 rad/s."""
        self.ticks(0.31, 0.0)
        self.ticks(0.3)
        assert np.abs(self.q - self.held[-1])[0] > 0.9 * self.T
        return len(self.held)

    def keeps_limits(self, since=0, at_rest=False):
        """From a cycle on; ``at_rest`` if its velocity is that of a stop that is not counted."""
        v = np.diff(np.array(self.held[since:]), axis=0) / self.T
        if at_rest:
            v = np.vstack([np.zeros(7), v])
        a = np.diff(v, axis=0) / self.T
        assert (np.abs(v) <= V * (1 + 1e-6)).all(), f"v {100 * (np.abs(v) / V).max():.0f} %"
        assert (np.abs(a) <= A * (1 + 1e-6)).all(), f"a {100 * (np.abs(a) / A).max():.0f} %"

    def rests(self):
        """Brakes and stays."""
        self.ticks(0.4, asks=False)
        np.testing.assert_array_equal(self.held[-1], self.held[-3])


def case(period, *values):
    name = "-".join(f"{v:g}" if isinstance(v, float) else str(v) for v in values)
    return pytest.param(period, *values, id=f"{1e3 * period:g}ms-{name}")


def cases(*lists):
    """At every rate; at 1 kHz every third, which takes as long as the others."""
    others = [*itertools.product(*lists)]
    return [case(0.001, *v) for v in others[::3]] + [
        case(period, *v) for period in PERIODS[1:] for v in others
    ]
