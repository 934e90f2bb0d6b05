"""The camera's tracker as a system: ports, stamps, states, and the loop with its own perception."""

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import ImageDepth32F

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.tracking import TrackerConfig, TrackingState
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.object_tracker import ObjectTracker
from feasigrasp.systems.point_cloud_to_gpdf import KeyframesToGPDF
from feasigrasp.systems.ports import evaluate
from feasigrasp.systems.tracking.field_tracker import FieldTracker
from feasigrasp_lab.training.data.raycasting import Raycaster
from tests.object_views import CAMERA, camera_at, look

MESH = trimesh.creation.box((0.06, 0.09, 0.12))
SURFACE = Raycaster(MESH.vertices, MESH.faces)
X_WC = camera_at(np.array([0.3, 0.1, 0.15]))
TWIST = np.array([0.0, 0.0, 0.2, 0.03, -0.05, 0.0])
PERIOD = 1.0 / 30.0


class Loop:
    """Tracker and perception, fed with images of a moving box."""

    def __init__(self, depth=True):
        builder = DiagramBuilder()
        self.tracker = builder.AddSystem(
            FieldTracker(CAMERA, TrackerConfig(kind="camera", silence=0.3))
        )
        self.perception = builder.AddSystem(KeyframesToGPDF(PERIOD))
        for source, target, port in (
            (self.tracker, self.perception, "keyframe"),
            (self.perception, self.tracker, "perceived"),
        ):
            builder.Connect(source.GetOutputPort(port), target.GetInputPort(port))
        self.simulator = Simulator(builder.Build())
        self.context = self.simulator.get_context()
        self.depth, self.rng = depth, np.random.default_rng(0)

    def see(self, t, X_WO, stamp=None, shown=True):
        """Shows an image until shortly after t."""
        view = look(SURFACE, X_WO, X_WC, self.rng)
        cloud = PointCloud(len(view.points_W) if shown else 0)
        cloud.mutable_xyzs()[:] = view.points_W.T if shown else np.zeros((3, 0))
        image = ImageDepth32F(*view.depth.T.shape)
        image.mutable_data[:, :, 0] = view.depth
        context = self.tracker.GetMyMutableContextFromRoot(self.context)
        values = {"point_cloud": cloud, "camera_pose": RigidTransform(X_WC)}
        values |= {"depth_image": image} if self.depth else {}
        for name, value in values.items():
            self.tracker.GetInputPort(name).FixValue(context, value)
        if stamp is not None:
            self.tracker.GetInputPort("image_time").FixValue(context, [stamp])
        self.simulator.AdvanceTo(t + 1e-3)
        if not hasattr(self, "first_pose"):
            self.first_pose = self.output("object_pose").GetAsMatrix4()

    def output(self, name):
        port = self.tracker.GetOutputPort(name)
        return evaluate(port, self.tracker.GetMyContextFromRoot(self.context))

    def error(self, X_WB):
        """Largest distance of the box's corners from where its first pose says they are [m]."""
        X_WO = self.output("object_pose").GetAsMatrix4()
        corners = MESH.vertices @ X_WB[:3, :3].T + X_WB[:3, 3]
        first = (corners - X_WO[:3, 3]) @ X_WO[:3, :3]
        self.first = getattr(self, "first", first)
        return np.linalg.norm(first - self.first, axis=1).max()


def test_ports_are_those_of_the_docstrings(ports, documented_ports):
    for system in (FieldTracker(CAMERA, second=CAMERA), KeyframesToGPDF(PERIOD)):
        inputs, outputs = ports(system)
        assert (list(inputs), list(outputs)) == documented_ports(type(system))


def test_it_stands_in_for_the_other_tracker(ports):
    assert set(ports(ObjectTracker())[1]) <= set(ports(FieldTracker(CAMERA))[1])


