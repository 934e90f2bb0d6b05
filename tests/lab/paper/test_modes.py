"""The modes and the choices of a scenario, in the diagram: each against something independent."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.errors import ArgumentError
from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.continuation import flange_pose_kernel, solve_kernel
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.quantities import CONFIGURATION, JOINT_POSITIONS, JOINTS
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from tests.lab.paper.ascents import ascent_direction

FILE = diagram_path("dynamic.scenarios.yaml")
X_FG = ParallelGripper().X_FG
DISTANCE_NOISE = 1e-6  # of the joint-space field


class Run:
    """A scenario that ran for a while, just after a tick of the control."""

    def __init__(self, text, duration, name="PaperLinear"):
        self.config = load_scenario(FILE, name, "{object: {model: duck}, random_seed: 2}", text)
        self.diagram = make_dynamic_grasp(self.config)
        simulator = Simulator(self.diagram)
        simulator.AdvanceTo(duration)
        self.root = simulator.get_context()

    def __call__(self, system, port):
        system = self.diagram.GetSubsystemByName(system)
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.root))

    def log(self, name):
        return self.diagram.GetSubsystemByName(f"log({name})").FindLog(self.root).data()

    @property
    def memory(self):
        controller = self.diagram.GetSubsystemByName("controller")
        return controller.memory(controller.GetMyContextFromRoot(self.root))

    @property
    def q(self):
        return self("station", "arm.position_measured").copy()

    @property
    def X_WO(self):
        return self("sequencer", "object_pose").GetAsMatrix4()

    @property
    def V_WO(self):
        return self("sequencer", "object_velocity").get_coeffs()

    @property
    def command(self):
        return self("controller", "commanded_velocity").copy()

    def configurations(self):
        """Of the solutions that the joint-space controller follows, at the object's pose now."""
        solutions, X_WF, X_GF = self.memory, np.empty((4, 4)), se3.inverse(X_FG)
        q = np.empty((len(solutions), 7))
        for k in range(len(q)):
            flange_pose_kernel(self.X_WO, solutions.X_OG[k], 0.0, X_GF, X_WF)
            assert solve_kernel(
                IIWA_7.chain, X_WF, solutions.branch[k], solutions.arm_angle[k], q[k]
            )
        return q


def assert_nothing_is_clipped(run):
    """The drive adds up what it is told, and the simulated arm does as the drive says."""
    positions, velocities = np.split(run.log("drive"), 2)
    period = run.config.control.period
    np.testing.assert_allclose(
        np.diff(positions, axis=1) / period, velocities[:, 1:], rtol=1e-9, atol=1e-9
    )
    change = np.abs(np.diff(velocities, axis=1)) / period
    assert (change > IIWA_7.acceleration_limits[:, None]).any()  # of the first step at least
    plant = run.diagram.GetSubsystemByName("station").plant
    for name in IIWA_7.joint_names:
        assert plant.GetJointByName(name).position_upper_limits() == [np.inf]
        assert plant.GetJointActuatorByName(name).effort_limit() == np.inf
    lag = run.log("arm")[:7, 1:] - positions[:, :-1]
    assert np.median(np.abs(lag[:, -100:])) < 0.02


def test_paper_in_task_space_is_the_gradient_through_the_pseudo_inverse():
    """By finite differences of the density about the means of its components; no feed-forward."""
    run = Run("{control: {controller: task, mode: paper}}", 2.0)
    X_WH, J = pose_and_jacobian(run.q, X_FG)
    mixture, h = run.memory.mixture.mixture, 1e-6
    X_OH = se3.inverse(run.X_WO) @ X_WH
    steps = h * np.eye(6)
    gradient = mixture.log_density(X_OH @ se3.exp(steps)) - mixture.log_density(
        X_OH @ se3.exp(-steps)
    )
    turned = (gradient.reshape(2, 3) / (2 * h)) @ X_WH[:3, :3].T
    expected = 0.0005 * (np.linalg.pinv(J) @ turned.ravel())
    np.testing.assert_allclose(run.command, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())
    assert np.abs(run.command).max() > 1e-3
    assert_nothing_is_clipped(run)


def test_corrected_in_task_space_feeds_forward_and_follows_medoids():
    run = Run("{control: {controller: task, mode: corrected, options: {damping: 0.0}}}", 2.0)
    X_WH, J = pose_and_jacobian(run.q, X_FG)
    memory, X_WO, V_WO = run.memory, run.X_WO, run.V_WO
    direction = ascent_direction(memory.mixture.targets, se3.inverse(X_WO) @ X_WH)
    turned = 5.0 * (direction.reshape(2, 3) @ X_WH[:3, :3].T)
    turned[0] += V_WO[:3]
    turned[1] += V_WO[3:] + np.cross(V_WO[:3], X_WH[:3, 3] - X_WO[:3, 3])
    np.testing.assert_allclose(J @ run.command, turned.ravel(), atol=1e-5)
    # The targets are grasps, and they are followed closely: within a few millimetres.
    X_WG = X_WO @ memory.mixture.targets.means
    assert np.linalg.norm(X_WG[:, :3, 3] - X_WH[:3, 3], axis=1).min() < 0.01
    assert_nothing_is_clipped(run)


