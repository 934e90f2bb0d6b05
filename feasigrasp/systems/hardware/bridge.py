"""Bridge between an arm's own driver and the messages that guard and controller exchange.

Those are drake-iiwa-driver's, with as many joints as the arm has, at the rate of its driver: the
guard answers every state with a step within the limits of that cycle (1 to 10 ms).
"""

from typing import Protocol

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcm

from feasigrasp.models.arrays import Array
from feasigrasp.plugins import load_plugin, plugins
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.channels import decode


class Driver(Protocol):
    """What a plugin of the kind ``drivers`` makes, given the URL of the message bus."""

    def read(self) -> lcmt_iiwa_status | None:
        """The arm's newest state, waited for; None without one in 0.1 s."""
        ...

    def send(self, utime: int, q: Array) -> None:
        """Commands positions (n,) [rad], in answer to the state of ``utime`` [us]."""
        ...


class PandaDriver:
    """Franka's arms behind drake-franka-driver in position mode: LCM at 1 kHz."""

    def __init__(self, url: str = channels.LCM_URL, lcm: DrakeLcm | None = None) -> None:
        """Listens on a bus: that of the URL, or the one given."""
        self._lcm, self._newest = lcm or channels.open_lcm(url), b""
        self._subscription = channels.subscribe(self._lcm, "PANDA_STATUS", self._receive)

    def _receive(self, data: bytes) -> None:
        self._newest = data

    def read(self) -> lcmt_iiwa_status | None:
        """See `Driver`."""
        self._newest = b""
        self._lcm.HandleSubscriptions(100)
        if not self._newest:
            return None
        given, status = decode(lcmt_panda_status, self._newest), lcmt_iiwa_status()
        if given is None:
            return None
        status.utime, status.num_joints = given.utime, given.num_joints
        status.joint_position_measured = given.joint_position
        status.joint_position_commanded = status.joint_position_ipo = given.joint_position_desired
        status.joint_velocity_estimated = given.joint_velocity
        status.joint_torque_measured = given.joint_torque
        status.joint_torque_commanded = given.joint_torque_desired
        status.joint_torque_external = given.joint_torque_external
        return status

    def send(self, utime: int, q: Array) -> None:
        """See `Driver`."""
        command = lcmt_panda_command()
        command.utime, command.num_joint_position, command.joint_position = utime, len(q), list(q)
        command.control_mode_expected = lcmt_panda_status.CONTROL_MODE_POSITION
        self._lcm.Publish("PANDA_COMMAND", command.encode())


def load_driver(name: str, url: str) -> Driver:
    """The driver of a name, `PandaDriver` for ``panda``."""
    return PandaDriver(url) if name == "panda" else load_plugin("drivers", name)(url)


def driver_names() -> list[str]:
    """Names that `load_driver` takes."""
    return ["panda", *plugins("drivers")]


class Bridge:
    """Passes states on to guard and controller, and the guard's commands to the arm."""

    def __init__(self, lcm: DrakeLcm, driver: Driver) -> None:
        self._lcm, self._driver = lcm, driver
        self._q, self._joints, self._rested, self._ended = np.zeros(0), 0, 0, False
        self._subscription = channels.subscribe(lcm, channels.IIWA_COMMAND, self._command)

    def serve(self) -> None:
        """Works until `end`, and then until the arm is commanded to rest."""
        # The arm rests where it was commanded the same position for 20 states.
        while not (self._ended and self._rested >= 20):
            self.step()

    def end(self, *_: object) -> None:
        """Ends the service as soon as the arm rests; nothing moves one whose driver is gone."""
        self._ended = True

    def step(self) -> None:
        """Waits for a state, and handles it."""
        status = self._driver.read()
        self._rested += 1
        if status is None:
            return
        self._joints = status.num_joints
        self._lcm.Publish(channels.IIWA_STATUS, status.encode())
        self._lcm.HandleSubscriptions(0)
        if len(self._q):
            self._driver.send(status.utime, self._q)

    def _command(self, data: bytes) -> None:
        command = decode(lcmt_iiwa_command, data, self._joints)
        if command is None:
            return
        q = np.array(command.joint_position)
        if not np.array_equal(q, self._q):
            self._q, self._rested = q, 0
