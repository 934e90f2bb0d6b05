import runpy
from pathlib import Path

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_panda_command, lcmt_panda_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import PandaCommandReceiver, PandaControlMode, PandaStatusSender
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem

from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.bridge import Bridge, PandaDriver

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


def test_commands_are_interpolated_and_states_thinned_out():
    lcm, outside = DrakeLcm("memq://"), DrakeLcm("memq://")
    panda, states = Panda(outside), []
    lcm.Subscribe(channels.IIWA_STATUS, lambda data: states.append(lcmt_iiwa_status.decode(data)))
    bridge = Bridge(lcm, PandaDriver(lcm=outside))
    for k in range(31):
        if k in (10, 20):
            command = lcmt_iiwa_command()
            command.num_joints, command.joint_position = 7, [*(Q + 0.01 * (k - 10))]
            lcm.Publish(channels.IIWA_COMMAND, command.encode())
        panda.say(1000 * k)
        bridge.step()
    outside.HandleSubscriptions(0)
    lcm.HandleSubscriptions(0)
    np.testing.assert_allclose(np.diff([state.utime for state in states]), [5000] * 6, atol=1)
    sent = np.array([lcmt_panda_command.decode(each).joint_position for each in panda.commands])
    np.testing.assert_allclose(sent[:10], np.tile(Q, (10, 1)))
    steps = np.diff(sent[:, 0])[9:]
    np.testing.assert_allclose(steps[:6].sum(), 0.1, atol=1e-4)
    assert (steps >= -1e-12).all() and steps.max() < 0.1 / 5 + 1e-4
    np.testing.assert_allclose(sent[-1], Q + 0.1)


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
