"""Touches are noticed while the hand approaches, and the controller gives way to them."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.monitoring.contact_sense import ContactSense

Q = np.array([0.1, -0.7, 0.1, -1.6, 0.1, 1.4, 0.1])
REACH = Reachability()
J = pose_and_jacobian(Q, REACH.gripper.X_FG)[1]
PUSH = J[3:].T @ np.array([0.0, 12.0, 0.0])


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(ContactSense(0.002))
    assert (list(inputs), list(outputs)) == documented_ports(ContactSense)


@pytest.mark.parametrize(("phase", "noticed"), [(Phase.APPROACH, 1), (Phase.CLOSE, 0)])
def test_a_push_is_noticed_on_the_way_and_not_when_fingers_close(phase, noticed):
    simulator = Simulator(ContactSense(0.002))
    dut, context = simulator.get_system(), simulator.get_mutable_context()
    dut.GetInputPort("phase").FixValue(context, [float(phase)])
    torque = dut.GetInputPort("torque_external").FixValue(context, np.zeros(7))
    simulator.AdvanceTo(0.1)
    torque.GetMutableData().get_mutable_value().SetFromVector(PUSH)
    simulator.AdvanceTo(0.2)
    assert dut.GetOutputPort("touches").Eval(context)[0] == noticed
    assert dut.GetOutputPort("touch").Eval(context).any() == noticed


class Pressing(GraspController):
    """Wants the hand to move along -y, whatever is there."""

    def update(self, memory, inputs):
        return memory

    def velocity(self, memory, inputs):
        return self.enforced(np.linalg.pinv(J[3:]) @ [0.0, -0.05, 0.0], inputs)


def test_a_hand_that_is_pushed_back_goes_back():
    dut = Pressing(REACH)
    context = dut.CreateDefaultContext()
    dut.GetInputPort("position").FixValue(context, Q)
    dut.GetInputPort("object_pose").FixValue(context, AbstractValue.Make(RigidTransform()))
    command = dut.GetOutputPort("commanded_velocity")
    free = J[3:] @ command.Eval(context)
    np.testing.assert_allclose(free, [0.0, -0.05, 0.0], atol=1e-6)
    dut.GetInputPort("touch").FixValue(context, PUSH)
    pushed = J[3:] @ command.Eval(context)
    assert pushed[1] == pytest.approx(0.1, abs=1e-6)
