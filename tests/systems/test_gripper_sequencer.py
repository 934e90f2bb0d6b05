"""The sequencer gates what the arm follows, through a whole grasp and through failed ones."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import GraspSequenceConfig, Phase
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.pose_filter import Noise, empty_state, measure_kernel
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.point_cloud_to_gpdf import Perceived

GRIPPER = ParallelGripper()
CONFIG = GraspSequenceConfig(
    dwell=0.1,
    patience=3.0,
    squeeze_time=0.4,
    lift=[-0.05, 0.0, 0.1],
    lift_time=0.3,
    shake=[0.0, 0.02, 0.0],
    shake_frequency=5.0,
    shake_time=0.4,
    hold_time=0.2,
)
Q = np.deg2rad([0.0, 20.0, 0.0, -80.0, 0.0, 70.0, 0.0])
X_WH = forward_kinematics(Q, GRIPPER.X_FG)
X_WO = RigidTransform(RollPitchYaw(0.3, 0.2, 1.0), [0.5, 0.1, 0.5])
#: The object's motion; the hand is carried along with it in this mock.
V_WO = np.array([0.1, -0.2, 0.3, 0.05, -0.1, 0.02])
UNKNOWN = RigidTransform(np.full((4, 4), np.nan))


def grasps_at(*errors):
    """One grasp for each error: where the hand is, moved by that much along its own x [m]."""
    X_OH = X_WO.inverse().GetAsMatrix4() @ X_WH
    poses = [X_OH @ RigidTransform([error, 0.0, 0.0]).GetAsMatrix4() for error in errors]
    n = len(poses)
    return GraspSet(np.array(poses).reshape(n, 4, 4), 0.04 + 0.001 * np.arange(n), np.ones(n))


class Mock:
    """A sequencer whose inputs are set by hand."""

    def __init__(self, config=CONFIG, looks=False, reachability=None, **inputs):
        self.dut = GripperSequencer(
            config, GRIPPER, period=0.05, looks=looks, reachability=reachability
        )
        self.simulator = Simulator(self.dut)
        self.context = self.simulator.get_mutable_context()
        self.fix(
            position=Q,
            grasps=grasps_at(0.05, 0.001, 0.1),
            object_pose=X_WO,
            object_velocity=SpatialVelocity(V_WO),
            gripper_state=[0.04, 0.0],
        )
        self.fix(**inputs)

    def fix(self, **inputs):
        for name, value in inputs.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def output(self, name):
        value = self.dut.GetOutputPort(name).Eval(self.context)
        return float(value[0]) if isinstance(value, np.ndarray) else value

    def advance(self, t):
        self.simulator.AdvanceTo(t)
        return Phase(int(self.output("phase")))

    def advance_to_phase(self, phase, limit=10.0):
        """Advances to just after the phase begins, in control periods."""
        while self.advance(self.context.get_time() + 0.005) != phase:
            assert self.context.get_time() < limit
        return self.context.get_time()


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(GripperSequencer(CONFIG, GRIPPER))
    assert (list(inputs), list(outputs)) == documented_ports(GripperSequencer)
    assert (inputs["position"], inputs["gripper_state"]) == (7, 2)
    assert all(outputs[name] == 1 for name in ("gripper_position", "object_hold", "phase"))


def test_away_from_all_grasps_everything_is_passed_through():
    given = grasps_at(0.05, 0.1)
    mock = Mock(grasps=given)
    assert mock.advance(1.0) == Phase.APPROACH
    assert mock.output("grasps") is given
    np.testing.assert_array_equal(mock.output("object_pose").GetAsMatrix4(), X_WO.GetAsMatrix4())
    np.testing.assert_array_equal(mock.output("object_velocity").get_coeffs(), V_WO)
    assert mock.output("gripper_position") == GRIPPER.max_opening
    assert mock.output("object_hold") == 1.0


def test_the_field_is_passed_through_until_the_hand_has_committed_to_a_grasp():
    field, newer = (fit_gpdf(sphere_points(20, radius)) for radius in (0.03, 0.04))
    mock = Mock(gpdf=Value[object](field))
    assert mock.advance(0.03) == Phase.APPROACH
    assert mock.output("gpdf") is field
    mock.fix(gpdf=Value[object](newer))
    assert mock.output("gpdf") is newer
    for phase in list(Phase)[1:]:
        mock.advance_to_phase(phase)
        assert mock.output("gpdf") is None


def test_a_hand_that_opens_again_keeps_off_the_object_again():
    field = fit_gpdf(sphere_points(20, 0.03))
    mock = Mock(gpdf=Value[object](field))
    mock.advance_to_phase(Phase.CLOSE)
    assert mock.output("gpdf") is None
    mock.fix(gripper_state=[0.0005, 0.0])  # nothing between the fingers
    mock.advance_to_phase(Phase.APPROACH)
    assert mock.output("gpdf") is field


def test_without_a_field_none_is_passed_on():
    unconnected, unseen = Mock(), Mock(gpdf=Value[object](None))
    for mock in (unconnected, unseen):
        assert mock.advance(0.03) == Phase.APPROACH
        assert mock.output("gpdf") is None
        mock.advance_to_phase(Phase.CLOSE)
        assert mock.output("gpdf") is None


def test_a_whole_grasp_keeps_its_times():
    mock = Mock()
    begins = [mock.advance_to_phase(phase) for phase in list(Phase)[1:]]
    # Every phase begins with an update, every 0.05 s; seen at the next control period.
    expected = np.cumsum([0.1, 0.4, 0.3, 0.4, 0.2]) + 0.005
    np.testing.assert_allclose(begins, expected, atol=0.0051)
    assert mock.advance(5.0) == Phase.DONE


def test_the_object_is_held_until_the_lift_and_never_again():
    mock = Mock()
    for phase in list(Phase)[1:]:
        mock.advance_to_phase(phase)
        assert mock.output("object_hold") == (1.0 if phase == Phase.CLOSE else 0.0)


def test_closing_passes_on_one_grasp_and_where_the_object_would_be():
    mock = Mock()
    start = mock.advance_to_phase(Phase.CLOSE)
    (width,) = mock.output("grasps").width
    assert width == 0.041  # the second, nearest to the hand
    # The fingers push the object; the arm must not follow that.
    mock.fix(object_pose=RigidTransform([9.0, 9.0, 9.0]), object_velocity=SpatialVelocity.Zero())
    mock.advance(start + 0.2)
    elapsed = mock.context.get_time() - 0.1
    expected = X_WO.translation() + V_WO[3:] * elapsed
    pose = mock.output("object_pose")
    np.testing.assert_allclose(pose.translation(), expected, atol=1e-9)
    turned = (pose.rotation() @ X_WO.rotation().inverse()).ToAngleAxis()
    np.testing.assert_allclose(turned.angle() * turned.axis(), V_WO[:3] * elapsed, atol=1e-9)
    np.testing.assert_array_equal(mock.output("object_velocity").get_coeffs(), V_WO)


def test_closing_follows_the_motion_that_the_tracker_predicts():
    """A circle through where the object is: straight on, the hand would be 1 cm off."""
    circle = dict(
        amplitude=np.full(3, 0.1),
        harmonic=np.ones(3),
        offset_deg=np.array([90.0, 0.0, 0.0]),
        rate=1.2,
        start_phase=0.0,
        spin_axis=np.array([0.0, 0.0, 1.0]),
        spin=0.0,
        R_WO=X_WO.rotation().matrix(),
    )
    times = np.arange(0.0, 5.0, 0.005)
    end = HarmonicMotion(center=np.zeros(3), **circle).pose(times[-1])[:3, 3]
    motion = HarmonicMotion(center=X_WO.translation() - end, **circle)
    state = empty_state()
    for t in times:
        measure_kernel(state, t, motion.pose(t), Noise())
    V_WO = motion.velocity(times[-1])
    estimate = Value[object](MotionEstimate(state, float(times[-1])))
    mock = Mock(object_motion=estimate, object_velocity=SpatialVelocity(V_WO))
    start = mock.advance_to_phase(Phase.CLOSE)
    mock.advance(start + 0.38)
    elapsed = mock.context.get_time() - 0.1
    pose, truth = mock.output("object_pose"), motion.pose(times[-1] + elapsed)[:3, 3]
    assert np.linalg.norm(pose.translation() - truth) < 0.003
    assert np.linalg.norm(X_WO.translation() + V_WO[3:] * elapsed - truth) > 0.01


def test_the_fingers_close_at_their_speed_and_stay_closed():
    mock = Mock()
    mock.advance_to_phase(Phase.CLOSE)
    commands = []
    for t in (0.2, 0.3, 0.45):
        mock.advance(t)
        commands.append(mock.output("gripper_position"))
    np.testing.assert_allclose(
        commands, GRIPPER.max_opening - CONFIG.closing_speed * np.array([0.1, 0.2, 0.35])
    )
    for phase in (Phase.LIFT, Phase.SHAKE, Phase.HOLD, Phase.DONE):
        mock.advance_to_phase(phase)
        assert mock.output("gripper_position") == GripperSequencer.CLOSED < 0.0


def test_the_lift_starts_where_the_object_was_let_go_and_is_smooth():
    mock = Mock()
    mock.advance_to_phase(Phase.LIFT)
    released = RigidTransform(X_WO.rotation(), X_WO.translation() + [0.001, 0.0, 0.0])
    mock.fix(object_pose=released)  # from now on the measured pose counts no more
    times, poses, twists = [], [], []
    while mock.context.get_time() < 0.1 + 0.4 + 0.3 - 1e-6:
        times.append(mock.context.get_time())
        poses.append(mock.output("object_pose").translation().copy())
        twists.append(mock.output("object_velocity").get_coeffs())
        mock.advance(times[-1] + 0.005)
    poses, twists = np.array(poses), np.array(twists)
    np.testing.assert_allclose(poses[0], X_WO.translation(), atol=1e-4)
    np.testing.assert_array_equal(twists[:, :3], 0.0)
    slope = np.diff(poses, axis=0) / np.diff(times)[:, None]
    np.testing.assert_allclose(slope, (twists[1:, 3:] + twists[:-1, 3:]) / 2, atol=2e-3)
    assert np.linalg.norm(twists[0, 3:]) < 0.1 * np.linalg.norm(twists[:, 3:], axis=1).max()
    shaken = []
    start = mock.advance_to_phase(Phase.SHAKE)
    while mock.advance(mock.context.get_time() + 0.005) == Phase.SHAKE:
        shaken.append(mock.output("object_pose").translation() - poses[0])
    assert mock.context.get_time() - start == pytest.approx(CONFIG.shake_time, abs=0.011)
    shaken = np.array(shaken) - CONFIG.lift
    np.testing.assert_allclose(np.abs(shaken).max(axis=0), CONFIG.shake, atol=1e-3)
    mock.advance_to_phase(Phase.HOLD)
    end = mock.output("object_pose").translation()
    np.testing.assert_allclose(end - X_WO.translation(), CONFIG.lift, atol=1e-9)
    np.testing.assert_array_equal(mock.output("object_velocity").get_coeffs(), 0.0)


def test_lifting_follows_the_grasp_that_the_hand_really_has():
    """The object moved in the hand while the fingers closed: that is no error to correct."""
    mock = Mock()
    mock.advance_to_phase(Phase.CLOSE)
    moved = RigidTransform(X_WO.rotation(), X_WO.translation() + [0.004, -0.003, 0.002])
    mock.fix(object_pose=moved)
    mock.advance_to_phase(Phase.LIFT)
    (X_OG,) = mock.output("grasps").X_OG
    np.testing.assert_allclose(moved.GetAsMatrix4() @ X_OG, X_WH, atol=1e-12)


def test_fingers_that_close_on_nothing_open_again_and_the_object_stays_held():
    mock = Mock()
    mock.advance_to_phase(Phase.CLOSE)
    mock.fix(gripper_state=[0.0005, 0.0])
    mock.advance_to_phase(Phase.APPROACH)
    assert mock.output("object_hold") == 1.0
    assert mock.output("gripper_position") == GRIPPER.max_opening
    assert len(mock.output("grasps")) == 3
    mock.advance_to_phase(Phase.CLOSE)  # and tries again


def test_a_short_visit_is_no_grasp():
    mock = Mock()
    for a, b in pairwise(np.arange(0.0, 1.0, 0.1)):
        mock.fix(grasps=grasps_at(0.001))
        assert mock.advance(a + 0.04) == Phase.APPROACH
        mock.fix(grasps=grasps_at(0.02))
        assert mock.advance(b) == Phase.APPROACH


@pytest.mark.parametrize(("error", "closes"), [(0.0055, True), (0.0065, False)])
def test_the_tolerance_decides(error, closes):
    assert (Mock(grasps=grasps_at(error)).advance(0.3) == Phase.CLOSE) == closes


def test_an_open_hand_follows_for_ever():
    mock = Mock(GraspSequenceConfig(close=False))
    assert mock.advance(2.0) == Phase.APPROACH


@pytest.mark.parametrize(
    "unknown",
    [
        {"object_pose": UNKNOWN},
        {"object_velocity": SpatialVelocity(np.full(6, np.nan))},
        {"grasps": GraspSet.empty()},
    ],
    ids=["NaN pose", "NaN twist", "no grasps"],
)
def test_an_unknown_object_or_no_grasp_never_closes_the_hand(unknown):
    mock = Mock(**unknown)
    assert mock.advance(1.0) == Phase.APPROACH
    mock.fix(object_pose=X_WO, object_velocity=SpatialVelocity(V_WO), grasps=grasps_at(0.001))
    assert mock.advance(1.3) == Phase.CLOSE


def test_an_object_lost_while_the_fingers_close_is_not_let_go():
    mock = Mock()
    mock.advance_to_phase(Phase.CLOSE)
    mock.fix(object_pose=UNKNOWN)
    assert mock.advance(2.0) == Phase.CLOSE
    assert mock.output("object_hold") == 1.0
    assert np.isfinite(mock.output("object_pose").GetAsMatrix4()).all()
    mock.fix(object_pose=X_WO)
    assert mock.advance(2.1) == Phase.LIFT


def tracked(state, age=0.0):
    return Value[object](Tracking(TrackingState(state), age))


def perceived(contradicted):
    return Value[object](Perceived(FusedCloud.empty(0.003), None, contradicted=contradicted))


@pytest.mark.parametrize(
    ("doubt", "trust", "kept_off"),
    [
        ({"tracking": tracked("lost", 1.0)}, {"tracking": tracked("tracking")}, False),
        ({"tracking": tracked("searching", np.inf)}, {"tracking": tracked("tracking")}, False),
        ({"perceived": perceived(True)}, {"perceived": perceived(False)}, True),
        ({"lapsed": [1.0]}, {"lapsed": [0.0]}, False),
    ],
)
def test_grasps_lapse_while_the_pose_is_not_to_be_relied_on(doubt, trust, kept_off):
    mock = Mock(**doubt)
    assert mock.advance(1.0) == Phase.APPROACH
    assert len(mock.output("grasps")) == 0 and mock.output("grasps").rejected
    for port in ("object_pose", "object_velocity"):
        value = mock.output(port)
        known = value.GetAsMatrix4()[:3] if port == "object_pose" else value.get_coeffs()
        assert np.isfinite(known).all() == kept_off and np.isnan(known).all() != kept_off
    mock.fix(**trust)
    assert len(mock.output("grasps")) == 3
    assert mock.output("object_pose").IsNearlyEqualTo(X_WO, 1e-12)
    mock.advance_to_phase(Phase.CLOSE, limit=1.3)


def test_the_fingers_do_not_close_on_an_extrapolated_pose():
    mock = Mock(tracking=tracked("coasting", 0.2))
    assert mock.advance(1.0) == Phase.APPROACH
    assert len(mock.output("grasps")) == 3
    mock.fix(tracking=tracked("tracking"))
    # Being there counts from now on.
    assert mock.advance(1.09) == Phase.APPROACH
    mock.advance_to_phase(Phase.CLOSE, limit=1.3)


def out_of_sight(state, age):
    X = X_WO.GetAsMatrix4()
    return Value[object](Tracking(TrackingState(state), age, expected=X))


def test_an_object_out_of_sight_is_looked_for_until_the_hand_has_committed():
    mock = Mock(tracking=out_of_sight("tracking", 0.0), looks=True)
    assert mock.output("sought") is None
    mock.fix(tracking=out_of_sight("coasting", 0.1))
    assert mock.output("sought") is None  # an image or two
    for state, age in (("coasting", 0.4), ("lost", 7.0)):
        mock.fix(tracking=out_of_sight(state, age))
        sought = mock.output("sought")
        np.testing.assert_allclose(sought.X_WO, X_WO.GetAsMatrix4())
        assert sought.age == age
    mock.fix(tracking=out_of_sight("tracking", 0.0))
    mock.advance_to_phase(Phase.CLOSE)
    mock.fix(tracking=out_of_sight("lost", 7.0))
    assert mock.output("sought") is None


def test_nothing_is_looked_for_without_a_place_or_a_camera_on_the_arm():
    assert Mock(tracking=tracked("lost", 7.0), looks=True).output("sought") is None
    assert Mock(tracking=out_of_sight("lost", 7.0)).output("sought") is None


def second_look(**inputs):
    """A sequencer that can look from elsewhere at a ball that was seen."""
    field, camera = Value[object](fit_gpdf(sphere_points(64, 0.03))), RigidTransform(X_WH)
    return Mock(reachability=Reachability(), gpdf=field, camera_pose=camera, **inputs)


def test_without_a_grasp_in_reach_the_arm_looks_from_another_side():
    mock = second_look(grasps=GraspSet.empty())
    mock.advance(0.9)
    assert mock.dut.GetOutputPort("look_from").Eval(mock.context) is None
    mock.advance(1.2)
    q = mock.dut.GetOutputPort("look_from").Eval(mock.context)
    assert Reachability().admissible(q[None])[0] and np.abs(q - Q).max() > 0.1
    # What comes into reach is gone for at once.
    mock.fix(grasps=grasps_at(0.05))
    mock.advance(1.3)
    assert mock.dut.GetOutputPort("look_from").Eval(mock.context) is None
    assert len(mock.output("grasps")) == 1


def test_a_grasp_that_the_hand_does_not_come_to_is_given_up():
    mock = second_look(grasps=grasps_at(0.05, 0.2))
    mock.advance(2.9)
    assert len(mock.output("grasps")) == 2
    mock.advance(3.2)
    assert mock.dut.GetOutputPort("look_from").Eval(mock.context) is not None
    assert len(mock.output("grasps")) == 1


@pytest.mark.parametrize(
    "inputs",
    [
        {"tracking": tracked("lost")},
        {"gpdf": Value[object](None)},
        {"object_pose": UNKNOWN},
        {"config": GraspSequenceConfig(close=False)},
        {"config": GraspSequenceConfig(patience=np.inf), "grasps": grasps_at(0.05)},
    ],
)
def test_no_other_look_is_taken_at_what_is_not_known_or_not_to_be_grasped(inputs):
    mock = second_look(grasps=GraspSet.empty())
    mock.fix(**{k: v for k, v in inputs.items() if k != "config"})
    if "config" in inputs:
        mock = second_look(**{"grasps": GraspSet.empty(), **inputs})
    mock.advance(5.0)
    assert mock.dut.GetOutputPort("look_from").Eval(mock.context) is None


def test_without_a_camera_the_hand_only_goes_for_other_grasps():
    field = Value[object](fit_gpdf(sphere_points(64, 0.03)))
    mock = Mock(reachability=Reachability(), gpdf=field, grasps=grasps_at(0.05, 0.2))
    mock.advance(3.2)
    assert mock.dut.GetOutputPort("look_from").Eval(mock.context) is None
    assert len(mock.output("grasps")) == 1


def test_what_is_in_the_fingers_is_not_let_go_because_the_object_is_lost():
    mock = Mock(tracking=tracked("tracking"), perceived=perceived(False))
    mock.advance_to_phase(Phase.CLOSE)
    mock.fix(tracking=tracked("lost", 1.0), perceived=perceived(True))
    assert len(mock.output("grasps")) == 1
    mock.advance_to_phase(Phase.DONE)


def test_what_the_tracker_predicts_is_for_the_approach_only():
    motion = MotionEstimate(empty_state(), 0.0)
    mock = Mock(object_motion=Value[object](motion))
    assert mock.output("object_motion") is motion
    mock.advance_to_phase(Phase.CLOSE)
    assert mock.output("object_motion") is None
    mock.advance_to_phase(Phase.HOLD)
    assert mock.output("object_motion") is None
    assert Mock().output("object_motion") is None
