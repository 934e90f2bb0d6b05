"""The mixture is fitted once per grasp set, and the paper's law is the paper's law."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity

from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.iiwa_kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.reachability import Reachability
from feasigrasp.models.task_space_control import TaskControlOptions
from feasigrasp.systems import rmm_task_controller
from feasigrasp.systems.rmm_task_controller import RMMTaskController

REACH = Reachability()
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
X_WO = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])


def grasps_near(X_OG, n=20, seed=0):
    """Grasps scattered about a pose."""
    rng = np.random.default_rng(seed)
    poses = [
        X_OG
        @ RigidTransform(
            RollPitchYaw(rng.normal(scale=0.1, size=3)), rng.normal(scale=0.01, size=3)
        ).GetAsMatrix4()
        for _ in range(n)
    ]
    return GraspSet(np.array(poses), np.full(n, 0.04), np.ones(n))


def test_the_mixture_is_fitted_once_per_grasp_set(fixed_context, monkeypatch):
    fits, fit = [], rmm_task_controller.fit_grasp_mixture

    def counting(grasps, *args):
        fits.append(grasps)
        return fit(grasps, *args)

    monkeypatch.setattr(rmm_task_controller, "fit_grasp_mixture", counting)
    dut = RMMTaskController(REACH)
    fits.clear()  # one step when it is made, to compile its kernels
    first, second = grasps_near(np.eye(4)), grasps_near(np.eye(4), seed=1)
    still = SpatialVelocity.Zero()
    context = fixed_context(
        dut, position=HOME, grasps=first, object_pose=X_WO, object_velocity=still
    )
    output = dut.get_output_port()
    for k in range(20):
        dut.GetInputPort("position").FixValue(context, HOME + 0.01 * k)
        moved = RigidTransform(X_WO.rotation(), X_WO.translation() + [0.0, 0.01 * k, 0.0])
        dut.GetInputPort("object_pose").FixValue(context, moved)
        output.Eval(context)
    assert [id(g) for g in fits] == [id(first)]
    dut.GetInputPort("grasps").FixValue(context, second)
    output.Eval(context)
    output.Eval(context)
    assert [id(g) for g in fits] == [id(first), id(second)]
    assert dut.mixture(context).X_OG is second.X_OG


def test_the_seed_decides_the_mixture(fixed_context):
    def means(seed):
        dut = RMMTaskController(REACH, seed=seed)
        mixture = dut.mixture(fixed_context(dut, grasps=grasps_near(np.eye(4), 60)))
        return mixture.mixture.means

    np.testing.assert_array_equal(means(1), means(1))
    assert means(1).shape != means(2).shape or np.abs(means(1) - means(2)).max() > 1e-6


def test_without_grasps_there_is_no_mixture(fixed_context):
    dut = RMMTaskController(REACH)
    assert dut.mixture(fixed_context(dut, grasps=GraspSet.empty())) is None


def test_the_paper_law_moves_the_hand_with_the_commanded_twist(fixed_context):
    """One grasp: the twist is that of the geodesic to it, plus the object's own, J qd = V."""
    X_WH, J = pose_and_jacobian(HOME, REACH.gripper.X_FG)
    # The grasp lies 1 cm ahead of the hand, along its approach direction, without rotation.
    X_WG = X_WH @ RigidTransform([0.0, 0.0, 0.01]).GetAsMatrix4()
    grasps = GraspSet((X_WO.inverse().GetAsMatrix4() @ X_WG)[None], np.array([0.04]), np.ones(1))
    options = TaskControlOptions(gain=3.0)
    dut = RMMTaskController(REACH, options, mode="paper")
    V_WO = np.array([0.1, -0.2, 0.15, 0.05, 0.02, -0.03])
    context = fixed_context(
        dut,
        position=HOME,
        grasps=grasps,
        object_pose=X_WO,
        object_velocity=SpatialVelocity(V_WO),
    )
    qd = dut.get_output_port().Eval(context)
    lever = X_WH[:3, 3] - X_WO.translation()
    expected = np.r_[V_WO[:3], V_WO[3:] + np.cross(V_WO[:3], lever) + 3.0 * 0.01 * X_WH[:3, 2]]
    np.testing.assert_allclose(J @ qd, expected, atol=1e-9)
    # Finite differences of the forward kinematics say the same.
    step = 1e-6
    moved = forward_kinematics(HOME + step * qd, REACH.gripper.X_FG)
    np.testing.assert_allclose((moved - X_WH)[:3, 3] / step, expected[3:], atol=1e-5)
