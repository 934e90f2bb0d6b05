"""A predictor of one's own, behind any tracker."""

import pickle

import numpy as np
import pytest
from pydrake.math import RigidTransform

from feasigrasp.errors import ScenarioError
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems import make_dynamic_grasp
from feasigrasp.systems.object_tracker import CustomMotion

TWIST = np.array([0.0, 0.0, 0.0, 0.1, -0.2, 0.3])
HERE = RigidTransform([0.5, 0.1, 0.4]).GetAsMatrix4()
FALL = [0.0, 0.0, -9.81]


def falling(ahead, X_WO, V_WO, estimate):
    """A thrown object."""
    poses = np.tile(X_WO, (len(ahead), 1, 1))
    poses[:, :3, 3] += ahead[:, None] * V_WO[3:] + 0.5 * ahead[:, None] ** 2 * FALL
    return poses


class Falling:
    """The same as a part."""

    def __init__(self, tracker, factor=1.0):
        self.factor = factor

    def __call__(self, *given):
        return falling(*given)


def test_the_prediction_is_the_functions():
    motion = CustomMotion(falling, HERE, TWIST, None)
    assert motion.known
    at = motion.predict([0.0, 0.5])[:, :3, 3]
    np.testing.assert_allclose(at[0], HERE[:3, 3])
    np.testing.assert_allclose(at[1], HERE[:3, 3] + 0.5 * TWIST[3:] + 0.125 * np.array(FALL))
    # The velocity of another filter takes the place of the tracker's.
    at = motion.predict(0.5, v_WO=[0.0, 0.0, 1.0])[0, :3, 3]
    np.testing.assert_allclose(at, HERE[:3, 3] + [0.0, 0.0, 0.5 - 0.125 * 9.81])


def test_a_lost_object_is_not_known():
    assert not CustomMotion(falling, np.full((4, 4), np.nan), TWIST, None).known


def test_it_can_be_sent_to_another_process():
    motion = pickle.loads(pickle.dumps(CustomMotion(falling, HERE, TWIST, None)))
    np.testing.assert_array_equal(
        motion.predict([0.1]), CustomMotion(falling, HERE, TWIST, None).predict([0.1])
    )


def test_another_shape_is_an_error_in_words():
    motion = CustomMotion(lambda *given: HERE, HERE, TWIST, None)
    with pytest.raises(ScenarioError, match=r"shape \(4, 4\); return one pose .* \(3, 4, 4\)"):
        motion.predict([0.1, 0.2, 0.3])


@pytest.mark.parametrize("scenario", ["ReachLinear", "ReachLinearMocap"])
def test_the_filter_and_the_sequencer_predict_by_it(scenario):
    text = "{parts: {predictor: {name: 'systems.test_motion_predictor:Falling'}}}"
    text = text.replace("systems.test_motion_predictor", __name__)
    diagram = make_dynamic_grasp(load_scenario(scenario, text))
    context = diagram.CreateDefaultContext()
    tracker, reachability = diagram.subsystems.tracker, diagram.subsystems.reachability
    predictor = diagram.GetSubsystemByName("predictor")
    own = predictor.GetInputPort("object_motion").Eval(predictor.GetMyContextFromRoot(context))
    theirs = tracker.GetOutputPort("object_motion").Eval(tracker.GetMyContextFromRoot(context))
    assert type(own) is type(theirs)
    for system in (reachability, diagram.subsystems.sequencer):
        found = system.GetInputPort("object_motion").Eval(system.GetMyContextFromRoot(context))
        assert isinstance(found, CustomMotion) and isinstance(found.function, Falling)
