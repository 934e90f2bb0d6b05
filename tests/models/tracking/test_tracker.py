"""An unknown object is followed from its first view on; out of sight, and back."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from feasigrasp.models.clouds.checks import ViewRecord
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.objects.tracking import TrackingState
from feasigrasp.models.tracking.tracker import FieldTrack, SequenceTracker, track
from feasigrasp.models.tracking.view import ObjectView
from feasigrasp_lab.training.data.raycasting import Raycaster
from tests.object_views import camera_at, look
from tests.tracked_block import MESH, SURFACE, surface_error

TWIST = np.array([0.05, 0.1, 0.2, 0.02, -0.06, 0.01])
X0 = se3.make_pose(se3.so3_exp([0.2, 0.1, 0.4]), [0.5, 0.0, 0.5])
CAMERA = se3.make_pose(se3.so3_exp([0.0, 0.5 * np.pi, 0.0]), [0.1, 0.0, 0.5])
PERIOD = 1.0 / 30.0
#: Out of sight from when to when [s].
GAP = (1.5, 1.9)


@pytest.fixture(scope="module")
def followed():
    """Times, trackers after each image, and true poses of the frame O that was defined first."""
    rng, tracker, rows, X_BO = np.random.default_rng(0), SequenceTracker(), [], None
    for k in range(75):
        t = k * PERIOD
        X_WB = se3.extrapolate(X0, TWIST, t)
        view = look(SURFACE, X_WB, CAMERA, rng)
        if GAP[0] < t < GAP[1]:
            view = ObjectView(view.camera, CAMERA, np.zeros((0, 3)), np.full_like(view.depth, 2.0))
        tracker = tracker.looked(view, t).learnt()
        if X_BO is None:
            X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO
        rows.append((t, tracker, X_WB, X_BO))
    return rows


def test_it_stays_on_the_object(followed):
    for t, tracker, X_WB, X_BO in followed:
        if 0.3 < t < GAP[0]:
            X = tracker.track.estimate.X_WO @ se3.inverse(X_BO)
            assert surface_error(X, X_WB) < 1.5e-3
            assert tracker.track.state(t, 0.5) is TrackingState.TRACKING


def test_it_knows_the_twist(followed):
    for t, tracker, _, _ in followed:
        if 1.0 < t < GAP[0]:
            estimate = tracker.track.estimate
            assert np.abs(estimate.V_WO[:3] - TWIST[:3]).max() < 0.1
            # The origin of O is not that of the body, whose velocity is known.
            X_WB = se3.extrapolate(X0, TWIST, t)
            lever = estimate.X_WO[:3, 3] - X_WB[:3, 3]
            v = TWIST[3:] + np.cross(TWIST[:3], lever)
            assert np.abs(estimate.V_WO[3:] - v).max() < 0.012


def test_a_small_object_far_away_is_followed_from_its_first_view_on():
    """Of two centimeters, a hundred pixels."""
    rng, tracker = np.random.default_rng(4), SequenceTracker()
    small = Raycaster(0.2 * MESH.vertices, MESH.faces)
    camera = CAMERA @ se3.make_pose(np.eye(3), [0.0, 0.0, -0.25])
    for k in range(45):
        X_WB = se3.extrapolate(X0, TWIST, k * PERIOD)
        view = look(small, X_WB, camera, rng)
        assert len(view.points_W) < 105
        tracker = tracker.looked(view, k * PERIOD).learnt()
    assert tracker.track.state(k * PERIOD, 0.5) is TrackingState.TRACKING
    X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO
    surface = tracker.shape.cloud.points @ X_BO[:3, :3].T + X_BO[:3, 3]
    assert np.median(small.distance(surface)) < 1e-3


def test_what_the_first_view_errs_is_no_motion():
    """The images that follow show the object a little beside a model of one noisy view."""
    rng, tracker = np.random.default_rng(3), SequenceTracker()
    for k in range(20):
        exact = look(SURFACE, X0, CAMERA)
        along = exact.points_W - CAMERA[:3, 3]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        points = exact.points_W + 4e-3 * rng.standard_normal((len(along), 1)) * along
        view = ObjectView(replace(exact.camera, depth_noise=0.03), CAMERA, points, exact.depth)
        tracker = tracker.looked(view, k * PERIOD).learnt()
    assert np.abs(tracker.track.estimate.V_WO[:3]).max() < 0.15
    assert np.abs(tracker.track.estimate.V_WO[3:]).max() < 0.015


def test_out_of_sight_it_coasts_and_is_back_at_once(followed):
    coasting = [tr.track for t, tr, _, _ in followed if GAP[0] + 0.15 < t < GAP[1]]
    times = [t for t, _, _, _ in followed if GAP[0] + 0.15 < t < GAP[1]]
    states = [c.state(t, 0.5) for c, t in zip(coasting, times, strict=True)]
    assert set(states) == {TrackingState.COASTING}
    speeds = [np.linalg.norm(c.estimate.V_WO[3:]) for c in coasting]
    assert np.all(np.diff(speeds) < 0.0)  # the twist dies away
    spread = [np.trace(c.estimate.pose_covariance[3:, 3:]) for c in coasting]
    assert np.all(np.diff(spread) > 0.0)
    assert coasting[-1].state(times[-1] + 1.0, 0.5) is TrackingState.LOST
    t, tracker, X_WB, X_BO = followed[-1]
    assert tracker.track.state(t, 0.5) is TrackingState.TRACKING
    assert surface_error(tracker.track.estimate.X_WO @ se3.inverse(X_BO), X_WB) < 2e-3


def test_keyframes_are_points_of_the_object(followed):
    _, tracker, _, X_BO = followed[-1]
    assert tracker.shape.cloud.views >= 3
    cloud = tracker.shape.cloud.points @ X_BO[:3, :3].T + X_BO[:3, 3]
    assert np.quantile(SURFACE.distance(cloud), 0.9) < 2e-3
    last = tracker.track.keyframe
    (deviation,) = (tr.track.deviation for t, tr, _, _ in followed if t == last.time)
    assert last.deviation == deviation > 0.0


def test_a_side_that_is_known_gives_fewer_keyframes():
    rng, tracker = np.random.default_rng(2), SequenceTracker()
    for k in range(60):  # two seconds of an object at rest, before a camera at rest
        tracker = tracker.looked(look(SURFACE, X0, CAMERA, rng), k * PERIOD).learnt()
    between = np.diff(tracker.shape.views.times)
    assert between[:2].max() < 0.15
    assert between[2:].min() > 0.39
    assert len(between) >= 4


def test_another_side_is_learnt_though_the_object_is_at_the_edge_of_the_image():
    """It turns by 170 degrees meanwhile: later on nothing that was known is in sight."""
    rng, tracker, X_BO = np.random.default_rng(0), SequenceTracker(), None
    for k in range(105):
        t = k * PERIOD
        X_WB = se3.extrapolate(X0, np.array([0.0, 0.0, 1.2, 0.0, 0.0, 0.0]), t)
        aside = 0.5 * np.clip((t - 0.5) / 0.3, 0.0, 1.0) * np.clip((3.0 - t) / 0.3, 0.0, 1.0)
        camera = CAMERA @ se3.make_pose(se3.so3_exp([0.0, aside, 0.0]), [0.0, 0.0, 0.0])
        tracker = tracker.looked(look(SURFACE, X_WB, camera, rng), t).learnt()
        X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO if X_BO is None else X_BO
    assert surface_error(tracker.track.estimate.X_WO @ se3.inverse(X_BO), X_WB) < 6e-3
    assert tracker.track.state(t, 0.5) is TrackingState.TRACKING


def test_a_long_side_that_comes_into_view_is_learnt():
    """A beam, seen end-on at first, turns: of most of what is seen then, nothing was known."""
    mesh = trimesh.creation.box((0.05, 0.07, 0.3))
    beam, rng = Raycaster(mesh.vertices, mesh.faces), np.random.default_rng(0)
    tracker, X_BO = SequenceTracker(), None
    towards = se3.make_pose(se3.so3_exp([0.0, 0.5 * np.pi, 0.0]), np.zeros(3))
    for k in range(75):
        turn = [0.0, 0.0, 0.5 * max(0.0, k * PERIOD - 0.5)]
        X_WB = se3.make_pose(se3.so3_exp(turn), [0.6, 0.0, 0.5]) @ towards
        tracker = tracker.looked(look(beam, X_WB, CAMERA, rng), k * PERIOD).learnt()
        X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO if X_BO is None else X_BO
    E = se3.inverse(X_WB) @ tracker.track.estimate.X_WO @ se3.inverse(X_BO)
    points = np.asarray(mesh.sample(300, seed=0))
    assert beam.distance(points @ E[:3, :3].T + E[:3, 3]).mean() < 4e-3
    assert np.ptp(tracker.shape.cloud.points @ X_BO[:3, :3].T, axis=0)[2] > 0.28


def test_what_enters_the_image_does_not_drag_the_object_along():
    """A beam comes down into the image, along itself: until then its upper end is anywhere."""
    mesh = trimesh.creation.box((0.05, 0.07, 0.2))
    beam, rng = Raycaster(mesh.vertices, mesh.faces), np.random.default_rng(0)
    tracker, X_BO, R = SequenceTracker(), None, se3.so3_exp([0.3, 0.0, 0.5])
    points, known = np.asarray(mesh.sample(300, seed=0)), []
    for k in range(48):
        X_WB = se3.make_pose(R, [0.5, 0.0, 0.73 - 0.1 * k * PERIOD])
        tracker = tracker.looked(look(beam, X_WB, CAMERA, rng), k * PERIOD).learnt()
        X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO if X_BO is None else X_BO
        E = se3.inverse(X_WB) @ tracker.track.estimate.X_WO @ se3.inverse(X_BO)
        assert beam.distance(points @ E[:3, :3].T + E[:3, 3]).mean() < 5e-4
        known.append(len(tracker.track.cut) == 0)
    assert not known[0] and known[-1]  # that it is whole, in the end


@pytest.mark.parametrize("slips", [False, True])
def test_what_is_held_moves_with_the_hand(slips):
    """Camera and object are shaken together; in 0.3 s of it the object is out of sight."""
    rng, tracker, X_BO, keyframe = np.random.default_rng(3), SequenceTracker(), None, None
    for k in range(75):
        t = k * PERIOD
        held = t > 0.5
        way = 0.04 * (1.0 - np.cos(2.0 * np.pi * 1.5 * (t - 0.5))) if held else 0.0
        shaken = se3.make_pose(se3.so3_exp([0.0, 0.0, 5.0 * way]), [0.0, way, 0.5 * way])
        slid = 0.04 * np.clip(t - 1.5, 0.0, 0.25) if slips else 0.0
        X_WB = shaken @ se3.make_pose(np.eye(3), [0.0, 0.0, -slid]) @ X0
        view = look(SURFACE, X_WB, shaken @ CAMERA, rng)
        if 0.8 < t < 1.1:
            view = replace(view, points_W=np.zeros((0, 3)), depth=None)
        track_ = track(tracker.track, view, t, tracker.shape.gpdf, tracker.shape.views, held=held)
        tracker = replace(tracker, track=track_).learnt()
        X_BO = se3.inverse(X_WB) @ track_.estimate.X_WO if X_BO is None else X_BO
        if held and not 1.5 < t < 1.9:
            assert surface_error(track_.estimate.X_WO @ se3.inverse(X_BO), X_WB) < 1.5e-3
        keyframe = track_.keyframe if not held else keyframe
    assert track_.keyframe is keyframe, "what is in the hand is not learnt from"


def test_its_motion_predicts(followed):
    t, tracker, X_WB, X_BO = [row for row in followed if row[0] < GAP[0]][-1]
    later = MotionEstimate(tracker.track.motion, t).predict([0.5])[0] @ se3.inverse(X_BO)
    assert surface_error(later, se3.extrapolate(X0, TWIST, t + 0.5)) < 0.01


def test_an_old_image_changes_nothing(followed):
    t, tracker, X_WB, _ = followed[-1]
    view = look(SURFACE, X_WB, CAMERA)
    assert tracker.looked(view, t).track is tracker.track


def test_searching_until_there_is_enough_to_see():
    nothing = ObjectView(look(SURFACE, X0, CAMERA).camera, CAMERA, np.zeros((5, 3)), None)
    tracker = SequenceTracker().looked(nothing, 0.0)
    assert tracker.track.state(0.0, 0.5) is TrackingState.SEARCHING
    assert tracker.learnt().shape.gpdf is None


def test_a_first_view_of_which_no_field_comes_does_not_stay_the_first():
    """Its mask is that of a wall behind the object, which is too wide for one."""
    first = look(SURFACE, X0, CAMERA)
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-4, 4, 60), np.linspace(-4, 4, 60)))
    wall = np.stack([np.full(len(y), 7.0), y, z], axis=1)
    tracker = SequenceTracker()
    for k in range(8):
        points = wall if k == 0 else first.points_W
        view = ObjectView(first.camera, CAMERA, points, first.depth)
        tracker = tracker.looked(view, k * PERIOD).learnt()
    assert tracker.track.model is not None
    assert 0.0 < tracker.track.begun_at < 3 * PERIOD


def test_an_object_elsewhere_is_found_again(followed):
    """A second later, 6 cm off and turned by 20 degrees; nothing else is in the image."""
    t, tracker, X_WB, X_BO = [row for row in followed if row[0] < GAP[0]][-1]
    empty = ObjectView(look(SURFACE, X_WB, CAMERA).camera, CAMERA, np.zeros((0, 3)), None)
    tracker = tracker.looked(empty, t + 0.5)
    X = se3.make_pose(se3.so3_exp([0.0, 0.0, 0.35]) @ X_WB[:3, :3], X_WB[:3, 3] + [0, 0.06, 0])
    for k in range(3):
        later = t + 1.0 + k * PERIOD
        tracker = tracker.looked(look(SURFACE, X, CAMERA, np.random.default_rng(k)), later)
    assert tracker.track.measured_at == later
    assert surface_error(tracker.track.estimate.X_WO @ se3.inverse(X_BO), X) < 3e-3


@pytest.mark.parametrize("turn", [1.2, -2.5])
def test_after_a_long_gap_it_is_found_though_it_has_turned_far(followed, turn):
    """About the line of sight, so that the side that is known is seen."""
    t, tracker, X_WB, X_BO = [row for row in followed if row[0] < GAP[0]][-1]
    X = se3.make_pose(se3.so3_exp([turn, 0.0, 0.0]) @ X_WB[:3, :3], X_WB[:3, 3] + [0, 0.04, 0])
    for k in range(30):  # within a second
        later = t + 2.0 + k * PERIOD
        tracker = tracker.looked(look(SURFACE, X, CAMERA, np.random.default_rng(k)), later)
    assert tracker.track.measured_at == later
    assert surface_error(tracker.track.estimate.X_WO @ se3.inverse(X_BO), X) < 3e-3


@pytest.mark.parametrize("whole", [True, False])
def test_what_is_not_recognised_in_full_sight_is_begun_anew(followed, whole):
    """Another shape is there after a gap, as if what was learnt were wrong."""
    known, turned = followed[-1][1], CAMERA
    if not whole:  # the image ends within it
        turned = CAMERA @ se3.make_pose(se3.so3_exp([0.0, 0.5, 0.0]), np.zeros(3))
    mesh = trimesh.creation.box((0.05, 0.2, 0.05))
    surface, rng = Raycaster(mesh.vertices, mesh.faces), np.random.default_rng(0)
    tracker, begun = known, []
    t0 = followed[-1][0] + 1.2
    twist = np.array([0.0, 0.0, 0.2, 0.0, 0.05, 0.0])
    for k in range(60 if whole else 30):  # begun anew, it would be after 0.6 s
        t = t0 + k * PERIOD
        X_WB = se3.extrapolate(X0, twist, t - t0)
        tracker = tracker.looked(look(surface, X_WB, turned, rng), t).learnt()
        begun.append(tracker.track.begun_at)
        if begun[-1] == t:
            X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO
    assert known.track.begun_at == followed[0][0]
    if not whole:
        assert set(begun) == {known.track.begun_at}
        return
    assert t0 + 0.6 <= tracker.track.begun_at < t0 + 0.7
    # What is merged by now is of the new one, and the pose is its.
    assert tracker.shape.views.times[0] == tracker.track.begun_at
    cloud = tracker.shape.cloud.points @ X_BO[:3, :3].T + X_BO[:3, 3]
    assert np.quantile(surface.distance(cloud), 0.9) < 2e-3
    E = se3.inverse(X_WB) @ tracker.track.estimate.X_WO @ se3.inverse(X_BO)
    assert surface.distance(mesh.vertices @ E[:3, :3].T + E[:3, 3]).mean() < 3e-3
    assert tracker.track.state(t, 0.5) is TrackingState.TRACKING


def test_a_field_of_the_object_before_is_not_tracked_by(followed):
    """It comes late from another process, when the tracker has begun anew."""
    t, tracker, X_WB, _ = followed[-1]
    begun = track(FieldTrack(), look(SURFACE, X_WB, CAMERA), t, None, ViewRecord())
    shape = tracker.shape
    after = track(begun, look(SURFACE, X_WB, CAMERA), t + PERIOD, shape.gpdf, shape.views)
    assert after.model is None
    assert tracker.shape.is_of(tracker.track.keyframe)
    assert not tracker.shape.is_of(begun.keyframe)


def test_a_pose_far_from_the_expected_one_must_fit(followed):
    """Its back, 4 cm off, looks a little like its front: that is no reason to be there."""
    t, tracker, X_WB, X_BO = [row for row in followed if row[0] < GAP[0]][-1]
    unsure = tracker.track.estimate.widened(np.diag(np.square(np.repeat([0.1, 0.04], 3))))
    tracker = replace(tracker, track=replace(tracker.track, estimate=unsure))
    for turn, shift in (
        ([0.0, 0.0, 2.5], [0.0, -0.03, 0.03]),
        ([0.0, 0.0, 0.1], [0.0, 0.015, 0.0]),
    ):
        X = se3.make_pose(se3.so3_exp(turn) @ X_WB[:3, :3], X_WB[:3, 3] + shift)
        view = look(SURFACE, X, CAMERA, np.random.default_rng(0))
        track = tracker.looked(view, t + PERIOD).track
        found = track.measured_at > t
        assert found == (turn[2] < 1.0)
        assert not found or surface_error(track.estimate.X_WO @ se3.inverse(X_BO), X) < 3e-3


def test_what_hides_a_part_of_it_is_not_taken_for_its_absence(followed):
    """Most of it is behind something nearer, such as a finger."""
    t, tracker, X_WB, X_BO = [row for row in followed if row[0] < GAP[0]][-1]
    later = t + PERIOD
    whole = look(SURFACE, se3.extrapolate(X_WB, TWIST, PERIOD), CAMERA, np.random.default_rng(0))
    u = whole.camera.pixels(whole.points_C)[0]
    edge = int(np.quantile(u, 0.3))
    depth = whole.depth.copy()
    depth[:, edge:] = 0.15  # before the object
    view = ObjectView(whole.camera, CAMERA, whole.points_W[u < edge], depth)
    track = tracker.looked(view, later).track
    assert track.measured_at == later
    X_true = se3.extrapolate(X_WB, TWIST, PERIOD)
    assert surface_error(track.estimate.X_WO @ se3.inverse(X_BO), X_true) < 3e-3


def test_it_is_followed_while_little_of_it_is_in_the_image(followed):
    """For a second most of it is beyond the border; a coasting twist would lose 3 cm."""
    t, tracker, X_WB, X_BO = [row for row in followed if row[0] < GAP[0]][-1]
    # The camera turns away about its y axis, by more than half its angle of view.
    turned = CAMERA @ se3.make_pose(se3.so3_exp([0.0, 0.55, 0.0]), np.zeros(3))
    rng, errors, shares = np.random.default_rng(1), [], []
    for _ in range(30):
        t += PERIOD
        X_WB = se3.extrapolate(X0, TWIST, t)
        tracker = tracker.looked(look(SURFACE, X_WB, turned, rng), t)
        errors.append(surface_error(tracker.track.estimate.X_WO @ se3.inverse(X_BO), X_WB))
        shares.append(tracker.track.in_view)
    assert 0.0 < np.mean(shares) < 0.25
    assert max(errors) < 6e-3


def test_a_surface_that_is_hardly_known_is_not_tracked(followed):
    t, tracker, _, _ = followed[-1]
    unsure = replace(tracker.track, deviation=0.01)
    assert tracker.track.state(t, 0.5) is TrackingState.TRACKING
    assert unsure.state(t, 0.5) is TrackingState.COASTING


def test_what_one_camera_does_not_show_another_one_tracks():
    rng, tracker, asked = np.random.default_rng(1), SequenceTracker(), []
    other = camera_at([-0.3, -0.35, 0.1])  # sees some of what the first one sees
    other[:3, 3] += X0[:3, 3]
    for k in range(30):
        X_WB = se3.extrapolate(X0, TWIST, k * PERIOD)
        seen = look(SURFACE, X_WB, CAMERA, rng)
        tracker = tracker.looked(seen, k * PERIOD).learnt()
        if k == 0:
            X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO
    known, gpdf, views = tracker.track, tracker.shape.gpdf, tracker.shape.views
    learnt = known.keyframe
    for k in range(30, 60):
        t, X_WB = k * PERIOD, se3.extrapolate(X0, TWIST, k * PERIOD)
        nothing = ObjectView(seen.camera, CAMERA, np.zeros((0, 3)), np.full_like(seen.depth, 2.0))

        def second(X_WB=X_WB, t=t):
            asked.append(t)
            return look(SURFACE, X_WB, other, rng)

        known = track(known, nothing, t, gpdf, views, second=second)
        assert known.state(t, 0.5) is TrackingState.TRACKING
        assert known.in_view == 0.0
        assert surface_error(known.estimate.X_WO @ se3.inverse(X_BO), X_WB) < 4e-3
    assert known.keyframe is learnt
    assert len(asked) == 30
    track(
        known,
        look(SURFACE, se3.extrapolate(X0, TWIST, 2.0), CAMERA, rng),
        2.0,
        gpdf,
        views,
        second=second,
    )
    assert len(asked) == 30  # the first one sees it again
