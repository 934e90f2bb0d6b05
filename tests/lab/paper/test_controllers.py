"""What all controllers that enforce nothing promise."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator

from feasigrasp.models.control.safety.safe_velocity import SafetyFilter
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp_lab.baselines.nearest_grasp_controller import NearestGraspController
from feasigrasp_lab.paper.modes import (
    PaperJointController,
    PaperTaskController,
    Unenforced,
    UnenforcedDrive,
)
from feasigrasp_lab.paper.options import PaperOptions
from tests.controller_bench import HOME, NEAR, REACH, UNKNOWN, Bench


class FreeNearestGrasp(Unenforced, NearestGraspController):
    """The baseline with nothing enforced."""


#: Controllers that enforce nothing, and those that follow the same grasps in safe mode.
PAIRS = [
    (PaperTaskController, RMMTaskController),
    (PaperJointController, GPJointController),
    (FreeNearestGrasp, NearestGraspController),
]
free = pytest.mark.parametrize("make", [pair[0] for pair in PAIRS])


@free
def test_ports_are_those_of_all_controllers(make, ports):
    assert ports(make(REACH)) == ports(RMMTaskController(REACH))


@pytest.mark.parametrize(("make", "safe"), PAIRS)
def test_nothing_is_enforced(make, safe):
    """The same state near a limit: the paper's law goes on, the safe one does not."""
    q = HOME.copy()
    q[5] = IIWA_7.upper[5] - 0.011
    spin = SpatialVelocity([0.0, -6.0, 0.0], [0.0, 0.0, 0.0])
    qd, kept = (Bench(each, q=q, velocity=spin).command() for each in (make, safe))
    lower, upper = SafetyFilter().problem(q, np.zeros(7))[1][:2, :7]
    assert np.all((lower - 1e-9 <= kept) & (kept <= upper + 1e-9))
    assert np.isfinite(qd).all()
    assert np.any((qd > upper) | (qd < lower))


@free
@pytest.mark.parametrize(
    "lost",
    [{"pose": UNKNOWN}, {"velocity": SpatialVelocity(np.full(6, np.nan))}],
    ids=["pose unknown", "twist unknown"],
)
def test_the_arm_stops_when_the_object_is_unknown(make, lost):
    np.testing.assert_array_equal(Bench(make, **lost).command(), np.zeros(7))


@free
def test_no_field_is_looked_at(make):
    bench = Bench(make)
    qd = bench.command()
    bench.fix(gpdf=Value[object](fit_gpdf(sphere_points(400, 0.03))))
    np.testing.assert_array_equal(bench.command(), qd)


def test_a_hand_that_is_pushed_goes_on():
    J = pose_and_jacobian(HOME, REACH.gripper.X_FG)[1]

    class Pressing(Unenforced, GraspController):
        def update(self, memory, inputs):
            return memory

        def velocity(self, memory, inputs):
            return self.enforced(np.linalg.pinv(J[3:]) @ [0.0, -0.05, 0.0], inputs)

    bench = Bench(Pressing)
    bench.fix(touch=J[3:].T @ [0.0, 30.0, 0.0])
    np.testing.assert_allclose(J[3:] @ bench.command(), [0.0, -0.05, 0.0], atol=1e-6)


def test_the_paper_law_moves_the_hand_with_the_commanded_twist():
    """One grasp: the twist is that of the geodesic to it, plus the object's own, J qd = V."""
    X_WO = NEAR
    X_WH, J = pose_and_jacobian(HOME, REACH.gripper.X_FG)
    # The grasp lies 1 cm ahead of the hand, along its approach direction, without rotation.
    X_WG = X_WH @ RigidTransform([0.0, 0.0, 0.01]).GetAsMatrix4()
    grasps = GraspSet((X_WO.inverse().GetAsMatrix4() @ X_WG)[None], np.array([0.04]), np.ones(1))
    V_WO = np.array([0.1, -0.2, 0.15, 0.05, 0.02, -0.03])
    options = PaperOptions(gain=3.0, damping=0.0)
    bench = Bench(
        PaperTaskController, grasps=grasps, velocity=SpatialVelocity(V_WO), options=options
    )
    qd = bench.command()
    lever = X_WH[:3, 3] - X_WO.translation()
    expected = np.r_[V_WO[:3], V_WO[3:] + np.cross(V_WO[:3], lever) + 3.0 * 0.01 * X_WH[:3, 2]]
    np.testing.assert_allclose(J @ qd, expected, atol=1e-9)
    # Finite differences of the forward kinematics say the same.
    step = 1e-6
    moved = forward_kinematics(HOME + step * qd, REACH.gripper.X_FG)
    np.testing.assert_allclose((moved - X_WH)[:3, 3] / step, expected[3:], atol=1e-5)


def test_without_limits_a_command_is_integrated_as_it_comes():
    drive = UnenforcedDrive(0.005)
    simulator = Simulator(drive)
    context = simulator.get_mutable_context()
    start = np.full(7, 30.0)
    drive.GetInputPort("position").FixValue(context, start)
    command = np.array([1e3, -50.0, 0.1, 0.0, 2.0, -3.0, 400.0])
    drive.GetInputPort("velocity").FixValue(context, command)
    simulator.AdvanceTo(0.007)
    desired = drive.GetOutputPort("desired_state").Eval(context)
    np.testing.assert_allclose(desired[7:], command)
    np.testing.assert_allclose(desired[:7], start + 0.01 * command)
    drive.GetInputPort("velocity").FixValue(context, np.r_[command[:6], np.nan])
    simulator.AdvanceTo(0.012)
    np.testing.assert_allclose(drive.GetOutputPort("desired_state").Eval(context)[:7], desired[:7])
    assert drive.GetOutputPort("command_faults").Eval(context)[0] == 3.0
