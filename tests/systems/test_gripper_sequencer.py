"""The sequencer gates what the arm follows, through a whole grasp and through failed ones."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity

from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import CommittedMotion, GraspSequenceConfig, Phase
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.pose_filter import Noise, empty_state, measure_kernel
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.ports import to_value
from tests.sequencer_bench import (
    CONFIG,
    GRIPPER,
    UNKNOWN,
    V_WO,
    X_WO,
    Mock,
    grasps_at,
)


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


def test_what_a_controller_has_found_is_passed_on_with_the_others():
    mock = Mock(grasps=grasps_at(0.05, 0.1), arrival=Value[object](grasps_at(0.0)))
    mock.advance(0.03)
    assert len(mock.output("grasps")) == 3
    assert mock.advance(0.3) == Phase.CLOSE  # at that grasp, since it is at no other
    assert len(mock.output("grasps")) == 1
    none = Mock(grasps=grasps_at(0.05, 0.1), arrival=Value[object](GraspSet.empty()))
    assert none.advance(0.3) == Phase.APPROACH
    assert len(none.output("grasps")) == 2


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
    unconnected, unobserved = Mock(), Mock(gpdf=to_value(None))
    for mock in (unconnected, unobserved):
        assert mock.advance(0.03) == Phase.APPROACH
        assert mock.output("gpdf") is None
        mock.advance_to_phase(Phase.CLOSE)
        assert mock.output("gpdf") is None


def test_a_whole_grasp_keeps_its_times():
    mock = Mock()
    begins = [mock.advance_to_phase(phase) for phase in list(Phase)[1:]]
    # Every phase begins with an update, every 0.05 s; seen at the next control period. Fingers that
    # do not move press from 0.2 s on.
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


def test_the_fingers_close_at_their_speed_and_press_once_they_stop():
    mock = Mock(gripper_state=[0.04, -0.15])
    mock.advance_to_phase(Phase.CLOSE)
    commands = []
    for t in (0.2, 0.3, 0.45):
        mock.advance(t)
        commands.append(mock.output("gripper_position"))
    np.testing.assert_allclose(
        commands, GRIPPER.max_opening - CONFIG.closing_speed * np.array([0.1, 0.2, 0.35])
    )
    mock.fix(gripper_state=[0.03, 0.0])
    assert mock.advance(0.52) == Phase.CLOSE
    assert mock.output("gripper_position") == GripperSequencer.CLOSED
    for phase in (Phase.LIFT, Phase.SHAKE, Phase.HOLD, Phase.DONE):
        mock.advance_to_phase(phase)
        assert mock.output("gripper_position") == GripperSequencer.CLOSED < 0.0


def test_the_lift_starts_where_the_object_was_let_go_and_is_smooth():
    mock = Mock()
    closed = mock.advance_to_phase(Phase.CLOSE)
    elapsed = mock.advance_to_phase(Phase.LIFT) - closed
    let_go = mock.dut.state(mock.context).X_WO[:3, 3]
    np.testing.assert_allclose(let_go, X_WO.translation() + V_WO[3:] * elapsed, atol=2e-3)
    released = RigidTransform(X_WO.rotation(), X_WO.translation() + [0.001, 0.0, 0.0])
    mock.fix(object_pose=released)  # the measured pose counts no more
    times, poses, twists = [], [], []
    while mock.context.get_time() < 0.1 + 0.4 + 0.3 - 1e-6:
        times.append(mock.context.get_time())
        poses.append(mock.output("object_pose").translation().copy())
        twists.append(mock.output("object_velocity").get_coeffs())
        mock.advance(times[-1] + 0.005)
    poses, twists = np.array(poses), np.array(twists)
    np.testing.assert_allclose(poses[0], let_go, atol=2e-3)
    np.testing.assert_allclose(twists[0], V_WO, atol=0.02)  # as it was carried until then
    slope = np.diff(poses, axis=0) / np.diff(times)[:, None]
    np.testing.assert_allclose(slope, (twists[1:, 3:] + twists[:-1, 3:]) / 2, atol=2e-3)
    shaken = []
    start = mock.advance_to_phase(Phase.SHAKE)
    while mock.advance(mock.context.get_time() + 0.005) == Phase.SHAKE:
        shaken.append(mock.output("object_pose").translation() - poses[0])
    assert mock.context.get_time() - start == pytest.approx(CONFIG.shake_time, abs=0.011)
    shaken = np.array(shaken) - CONFIG.lift
    np.testing.assert_allclose(np.abs(shaken).max(axis=0), CONFIG.shake, atol=1e-3)
    mock.advance_to_phase(Phase.HOLD)
    end = mock.output("object_pose").translation()
    np.testing.assert_allclose(end - let_go, CONFIG.lift, atol=1e-9)
    np.testing.assert_array_equal(mock.output("object_velocity").get_coeffs(), 0.0)


def test_where_the_hand_is_to_go_does_not_jump_when_the_object_is_let_go():
    """The object moved in the hand while the fingers closed: that is no error to correct."""
    mock = Mock()
    mock.advance_to_phase(Phase.CLOSE)
    mock.fix(object_pose=RigidTransform(X_WO.rotation(), X_WO.translation() + [0.02, -0.03, 0.02]))
    way, phases, t = [], [Phase.CLOSE], mock.context.get_time()
    while phases[-1] <= Phase.LIFT:
        t += 0.01
        phases.append(mock.advance(t))
        (X_OG,) = mock.output("grasps").X_OG
        way.append((mock.output("object_pose").GetAsMatrix4() @ X_OG)[:3, 3])
    assert phases.count(Phase.LIFT) > 10
    v = np.diff(way[:-1], axis=0) / 0.01
    lift = 6.0 * np.linalg.norm(CONFIG.lift) / CONFIG.lift_time**2
    braking = 4.0 * np.linalg.norm(v[0]) / CONFIG.lift_time
    assert np.linalg.norm(np.diff(v, axis=0) / 0.01, axis=1).max() < lift + braking + 0.1


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


def test_what_the_tracker_predicts_is_for_the_approach_only():
    motion = MotionEstimate(empty_state(), 0.0)
    mock = Mock(object_motion=Value[object](motion))
    assert mock.output("object_motion") is motion
    mock.advance_to_phase(Phase.CLOSE)
    assert isinstance(mock.output("object_motion"), CommittedMotion)
    assert Mock().output("object_motion") is None


@pytest.mark.parametrize("phase", list(Phase)[1:])
def test_from_then_on_it_tells_where_the_object_will_be_taken(phase):
    mock = Mock()
    start = mock.advance_to_phase(phase)
    motion = mock.output("object_motion")
    assert motion.known
    # When fingers that close will have closed, nobody knows.
    last = 0.2 if phase == Phase.CLOSE else 4.0
    ahead = np.arange(0.0, last, 0.05)
    predicted = motion.predict(ahead)
    for s, X in zip(ahead, predicted, strict=True):
        if s > 0.0:
            mock.advance(start + s)
        actual = mock.output("object_pose").GetAsMatrix4()
        # A phase begins up to one update late.
        np.testing.assert_allclose(X, actual, atol=2e-3)
    if phase in (Phase.LIFT, Phase.SHAKE):
        assert np.ptp(predicted[:, :3, 3], axis=0).max() > 0.01


def test_an_object_that_is_closed_on_is_expected_to_be_lifted_where_it_is_then():
    mock = Mock()
    mock.advance_to_phase(Phase.CLOSE)
    elapsed = mock.context.get_time() - 0.1
    X = mock.output("object_motion").predict([10.0])[0]
    turning = CONFIG.closing_time * V_WO[:3]
    closed = X_WO.translation() + CONFIG.closing_time * V_WO[3:]
    assert 0.0 <= elapsed < 0.01
    np.testing.assert_allclose(X[:3, 3], closed + CONFIG.lift, atol=1e-9)
    turned = (RigidTransform(X).rotation() @ X_WO.rotation().inverse()).ToAngleAxis()
    np.testing.assert_allclose(turned.angle() * turned.axis(), turning, atol=1e-9)
