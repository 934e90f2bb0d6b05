import runpy
from pathlib import Path

import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import PandaCommandReceiver, PandaControlMode, PandaStatusSender
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem

from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.bridge import Bridge, PandaDriver
from feasigrasp.systems.hardware.guard import Guard

EXAMPLE = Path(__file__).parents[3] / "examples" / "10_your_own_driver.py"
Q, V, TAU = np.linspace(-1, 1, 7), np.linspace(0, 0.6, 7), np.linspace(3, -3, 7)


def panda_status(utime):
    """A message as Drake's own sender makes it."""
    builder, lcm, sent = DiagramBuilder(), DrakeLcm("memq://"), []
    sender = builder.AddSystem(PandaStatusSender())
    publisher = LcmPublisherSystem.Make("S", lcmt_panda_status, lcm, use_cpp_serializer=True)
    builder.Connect(sender.get_output_port(), builder.AddSystem(publisher).get_input_port())
    lcm.Subscribe("S", sent.append)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    root.SetTime(1e-6 * utime)
    for port, value in {
        "position_commanded": Q + 0.1,
        "position_measured": Q,
        "velocity_measured": V,
        "torque_commanded": TAU + 1.0,
        "torque_external": TAU,
    }.items():
        sender.GetInputPort(port).FixValue(sender.GetMyContextFromRoot(root), value)
    diagram.ForcedPublish(root)
    lcm.HandleSubscriptions(0)
    return lcmt_panda_status.decode(sent[-1])


class Panda:
    """Franka's driver on a bus: keeps what it is commanded."""

    def __init__(self, lcm):
        self.lcm, self.commands = lcm, []
        lcm.Subscribe("PANDA_COMMAND", lambda data: self.commands.append(data))

    def say(self, utime):
        self.lcm.Publish("PANDA_STATUS", panda_status(utime).encode())


def test_a_pandas_states_and_commands_are_those_of_drake():
    lcm = DrakeLcm("memq://")
    panda, driver = Panda(lcm), PandaDriver(lcm=lcm)
    panda.say(3_000)
    status = driver.read()
    assert status.utime == 3_000 and status.num_joints == 7
    np.testing.assert_array_equal(status.joint_position_measured, Q)
    np.testing.assert_array_equal(status.joint_position_commanded, Q + 0.1)
    np.testing.assert_array_equal(status.joint_velocity_estimated, V)
    np.testing.assert_array_equal(status.joint_torque_external, TAU)
    assert lcmt_iiwa_status.decode(status.encode()).num_joints == 7
    driver.send(4_000, Q)
    lcm.HandleSubscriptions(0)
    command = lcmt_panda_command.decode(panda.commands[0])
    assert command.utime == 4_000
    builder = DiagramBuilder()
    make = LcmSubscriberSystem.Make
    subscriber = make("PANDA_COMMAND", lcmt_panda_command, lcm, use_cpp_serializer=True)
    receiver = builder.AddSystem(PandaCommandReceiver(7, PandaControlMode.kPosition))
    messages = builder.AddSystem(subscriber).get_output_port()
    builder.Connect(messages, receiver.GetInputPort("lcmt_panda_command"))
    simulator = Simulator(builder.Build())
    context = receiver.GetMyContextFromRoot(simulator.get_mutable_context())
    receiver.GetInputPort("position_measured").FixValue(context, np.zeros(7))
    driver.send(5_000, Q)
    lcm.HandleSubscriptions(0)
    simulator.AdvanceTo(0.01)
    np.testing.assert_array_equal(receiver.GetOutputPort("position").Eval(context), Q)


