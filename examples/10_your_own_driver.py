"""A driver of one's own, a plugin of the kind ``drivers``: a UR arm by RTDE, untried on one."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drake import lcmt_iiwa_status

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/10_your_own_driver.png")
RATE = 500.0  # [Hz]


class UrDriver:
    """A `feasigrasp.systems.hardware.bridge.Driver`."""

    def __init__(self, receive, control):
        self._receive, self._control = receive, control

    def read(self):  # what drake-iiwa-driver would send
        status = lcmt_iiwa_status()
        status.num_joints, status.utime = 6, round(1e6 * self._receive.getTimestamp())
        status.joint_position_measured = self._receive.getActualQ()
        status.joint_velocity_estimated = self._receive.getActualQd()
        status.joint_position_commanded = status.joint_position_ipo = self._receive.getTargetQ()
        status.joint_torque_measured = status.joint_torque_commanded = [0.0] * 6
        status.joint_torque_external = [0.0] * 6  # not measured: contact is not sensed
        return status

    def send(self, utime, q):
        self._control.servoJ(q.tolist(), 0.0, 0.0, 1.0 / RATE, 0.03, 300)


def make_driver(lcm_url, address="192.168.1.10"):
    """What the entry point names."""
    import rtde_control  # type: ignore[import-not-found]
    import rtde_receive  # type: ignore[import-not-found]

    receive = rtde_receive.RTDEReceiveInterface(address, RATE)
    return UrDriver(receive, rtde_control.RTDEControlInterface(address))


class StandIn:
    """Goes half of the way to a command in every cycle."""

    q, cycles = np.zeros(6), 0

    def servoJ(self, q, *_):  # noqa: N802 - the name of ur-rtde
        self.cycles, self.q = self.cycles + 1, 0.5 * (self.q + np.array(q))

    def __getattr__(self, name):
        now = {"getTimestamp": self.cycles / RATE, "getActualQd": [0.0] * 6}
        return lambda: now.get(name, list(self.q))


driver = UrDriver(*2 * [StandIn()])
sent, measured = 0.3 * np.sin(0.02 * np.arange(250)), []
for angle in sent:
    driver.send(0, np.full(6, angle))
    measured.append(driver.read().joint_position_measured[0])
plt.plot(np.transpose([sent, measured]), label=["sent", "measured"])
print(f"joint 1 is sent to {max(sent):.3f} rad,\nand goes to {max(measured):.3f} rad")
plt.legend()
picture.parent.mkdir(parents=True, exist_ok=True)
plt.savefig(picture)
