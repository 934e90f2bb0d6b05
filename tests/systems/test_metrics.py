"""Every entry of a sample against Drake's own kinematics."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.tree import JacobianWrtVariable

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.metrics import SAMPLE_NAMES, Metrics

GRIPPER = ParallelGripper()
X_WO = RigidTransform(RollPitchYaw(0.4, -0.3, 1.0), [0.5, 0.1, 0.4])
STILL = np.zeros(7)
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])


@pytest.fixture(scope="module")
def station():
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachCircularMocap")
    scenario.cameras = {}
    return make_station(scenario)


@pytest.fixture
def sample(fixed_context):
    """``sample(q, v, grasps, ...)``: one sample, by name."""

    def evaluate(
        q, v=STILL, *, grasps=None, pose=X_WO, phase=0.0, sampled=None, time=0.0, **inputs
    ):
        dut = Metrics(GRIPPER)
        context = fixed_context(
            dut,
            state=np.r_[q, v],
            object_pose=pose,
            grasps=GraspSet.empty() if grasps is None else grasps,
            phase=[phase],
            sampled_grasps=GraspSet.empty() if sampled is None else sampled,
            **inputs,
        )
        context.SetTime(time)
        return dict(zip(SAMPLE_NAMES, dut.get_output_port().Eval(context), strict=True))

    return evaluate


def configurations(n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, 7)) * IIWA_7.upper


class DrakeArm:
    """The station's plant at a configuration of the arm, object out of the way."""

    def __init__(self, station, q):
        self.plant = station.plant
        self.iiwa = self.plant.GetModelInstanceByName("iiwa")
        root = station.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(root)
        self.plant.SetPositions(self.context, self.iiwa, q)
        self.plant.SetFreeBodyPose(
            self.context, station.object_body, RigidTransform([5.0, 5.0, 5.0])
        )

    def manipulability(self):
        plant = self.plant
        J = plant.CalcJacobianSpatialVelocity(
            self.context,
            JacobianWrtVariable.kV,
            plant.GetFrameByName("iiwa_flange"),
            np.zeros(3),
            plant.world_frame(),
            plant.world_frame(),
        )
        first = plant.GetJointByName("iiwa_joint_1").velocity_start()
        J = J[:, first : first + 7]
        return np.sqrt(max(np.linalg.det(J @ J.T), 0.0))

    def hand(self):
        """The contact centre: midway between the pads, in front of the flange."""
        flange = self.plant.GetFrameByName("iiwa_flange").CalcPoseInWorld(self.context)
        return flange.GetAsMatrix4() @ GRIPPER.X_FG


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(Metrics(GRIPPER))
    assert (list(inputs), list(outputs)) == documented_ports(Metrics)
    assert (inputs["state"], inputs["phase"], outputs["sample"]) == (14, 1, len(SAMPLE_NAMES))


def test_manipulability_is_that_of_drakes_jacobian(station, sample):
    for q in configurations(6):
        expected = DrakeArm(station, q).manipulability()
        assert sample(q)["manipulability"] == pytest.approx(expected, rel=1e-9)


def test_the_object_is_told_in_the_hand_and_in_the_world(station, sample):
    for q in configurations(4, seed=1):
        x = sample(q)
        X_WH = DrakeArm(station, q).hand()
        p_HO = np.array([x[f"p_HO_{axis}"] for axis in "xyz"])
        np.testing.assert_allclose(
            p_HO, X_WH[:3, :3].T @ (X_WO.translation() - X_WH[:3, 3]), atol=1e-9
        )
        R_OH = X_WO.rotation().matrix().T @ X_WH[:3, :3]
        r_OH = RollPitchYaw(RotationMatrix.ProjectToRotationMatrix(R_OH)).ToQuaternion()
        assert np.linalg.norm([x[f"r_OH_{axis}"] for axis in "xyz"]) == pytest.approx(
            2.0 * np.arccos(min(1.0, abs(r_OH.w()))), abs=1e-7
        )
        distance = np.linalg.norm(X_WO.translation() - X_WH[:3, 3])
        assert np.linalg.norm(p_HO) == pytest.approx(distance)
        assert [x[f"p_WO_{axis}"] for axis in "xyz"] == list(X_WO.translation())


def test_limit_margin_and_speed_are_those_of_the_worst_joint(sample):
    q, v = 0.5 * IIWA_7.upper, 0.3 * IIWA_7.velocity_limits
    assert sample(q, v)["limit_margin"] == pytest.approx((IIWA_7.upper - q).min())
    assert sample(q, v)["velocity_ratio"] == pytest.approx(0.3)
    q[2], v[4] = -IIWA_7.upper[2] - 0.02, -1.25 * IIWA_7.velocity_limits[4]
    assert sample(q, v)["limit_margin"] == pytest.approx(-0.02)
    assert sample(q, v)["velocity_ratio"] == pytest.approx(1.25)