def test_paper_in_joint_space_is_distance_times_gradient():
    """The paper's formulas in plain array code, over a hundred configurations from the flow."""
    run = Run("{control: {controller: joint, mode: paper}}", 2.0)
    assert run.config.control.options["source"] == "flow"
    nodes, q, h = run.configurations(), run.q, 1e-6
    inside = (np.abs(nodes) <= IIWA_7.upper - IIWA_7.position_margin).all(axis=1)
    nodes = nodes[inside]
    assert 20 < len(nodes) <= 100

    def kernel(a):
        return np.exp(-np.linalg.norm(a[:, None] - nodes[None], axis=2) / 0.3)

    alpha = np.linalg.solve(
        kernel(nodes) + DISTANCE_NOISE * np.eye(len(nodes)), np.ones(len(nodes))
    )

    def d(at):
        return -0.3 * np.log(kernel(at[None]) @ alpha)[0]

    gradient = np.array([(d(q + e) - d(q - e)) / (2 * h) for e in h * np.eye(7)])
    np.testing.assert_allclose(run.command, -d(q) * gradient, atol=1e-4)
    assert np.abs(run.command).max() > 1e-3
    assert run.memory.length_scale[0] == 0.3


def test_corrected_in_joint_space_follows_without_lag():
    run = Run("{control: {controller: joint, mode: corrected}}", 3.0)
    X_WH = forward_kinematics(run.q, X_FG)
    X_WG = run.X_WO @ run.memory.X_OG
    assert np.linalg.norm(X_WG[:, :3, 3] - X_WH[:3, 3], axis=1).min() < 0.005
    assert_nothing_is_clipped(run)


@pytest.mark.parametrize("space", ["default", "paper"])
def test_the_density_of_reachable_poses_decides(space):
    """Whatever the controller is given is likely enough, and does not count its flip."""
    control = "{controller: joint, mode: corrected, options: {source: flow}}"
    run = Run(
        f"{{motion: {{amplitude: [0, 0, 0], spin: 0}}, control: {control}, reachability: "
        f"{{method: rmm, options: {{space: {space}}}, symmetric_grasps: false}},"
        " perception: {sampler: antipodal}, grasp: {close: false}}",
        1.0,
        "ReachLinearMocap",
    )
    grasps = run("reachable", "y")
    assert len(grasps) > 0
    packaged = ReachableSpace.load_named(space)
    assert len(packaged.mixture) == {"default": 128, "paper": 64}[space]
    X_WF = run.X_WO @ grasps.X_OG @ se3.inverse(X_FG)
    assert (packaged.mixture.log_density(X_WF) >= packaged.threshold - 1e-3).all()
    flips = se3.log(se3.inverse(grasps.X_OG)[:, None] @ grasps.X_OG[None])
    assert not (np.abs(np.abs(flips[..., 2]) - np.pi) < 1e-6).any()
    # Grasps of the model-free sampler are about the true object.
    mesh = load_object("duck").mesh
    low, high = mesh.bounds
    centres = grasps.X_OG[:, :3, 3]
    assert ((centres > low - 0.01) & (centres < high + 0.01)).all()
    # What the flow drew reaches them, and the hand is on its way.
    for q, X_OG in zip(run.configurations(), run.memory.X_OG, strict=True):
        np.testing.assert_allclose(forward_kinematics(q, X_FG), run.X_WO @ X_OG, atol=1e-6)
    assert np.linalg.norm(run.command) > 0.02


def test_the_papers_field_and_its_one_view():
    """``o = k (K + s2 I)^-1 1`` over the seen points alone, however long the run."""
    run = Run("{control: {mode: paper}}", 1.6)
    perceived, field = run("perception", "perceived"), run("perception", "gpdf")
    assert len(perceived.views.times) == 1
    points = field.points

    def kernel(a):
        return np.exp(-np.linalg.norm(a[:, None] - points[None], axis=2) / 0.3)

    alpha = np.linalg.solve(kernel(points) + 0.0025 * np.eye(len(points)), np.ones(len(points)))
    x = points.mean(axis=0) + np.random.default_rng(0).normal(0.0, 0.05, (50, 3))
    np.testing.assert_allclose(field.distance(x), -0.3 * np.log(kernel(x) @ alpha), atol=1e-5)


@pytest.mark.parametrize("mode", ["paper", "corrected"])
@pytest.mark.parametrize("controller", ["task", "joint"])
def test_joints_without_limits_may_be_wound_up(monkeypatch, mode, controller):
    """As after a minute on the circle: a run goes on where a caller would be asked for radians."""
    text = f"{{control: {{mode: {mode}, controller: {controller}}}}}"
    config = load_scenario(FILE, "PaperCircular", "{object: {model: duck}}", text)
    simulator = Simulator(make_dynamic_grasp(config))
    refused = JOINTS.most[1]
    for quantity in (JOINTS, JOINT_POSITIONS, CONFIGURATION):
        monkeypatch.setitem(vars(quantity), "most", (0.1, refused))
    simulator.AdvanceTo(0.3)
    with pytest.raises(ArgumentError, match="are these degrees"):
        forward_kinematics(IIWA_7.home)
