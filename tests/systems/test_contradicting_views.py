"""Views that contradict each other: noticed, not merged, and outvoted if most of them agree."""

import numpy as np
from pydrake.math import RigidTransform

from feasigrasp.models.clouds.checks import ViewFault
from tests.perception_bench import CAMERA, POSES, Perception, seen_from, sphere


def test_a_view_far_from_the_others_is_a_contradiction_and_not_the_end():
    """A tracked pose that is metres off: the merged cloud would be too wide for any field."""
    perception = Perception()
    perception.see_object(0.1, POSES[1])
    field = perception.gpdf()
    off = POSES[1] @ RigidTransform([2.5, 0.0, 0.0])
    after = perception.look(0.6, (off @ seen_from(sphere(), CAMERA).T).T, POSES[1], off @ CAMERA)
    assert after.contradicted
    assert perception.gpdf() is field
    back = perception.see_object(1.1, POSES[1])
    assert back.cloud.views == 2 and not back.contradicted


def test_a_view_that_contradicts_the_earlier_ones_is_noticed_and_not_merged():
    """The object moves on and its tracked pose does not; later the pose is right again."""
    perception = Perception(period=0.5, views_per_side=1, check=1.0)
    first = perception.see_object(0.1, POSES[0])
    visible, aside = seen_from(sphere(), CAMERA), np.array([0.0, 0.1, 0.0])
    states = []
    for k in range(1, 5):  # views at 0.5, 1.0, 1.5, 2.0, of which every other one is taken
        states.append(perception.look(0.5 * k + 0.1, visible + aside))
    assert [state.contradicted for state in states] == [False, True, True, True]
    assert [state.looked for state in states] == [0.0, 1.0, 1.0, 2.0]
    assert all(state.gpdf is first.gpdf for state in states)
    # From another side, where a view is always welcome.
    other = perception.look(2.6, visible + aside, p_WC=np.array([0.3, 0.1, 0.3]))
    assert other.contradicted and other.cloud.views == 1
    again = perception.see_object(3.6, POSES[1])
    assert not again.contradicted and again.cloud.views == 1


def test_a_contradiction_is_forgotten_when_nothing_is_seen_for_a_while():
    perception = Perception(period=0.5, views_per_side=1, check=1.0)
    perception.see_object(0.1, POSES[0])
    visible = seen_from(sphere(), CAMERA)
    assert perception.look(1.1, visible + [0.0, 0.1, 0.0]).contradicted  # looked at 1.0
    assert perception.look(2.6, np.zeros((0, 3))).contradicted
    assert not perception.look(3.1, np.zeros((0, 3))).contradicted


def test_a_badly_tracked_view_is_no_contradiction():
    perception = Perception(period=0.5, views_per_side=9)
    perception.see_object(0.1, POSES[0])
    off = perception.look(0.6, seen_from(sphere(), CAMERA) + [0.003, 0.003, 0.0])
    assert not off.contradicted and off.cloud.views == 2


def test_first_views_at_a_wrong_pose_are_outvoted_by_later_ones_that_agree():
    perception = Perception(period=0.5, check=0.5)
    visible = seen_from(sphere(3000), CAMERA)
    assert not perception.look(0.6, visible + [0.0, 0.1, 0.0]).contradicted
    states = [perception.look(0.6 + 0.5 * k, visible) for k in range(1, 5)]
    assert [state.contradicted for state in states] == [True, True, True, False]
    last = states[-1]
    assert last.cloud.views == 4 and last.gpdf is not None
    assert last.faults[ViewFault.OUTVOTED] == states[0].cloud.views
    np.testing.assert_allclose(last.cloud.points.mean(axis=0)[:2], 0.0, atol=0.003)
    assert not perception.look(3.6, visible).contradicted


def test_views_that_contradict_each_other_outvote_nothing():
    """As while the measured pose stands still and the object moves on."""
    perception = Perception(period=0.5, check=0.5)
    visible = seen_from(sphere(3000), CAMERA)
    first = perception.look(0.1, visible)
    for k in range(1, 9):
        seen = perception.look(0.1 + 0.5 * k, visible + [0.0, 0.06 * k, 0.0])
        assert seen.contradicted and seen.cloud is first.cloud