def test_the_nearest_grasp_counts(station, sample):
    X_OH = X_WO.inverse().GetAsMatrix4() @ DrakeArm(station, HOME).hand()
    offsets = [
        RigidTransform([0.3, 0.0, 0.0]),
        RigidTransform(RotationMatrix.MakeZRotation(0.2), [0.01, 0.0, -0.02]),
        RigidTransform(RotationMatrix.MakeXRotation(2.0), [0.0, 0.0, 0.0]),
    ]
    poses = np.array([X_OH @ X.GetAsMatrix4() for X in offsets])
    x = sample(HOME, grasps=GraspSet(poses, np.full(3, 0.04), np.ones(3)), phase=2.0)
    assert x["grasp_position_error"] == pytest.approx(np.hypot(0.01, 0.02), rel=1e-6)
    assert x["grasp_angle_error"] == pytest.approx(0.2, rel=1e-6)
    assert x["phase"] == 2.0


def test_without_grasps_only_their_errors_are_nan(sample):
    x = sample(HOME)
    missing = {name for name, value in x.items() if np.isnan(value)}
    assert missing == {
        *("grasp_position_error", "grasp_angle_error", "view_age", "tracked_position_error"),
    }


def test_the_tracked_position_is_compared_with_that_of_the_object_s_frame(sample):
    off = RigidTransform([0.003, 0.0, 0.004])
    assert sample(HOME, tracked_pose=X_WO @ off)["tracked_position_error"] == pytest.approx(0.005)
    x = sample(HOME, frame_pose=X_WO @ off, tracked_pose=X_WO @ off)
    assert x["tracked_position_error"] == pytest.approx(0.0, abs=1e-12)


def test_where_nobody_knows_of_grasps_they_are_not_counted(fixed_context):
    """Beside the drivers of an arm whose controller is another process."""
    dut = Metrics(GRIPPER)
    context = fixed_context(dut, state=np.r_[HOME, STILL], object_pose=X_WO, phase=[0.0])
    found = dict(zip(SAMPLE_NAMES, dut.get_output_port().Eval(context), strict=True))
    unknown = {name for name, value in found.items() if np.isnan(value)}
    assert unknown == {
        *("grasp_position_error", "grasp_angle_error", "view_age"),
        *("sampled_grasps", "reachable_grasps", "tracked_position_error"),
    }


def test_the_object_s_orientation_is_told_in_the_world(sample):
    x = sample(HOME)
    angle_axis = X_WO.rotation().ToAngleAxis()
    expected = angle_axis.angle() * angle_axis.axis()
    np.testing.assert_allclose([x[f"r_WO_{axis}"] for axis in "xyz"], expected, atol=1e-9)


def test_grasps_are_counted_and_the_view_s_age_is_told(sample):
    poses = np.tile(np.eye(4), (5, 1, 1))
    some = GraspSet(poses, np.full(5, 0.04), np.ones(5))
    x = sample(HOME, grasps=some.select(np.arange(2)), sampled=some, time=3.1, view_time=[2.5])
    assert (x["sampled_grasps"], x["reachable_grasps"]) == (5.0, 2.0)
    assert x["view_age"] == pytest.approx(0.6)
    assert sample(HOME)["reachable_grasps"] == 0.0
    assert np.isnan(sample(HOME, view_time=[np.nan])["view_age"])


def test_grasps_in_a_frame_of_the_trackers_own_are_judged_there(sample):
    """The hand is exactly at a grasp that is given in another frame on the object."""
    X_BO = RigidTransform(RollPitchYaw(0.2, 0.5, -1.0), [0.01, -0.02, 0.03])
    frame = X_WO @ X_BO
    X_WH = forward_kinematics(HOME, GRIPPER.X_FG)
    X_OG = np.linalg.inv(frame.GetAsMatrix4()) @ X_WH
    grasps = GraspSet(X_OG[None], np.array([0.05]), np.ones(1))
    found = sample(HOME, grasps=grasps, frame_pose=frame)
    assert found["grasp_position_error"] == pytest.approx(0.0, abs=1e-9)
    assert found["grasp_angle_error"] == pytest.approx(0.0, abs=1e-6)
    without = sample(HOME, grasps=grasps)
    assert without["grasp_position_error"] > 0.01
    others = [name for name in SAMPLE_NAMES if not name.startswith("grasp_")]
    np.testing.assert_equal([found[n] for n in others], [without[n] for n in others])
