"""An unknown object that goes round quickly is followed from its first views on, and unseen."""

import numpy as np

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.tracking import TrackingState
from feasigrasp.models.tracking.tracker import SequenceTracker
from feasigrasp.models.tracking.view import ObjectView
from tests.object_views import look
from tests.tracked_block import SURFACE, on_a_circle, surface_error

X0 = se3.make_pose(se3.so3_exp([0.2, 0.1, 0.4]), [0.5, 0.0, 0.5])
CAMERA = se3.make_pose(se3.so3_exp([0.0, 0.5 * np.pi, 0.0]), [0.1, 0.0, 0.5])
PERIOD = 1.0 / 30.0
RADIUS = 0.08


def test_a_quick_object_is_followed_from_its_first_views_on():
    """There is no model yet in the first images, between which it moves by 15 mm."""
    rng, tracker, X_BO = np.random.default_rng(0), SequenceTracker(), None
    for k in range(20):
        t = k * PERIOD
        X_WB, v = on_a_circle(t, 0.45, RADIUS, X0)
        tracker = tracker.looked(look(SURFACE, X_WB, CAMERA, rng), t)
        tracker = tracker.learnt() if k >= 4 else tracker
        estimate = tracker.track.estimate
        X_BO = se3.inverse(X_WB) @ estimate.X_WO if X_BO is None else X_BO
        assert surface_error(estimate.X_WO @ se3.inverse(X_BO), X_WB) < 4e-3
        if t > 0.3:
            assert np.linalg.norm(estimate.V_WO[3:] - v) < 0.08


def test_out_of_sight_it_is_expected_on_its_path():
    rng, tracker, X_BO = np.random.default_rng(0), SequenceTracker(), None
    for k in range(72):
        t = k * PERIOD
        X_WB, _ = on_a_circle(t, 0.3, RADIUS, X0)
        view = look(SURFACE, X_WB, CAMERA, rng)
        if t > 2.0:
            view = ObjectView(view.camera, CAMERA, np.zeros((0, 3)), np.full_like(view.depth, 2.0))
        tracker = tracker.looked(view, t).learnt()
        X_BO = se3.inverse(X_WB) @ tracker.track.estimate.X_WO if X_BO is None else X_BO
    before, straight_on = on_a_circle(2.0, 0.3, RADIUS, X0)
    found = tracker.track.estimate.X_WO @ se3.inverse(X_BO)
    off = np.linalg.norm(found[:3, 3] - X_WB[:3, 3])
    straight = before[:3, 3] + (t - 2.0) * straight_on - X_WB[:3, 3]
    assert off < 0.02 and off < 0.5 * np.linalg.norm(straight)
    assert tracker.track.state(t, 0.5) is TrackingState.COASTING


def test_one_that_leaves_the_image_before_there_is_a_model_is_not_in_view():
    tracker = SequenceTracker().looked(look(SURFACE, X0, CAMERA), 0.0)
    assert tracker.track.in_view == 1.0
    empty = ObjectView(look(SURFACE, X0, CAMERA).camera, CAMERA, np.zeros((0, 3)))
    assert tracker.looked(empty, PERIOD).track.in_view == 0.0