class Fast:
    """A driver at 1 kHz; in each cycle the arm is where it was last commanded to be."""

    def __init__(self, joints):
        self.q, self.held, self.cycle = np.zeros(joints), [], 0

    def read(self):
        self.cycle += 1
        self.held.append(self.q)
        status = lcmt_iiwa_status()
        status.utime, status.num_joints = 1_000 * self.cycle, len(self.q)
        for name in status.__slots__[2:]:
            setattr(status, name, [0.0] * len(self.q))
        status.joint_position_measured = status.joint_position_commanded = list(self.q)
        return status

    def send(self, utime, q):
        self.q = q


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_behind_a_driver_at_1_khz_the_guard_keeps_the_limits_in_its_cycles(name):
    lcm, arm = DrakeLcm("memq://"), load_arm(name)
    driver = Fast(arm.joints)
    bridge = Bridge(lcm, driver)
    guard = Guard(lcm, CommandGuard(0.005, arm=arm), clock=lambda: 1e-3 * driver.cycle)
    driver.q = 0.5 * (arm.lower + arm.upper)
    asked, start = driver.q.copy(), driver.q.copy()
    for k in range(1500):
        bridge.step()
        while lcm.HandleSubscriptions(0):
            pass
        if k > 300:
            asked[0] += 0.001 * min(1.0, 0.005 * (k - 300)) * (k < 1000)
            request = lcmt_iiwa_command()
            request.utime, request.num_joints = 1_000 * driver.cycle, arm.joints
            request.joint_position = list(asked)
            lcm.Publish(channels.IIWA_REQUEST, request.encode())
    assert guard.dropped.total() == 0 and guard._guard.clock.period == pytest.approx(0.001)
    held = np.array(driver.held)
    v = np.diff(held, axis=0) / 0.001
    a = np.diff(v, axis=0) / 0.001
    np.testing.assert_allclose(held[-1], asked, atol=1e-3)
    assert held[-1, 0] - start[0] > 0.5
    assert (np.abs(v) <= arm.velocity_limits * (1 + 1e-6)).all()
    assert (np.abs(a) <= arm.acceleration_limits * (1 + 1e-6)).all()


def test_messages_that_are_none_change_nothing_and_it_ends_when_the_arm_rests():
    lcm, driver = DrakeLcm("memq://"), Fast(7)
    bridge = Bridge(lcm, driver)
    command = lcmt_iiwa_command()
    command.num_joints, command.joint_position = 7, [0.1] * 7
    good = command.encode()
    command.joint_position = [np.nan] * 7
    other = lcmt_iiwa_command()
    other.num_joints, other.joint_position = 6, [0.5] * 6
    bridge.step()
    for data in (good, b"", good[:-4], command.encode(), other.encode(), good + b"more"):
        lcm.Publish(channels.IIWA_COMMAND, data)
        bridge.step()
    np.testing.assert_array_equal(driver.q, [0.1] * 7)

    def still_moving(utime, q):
        driver.q = q
        if driver.cycle < 100:
            command.joint_position = [1e-3 * driver.cycle] * 7
            lcm.Publish(channels.IIWA_COMMAND, command.encode())

    driver.send = still_moving
    bridge.step()
    bridge.end()
    bridge.serve()
    assert 110 < driver.cycle < 130


def test_a_pandas_malformed_states_are_none():
    lcm = DrakeLcm("memq://")
    driver, good = PandaDriver(lcm=lcm), panda_status(1_000).encode()
    for data in (b"", good[:-8], good + b"more", b"x" * 300):
        lcm.Publish("PANDA_STATUS", data)
        assert driver.read() is None
    lcm.Publish("PANDA_STATUS", good)
    assert driver.read().utime == 1_000


def test_the_driver_of_the_example_translates(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", [str(EXAMPLE), str(tmp_path / "picture.png")])
    UrDriver, StandIn = (runpy.run_path(str(EXAMPLE))[name] for name in ("UrDriver", "StandIn"))
    arm = StandIn()
    driver = UrDriver(arm, arm)
    for _ in range(60):
        driver.send(0, np.full(6, 0.3))
    state = lcmt_iiwa_status.decode(driver.read().encode())
    assert state.num_joints == 6 and state.utime == 120_000
    np.testing.assert_allclose(state.joint_position_measured, 0.3)


def test_what_is_no_state_is_not_passed_on():
    lcm = DrakeLcm("memq://")
    assert PandaDriver(lcm=lcm).read() is None
    assert lcmt_panda_status().num_joints == 0
