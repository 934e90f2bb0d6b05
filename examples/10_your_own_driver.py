"""A driver of one's own: a Universal Robots arm by RTDE, here with a stand-in; untried on an arm.

With ``ur-rtde`` and the entry point ``ur`` of the group ``feasigrasp.drivers`` for `make_driver`,
``feasigrasp driver ur`` serves the arm.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drake import lcmt_iiwa_status

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/10_your_own_driver.png")
ADDRESS, RATE = "192.168.1.10", 500.0  # of the arm; [Hz]


class UrDriver:
    """What `feasigrasp.systems.hardware.bridge.Driver` asks for."""

    def __init__(self, receive, control):
        self._receive, self._control = receive, control

    def read(self):  # what drake-iiwa-driver would send
        status = lcmt_iiwa_status()
        status.num_joints, status.utime = 6, round(1e6 * self._receive.getTimestamp())
        status.joint_position_measured = self._receive.getActualQ()
        status.joint_velocity_estimated = self._receive.getActualQd()
        status.joint_position_commanded = status.joint_position_ipo = self._receive.getTargetQ()
        for name in ("measured", "commanded", "external"):
            setattr(status, f"joint_torque_{name}", [0.0] * 6)  # not measured
        return status

    def send(self, utime, q):
        self._control.servoJ(q.tolist(), 0.0, 0.0, 1.0 / RATE, 0.03, 300)


def make_driver(lcm_url):
    """What the entry point names."""
    from rtde_control import RTDEControlInterface
    from rtde_receive import RTDEReceiveInterface

    return UrDriver(RTDEReceiveInterface(ADDRESS, RATE), RTDEControlInterface(ADDRESS))


class StandIn:
    """An arm that goes half of the way to a command in every cycle."""

    q, cycles = np.zeros(6), 0

    def servoJ(self, q, *_):  # noqa: N802 - the name of ur-rtde
        self.cycles, self.q = self.cycles + 1, 0.5 * (self.q + np.array(q))

    def __getattr__(self, name):
        now = {"getTimestamp": self.cycles / RATE, "getActualQd": [0.0] * 6}
        return lambda: now.get(name, list(self.q))


arm = StandIn()
driver, sent, measured = UrDriver(arm, arm), 0.3 * np.sin(0.02 * np.arange(250)), []
for angle in sent:
    driver.send(0, np.full(6, angle))
    measured.append(driver.read().joint_position_measured[0])
for name, values in {"sent": sent, "measured": measured}.items():
    plt.plot(values, label=name)
    print(f"{name}: up to {max(values):.3f} rad")
plt.legend(title="joint 1 [rad], by cycle")
picture.parent.mkdir(parents=True, exist_ok=True)
plt.savefig(picture)