@pytest.mark.parametrize("depth", [True, False])
def test_it_follows_and_says_what_it_is_worth(depth):
    loop, n = Loop(depth), 24
    loop.see(0.0, np.eye(4))
    loop.error(np.eye(4))
    for k in range(1, n):
        loop.see(k * PERIOD, se3.extrapolate(np.eye(4), TWIST, k * PERIOD))
    now = loop.context.get_time()
    assert loop.error(se3.extrapolate(np.eye(4), TWIST, now)) < 3e-3
    tracking = loop.output("tracking")
    assert tracking.state is TrackingState.TRACKING
    assert tracking.in_view == 1.0
    assert 0.0 < tracking.deviation < 2e-3
    assert np.linalg.eigvalsh(tracking.covariance).min() > 0.0
    assert loop.output("object_velocity").rotational()[2] == pytest.approx(0.2, abs=0.1)
    motion = loop.output("object_motion")
    assert motion.known
    assert np.allclose(
        motion.predict([0.0])[0], loop.output("object_pose").GetAsMatrix4(), atol=5e-3
    )
    # Out of sight: it coasts, then it is lost, stands still and predicts nothing.
    t = (n - 1) * PERIOD
    loop.see(t + 0.2, np.eye(4), shown=False)
    assert loop.output("tracking").state is TrackingState.COASTING
    pose, expected = loop.output("object_pose"), loop.output("tracking").expected
    assert expected == pytest.approx(pose.GetAsMatrix4())
    loop.see(t + 0.5, np.eye(4), shown=False)
    assert loop.output("tracking").state is TrackingState.LOST
    assert loop.output("object_velocity").translational() == pytest.approx(np.zeros(3))
    # It is held where it was expected last, a little farther on.
    held = loop.output("tracking").expected
    assert held == pytest.approx(loop.output("object_pose").GetAsMatrix4())
    assert np.linalg.norm((held - expected)[:3, 3]) < 0.05
    assert not loop.output("object_motion").known


@pytest.mark.parametrize("late", [0.0, 0.06, 0.1])
def test_the_pose_is_that_of_now_however_late_images_are(late):
    """An object in steady motion: it was measured where it was, and is expected where it is."""
    loop, fast, images = Loop(), np.array([0.0, 0.0, 0.2, 0.05, -0.13, 0.05]), 22
    tolerance, speed = 3e-3, np.linalg.norm(fast[3:])

    def moved(t):  # through the middle of the picture
        return se3.extrapolate(np.eye(4), fast, t - 0.5 * images * PERIOD)

    for k in range(images):
        t = k * PERIOD
        loop.see(t, moved(t - late), stamp=t - late)
    now = loop.context.get_time()
    X_WO = loop.output("object_pose").GetAsMatrix4()
    # O was chosen on the first image, where the box was then.
    X_BO = se3.inverse(moved(-late)) @ loop.first_pose
    assert np.linalg.norm((X_WO - moved(now) @ X_BO)[:3, 3]) < tolerance
    assert loop.output("tracking").state is TrackingState.TRACKING
    assert loop.output("tracking").age == pytest.approx(0.0, abs=2e-3)
    taken = loop.output("stamp")[0]
    assert taken == pytest.approx((images - 1) * PERIOD - late)
    measured = loop.output("track").measured
    assert measured.time == pytest.approx(taken)
    assert np.linalg.norm((measured.X_WO - moved(taken) @ X_BO)[:3, 3]) < tolerance
    # Taken for the present one, it is off by what the object goes in that time.
    off = np.linalg.norm((measured.X_WO - moved(now) @ X_BO)[:3, 3])
    assert off == pytest.approx(speed * (now - taken), abs=tolerance)
    assert late == 0.0 or off > 2.0 * tolerance


def test_images_that_stay_away_make_the_pose_old_however_late_they_are():
    """The usual delay is no age; what is missing beyond it is."""
    late, loop = 0.1, Loop()
    for k in range(10):
        loop.see(k * PERIOD, np.eye(4), stamp=k * PERIOD - late)
    for t, state in ((0.38, TrackingState.TRACKING), (0.45, TrackingState.COASTING)):
        loop.see(t, np.eye(4), stamp=9 * PERIOD - late)
        assert loop.output("tracking").state is state
    assert loop.output("tracking").age == pytest.approx(0.45 - 10 * PERIOD, abs=5e-3)


def test_before_the_first_view_nothing_is_known():
    loop = Loop()
    loop.see(0.0, np.eye(4), shown=False)
    assert loop.output("tracking").state is TrackingState.SEARCHING
    assert loop.output("tracking").lost
    assert np.isnan(loop.output("object_pose").translation()).all()
    assert loop.output("keyframe") is None
    assert loop.output("tracking").expected is None


def test_a_scenario_may_track_with_its_camera():
    """The pipeline starts on the camera's tracker alone, and comes to grasps."""
    text = "{object: {model: small_box}, tracker: {kind: camera}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", text)
    diagram = make_dynamic_grasp(scenario)
    tracker = diagram.GetSubsystemByName("tracker")
    assert isinstance(tracker, FieldTracker)
    sequencer = diagram.GetSubsystemByName("sequencer")
    simulator = Simulator(diagram)
    context = simulator.get_context()

    def grasps():
        return sequencer.GetOutputPort("grasps").Eval(sequencer.GetMyContextFromRoot(context))

    while len(grasps().X_OG) == 0 and context.get_time() < 2.0:  # that some are offered once
        simulator.AdvanceTo(context.get_time() + 0.1)
    assert len(grasps().X_OG) > 0
    tracking = tracker.tracking(tracker.GetMyContextFromRoot(context))
    assert tracking.state is TrackingState.TRACKING
