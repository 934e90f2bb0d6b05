"""What the sequencer does when the object is doubted, or the hand does not get on."""

import numpy as np
import pytest
from pydrake.common.value import Value

from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.sequence import GraspSequenceConfig, Phase
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.ports import to_value
from tests.sequencer_bench import (
    X_WO,
    Mock,
    grasps_at,
    perceived,
    tracked,
)


@pytest.mark.parametrize(
    ("doubt", "trust", "scheduled_obstacle"),
    [
        ({"tracking": tracked("lost", 1.0)}, {"tracking": tracked("tracking")}, False),
        ({"tracking": tracked("searching", np.inf)}, {"tracking": tracked("tracking")}, False),
        ({"perceived": perceived(True)}, {"perceived": perceived(False)}, True),
        ({"lapsed": [1.0]}, {"lapsed": [0.0]}, False),
    ],
)
def test_grasps_lapse_while_the_pose_is_not_to_be_relied_on(doubt, trust, scheduled_obstacle):
    mock = Mock(**doubt)
    assert mock.advance(1.0) == Phase.APPROACH
    assert len(mock.output("grasps")) == 0 and mock.output("grasps").rejected
    for port in ("object_pose", "object_velocity"):
        value = mock.output(port)
        known = value.GetAsMatrix4()[:3] if port == "object_pose" else value.get_coeffs()
        assert (
            np.isfinite(known).all() == scheduled_obstacle
            and np.isnan(known).all() != scheduled_obstacle
        )
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
    assert mock.output("search_target") is None
    mock.fix(tracking=out_of_sight("coasting", 0.1))
    assert mock.output("search_target") is None  # an image or two
    for state, age in (("coasting", 0.4), ("lost", 7.0)):
        mock.fix(tracking=out_of_sight(state, age))
        search_target = mock.output("search_target")
        np.testing.assert_allclose(search_target.X_WO, X_WO.GetAsMatrix4())
        assert search_target.age == age
    mock.fix(tracking=out_of_sight("tracking", 0.0))
    mock.advance_to_phase(Phase.CLOSE)
    mock.fix(tracking=out_of_sight("lost", 7.0))
    assert mock.output("search_target") is None


def test_nothing_is_looked_for_without_a_place_or_a_camera_on_the_arm():
    assert Mock(tracking=tracked("lost", 7.0), looks=True).output("search_target") is None
    assert Mock(tracking=out_of_sight("lost", 7.0)).output("search_target") is None


def giving_up(**inputs):
    """A sequencer that gives grasps up, with a ball that was seen."""
    field = Value[object](fit_gpdf(sphere_points(64, 0.03)))
    return Mock(gives_up=True, gpdf=field, **{"grasps": grasps_at(0.05, 0.2), **inputs})


def test_a_grasp_that_the_hand_does_not_come_to_is_given_up():
    mock = giving_up()
    mock.advance(2.9)
    assert len(mock.output("grasps")) == 2
    mock.advance(3.2)
    assert len(mock.output("grasps")) == 1


@pytest.mark.parametrize(
    "inputs",
    [
        {"gpdf": to_value(None)},
        {"config": GraspSequenceConfig(close=False)},
        {"config": GraspSequenceConfig(patience=np.inf)},
        {"gives_up": False},
    ],
)
def test_nothing_is_given_up_of_what_is_not_known_or_not_to_be_grasped(inputs):
    mock = giving_up(**{k: v for k, v in inputs.items() if k == "config"})
    mock.fix(**{k: v for k, v in inputs.items() if k == "gpdf"})
    if "gives_up" in inputs:
        mock = Mock(grasps=grasps_at(0.05, 0.2))
    mock.advance(5.0)
    assert len(mock.output("grasps")) == 2


def test_what_is_in_the_fingers_is_not_let_go_because_the_object_is_lost():
    mock = Mock(tracking=tracked("tracking"), perceived=perceived(False))
    mock.advance_to_phase(Phase.CLOSE)
    mock.fix(tracking=tracked("lost", 1.0), perceived=perceived(True))
    assert len(mock.output("grasps")) == 1
    mock.advance_to_phase(Phase.DONE)
