"""Forward kinematics and Jacobian against Drake's plant and finite differences."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, JacobianWrtVariable

from feasigrasp.errors import ArgumentError
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import (
    forward_kinematics,
    manipulability,
    manipulability_kernel,
    pose_and_jacobian,
    pose_jacobian_kernel,
    tool_pose,
)
from feasigrasp.resources import model_path

X_FT = se3.make_pose(se3.so3_exp([0.3, -1.2, 0.7]), [0.05, -0.11, 0.18])


def random_configurations(n, seed=0):
    return IIWA_7.random_positions(np.random.default_rng(seed), n)


class DrakeKinematics:
    """Our URDF in a plant, with the tool frame fixed to its flange."""

    def __init__(self):
        self.plant = MultibodyPlant(0.001)
        parser = Parser(self.plant)
        parser.package_map().Add("feasigrasp", str(model_path()))
        parser.AddModels(str(model_path("iiwa", "iiwa7.urdf")))
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("iiwa_link_0"))
        self.flange = self.plant.GetFrameByName("iiwa_flange")
        self.tool = self.plant.AddFrame(FixedOffsetFrame("tool", self.flange, RigidTransform(X_FT)))
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()

    def pose_and_jacobian(self, q, frame):
        self.plant.SetPositions(self.context, q)
        world = self.plant.world_frame()
        J = self.plant.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world
        )
        return frame.CalcPoseInWorld(self.context).GetAsMatrix4(), J


@pytest.fixture(scope="module")
def drake():
    return DrakeKinematics()


@pytest.mark.parametrize("tool", [None, X_FT], ids=["flange", "tool"])
def test_pose_and_jacobian_equal_drake(drake, tool):
    frame = drake.flange if tool is None else drake.tool
    Q = random_configurations(200)
    X, J = pose_and_jacobian(Q, tool)
    for k, q in enumerate(Q):
        X_drake, J_drake = drake.pose_and_jacobian(q, frame)
        np.testing.assert_allclose(X[k], X_drake, rtol=0, atol=1e-12)
        np.testing.assert_allclose(J[k], J_drake, rtol=0, atol=1e-12)


def test_jacobian_by_finite_differences():
    step = 1e-6
    for q in random_configurations(20, seed=1):
        X, J = pose_and_jacobian(q, X_FT)
        ahead = forward_kinematics(q + step * np.eye(7), X_FT)
        behind = forward_kinematics(q - step * np.eye(7), X_FT)
        linear = (ahead - behind)[:, :3, 3] / (2 * step)
        angular = se3.so3_log(ahead[:, :3, :3] @ behind[:, :3, :3].swapaxes(1, 2)) / (2 * step)
        np.testing.assert_allclose(J, np.hstack([angular, linear]).T, atol=1e-8)


def test_tool_of_the_gripper_lies_in_front_of_the_flange():
    """Upright arm: the flange is 1.266 m high, the pad centre 0.18 m above it."""
    gripper = ParallelGripper()
    X_WH = forward_kinematics(np.zeros(7), gripper.X_FG)
    np.testing.assert_allclose(X_WH[:3, 3], [0, 0, 1.266 + 0.18], atol=1e-12)
    np.testing.assert_allclose(X_WH[:3, :3], gripper.X_FG[:3, :3], atol=1e-12)


def test_any_leading_axes():
    Q = random_configurations(6, seed=2)
    X, J = pose_and_jacobian(Q.reshape(2, 3, 7))
    assert X.shape == (2, 3, 4, 4) and J.shape == (2, 3, 6, 7)
    np.testing.assert_array_equal(X.reshape(6, 4, 4), forward_kinematics(Q))
    np.testing.assert_array_equal(X[1, 2], forward_kinematics(Q[5]))
    np.testing.assert_array_equal(J[0, 1], pose_and_jacobian(Q[1])[1])
    assert forward_kinematics(np.zeros((0, 7))).shape == (0, 4, 4)
    assert manipulability(Q.reshape(2, 3, 7)).shape == (2, 3)


def test_manipulability_is_the_product_of_singular_values(drake):
    Q = random_configurations(50, seed=3)
    for q, measured in zip(Q, manipulability(Q), strict=True):
        J = drake.pose_and_jacobian(q, drake.flange)[1]
        assert measured == pytest.approx(np.linalg.svd(J, compute_uv=False).prod(), abs=1e-9)


@pytest.mark.parametrize("q", [np.zeros(7), [0.3, 0.5, 0, 0, 0.2, 0.7, 0.1]])
def test_manipulability_vanishes_with_a_straight_elbow(q):
    assert manipulability(q) < 1e-7


def test_manipulability_is_that_of_any_base_and_flange_angle():
    Q = random_configurations(20, seed=4)
    turned = Q.copy()
    turned[:, [0, 6]] += [0.7, -1.1]
    np.testing.assert_allclose(manipulability(turned), manipulability(Q), atol=1e-12)


def test_kernels_equal_the_batch():
    Q = random_configurations(50, seed=5)
    X, J = pose_and_jacobian(Q, X_FT)
    measured = manipulability(Q)
    for k, q in enumerate(Q):
        X_k, J_k = np.empty((4, 4)), np.empty((6, 7))
        pose_jacobian_kernel(IIWA_7.chain, q, X_FT, X_k, J_k)
        np.testing.assert_allclose(X_k, X[k], rtol=0, atol=1e-15)
        np.testing.assert_allclose(J_k, J[k], rtol=0, atol=1e-15)
        assert manipulability_kernel(IIWA_7.chain, q) == pytest.approx(measured[k], rel=1e-12)


def test_a_whole_turn_changes_nothing():
    Q = random_configurations(20, seed=6)
    X, J = pose_and_jacobian(Q)
    X_turned, J_turned = pose_and_jacobian(Q + 2 * np.pi * np.sign(Q))
    np.testing.assert_allclose(X_turned, X, rtol=0, atol=1e-12)
    np.testing.assert_allclose(J_turned, J, rtol=0, atol=1e-12)


def test_lists_strides_and_nan():
    Q = random_configurations(8, seed=8)
    X, J = pose_and_jacobian(Q)
    np.testing.assert_array_equal(pose_and_jacobian(Q.tolist())[0], X)
    np.testing.assert_array_equal(pose_and_jacobian(Q[::2])[1], J[::2])
    np.testing.assert_array_equal(pose_and_jacobian(np.asfortranarray(Q))[0], X)
    Q[3, 2] = np.nan
    broken = np.isnan(forward_kinematics(Q)).any(axis=(1, 2))
    np.testing.assert_array_equal(broken, np.arange(8) == 3)
    assert np.isnan(manipulability(Q)[3])


@pytest.mark.parametrize("function", [pose_and_jacobian, forward_kinematics, manipulability])
@pytest.mark.parametrize("q", [np.zeros(6), 0.0, np.zeros((7, 3))])
def test_wrong_number_of_joints(function, q):
    with pytest.raises(ValueError, match=r"shape \(..., (7|joints)\)"):
        function(q)


@pytest.mark.parametrize("function", [pose_and_jacobian, forward_kinematics, manipulability])
def test_degrees_are_refused(function):
    with pytest.raises(ValueError, match=r"q holds 90, .*degrees\? Give radians"):
        function([0.0, 90.0, 0.0, -90.0, 0.0, 45.0, 0.0])


def test_measured_positions_may_be_of_many_turns():
    q = random_configurations(5)
    wound = q + 2.0 * np.pi * np.arange(-17, 18).reshape(5, 7)
    pose = forward_kinematics(q, X_FT)
    np.testing.assert_allclose(tool_pose(wound, X_FT, IIWA_7), pose, atol=1e-12)
    with pytest.raises(ArgumentError, match="are these degrees"):
        forward_kinematics(wound, X_FT)
