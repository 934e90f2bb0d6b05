"""Solutions are found at their rate, are admissible, and are followed in between."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator

from feasigrasp.models.control.joint.law import JointSpaceControl
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.systems.gp_joint_controller import GPJointController
from feasigrasp_lab.paper.controllers import PaperJointController

REACH = Reachability()
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
X_WO = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])


def fixed(dut, simulator, **inputs):
    context = simulator.get_mutable_context()
    for name, value in inputs.items():
        dut.GetInputPort(name).FixValue(context, value)
    return context


def grasp_ahead(distance):
    """A grasp ahead of the hand at HOME, along its approach direction."""
    X_WG = (
        forward_kinematics(HOME, REACH.gripper.X_FG)
        @ RigidTransform([0.0, 0.0, distance]).GetAsMatrix4()
    )
    return GraspSet((X_WO.inverse().GetAsMatrix4() @ X_WG)[None], np.array([0.04]), np.ones(1))


@pytest.mark.parametrize("period", [0.05, 0.1])
def test_solutions_are_found_exactly_once_per_period(monkeypatch, period):
    times, find = [], JointSpaceControl.update
    dut = GPJointController(REACH, period=period)
    simulator = Simulator(dut)
    context = fixed(
        dut,
        simulator,
        position=HOME,
        grasps=grasp_ahead(0.05),
        object_pose=X_WO,
        object_velocity=SpatialVelocity.Zero(),
    )

    def counting(*args):
        times.append(context.get_time())
        return find(*args)

    monkeypatch.setattr(JointSpaceControl, "update", counting)
    for k in range(1, 80):
        simulator.AdvanceTo(0.005 * k)
        dut.GetOutputPort("commanded_velocity").Eval(context)
    np.testing.assert_allclose(times, np.arange(0.0, 0.395, period), atol=1e-9)


def test_before_its_first_update_it_stops():
    dut = GPJointController(REACH)
    simulator = Simulator(dut)
    context = fixed(
        dut,
        simulator,
        position=HOME,
        grasps=grasp_ahead(0.05),
        object_pose=X_WO,
        object_velocity=SpatialVelocity.Zero(),
    )
    np.testing.assert_array_equal(
        dut.GetOutputPort("commanded_velocity").Eval(context), np.zeros(7)
    )


@pytest.mark.parametrize("make", [GPJointController, PaperJointController])
def test_it_heads_for_the_only_grasp(make):
    """The hand moves straight ahead: the solution nearest to HOME is near the straight line."""
    dut = make(REACH)
    simulator = Simulator(dut)
    context = fixed(
        dut,
        simulator,
        position=HOME,
        grasps=grasp_ahead(0.03),
        object_pose=X_WO,
        object_velocity=SpatialVelocity.Zero(),
    )
    simulator.AdvanceTo(0.001)
    qd = dut.GetOutputPort("commanded_velocity").Eval(context)
    before = forward_kinematics(HOME, REACH.gripper.X_FG)
    after = forward_kinematics(HOME + 1e-4 * qd, REACH.gripper.X_FG)
    direction = (after - before)[:3, 3]
    assert direction @ before[:3, 2] / np.linalg.norm(direction) > 0.95


def test_solutions_follow_the_object_between_updates():
    """Moving everything by a twist changes the command by the twist's joint velocity alone."""
    dut = GPJointController(REACH, period=10.0)
    simulator = Simulator(dut)
    at_grasp = grasp_ahead(0.0)
    speed = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
    context = fixed(
        dut,
        simulator,
        position=HOME,
        grasps=at_grasp,
        object_pose=X_WO,
        object_velocity=SpatialVelocity(speed),
    )
    q = HOME.copy()
    simulator.AdvanceTo(0.001)
    # Two seconds: the object moves 10 cm, the arm with it, and into the configuration it prefers.
    for k in range(1, 401):
        moved = RigidTransform(X_WO.rotation(), X_WO.translation() + speed[3:] * 0.005 * k)
        q = q + 0.005 * dut.GetOutputPort("commanded_velocity").Eval(context)
        fixed(dut, simulator, position=q, object_pose=moved)
    hand = forward_kinematics(q, REACH.gripper.X_FG)
    target = moved.GetAsMatrix4() @ at_grasp.X_OG[0]
    assert np.linalg.norm((hand - target)[:3, 3]) < 0.002
    assert np.linalg.norm(hand[:3, 3] - forward_kinematics(HOME, REACH.gripper.X_FG)[:3, 3]) > 0.09
