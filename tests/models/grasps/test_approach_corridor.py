"""The way into a grasp, against its definition in the grasp's own frame."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import (
    ApproachCorridor,
    grasp_errors,
    standoff_kernel,
)

CORRIDOR = ApproachCorridor()


def hand_at(X_OG, *, x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0)):
    """A hand pose displaced and turned in the grasp's frame."""
    return X_OG @ se3.make_pose(se3.so3_exp(turn), [x, y, z])


def standoff(X_OG, X_OH, corridor=CORRIDOR):
    return standoff_kernel(X_OG, X_OH, corridor.parameters)


@pytest.fixture(params=range(3))
def grasp(request):
    return se3.random_pose(np.random.default_rng(request.param), 1)[0]


@pytest.mark.parametrize("z", [-0.3, -0.02, 0.0, 0.01])
def test_no_standoff_once_lined_up(grasp, z):
    inside = hand_at(
        grasp,
        x=0.9 * CORRIDOR.closing_tolerance,
        y=-0.9 * CORRIDOR.width_tolerance,
        z=z,
        turn=[0.0, 0.9 * CORRIDOR.angular_tolerance, 0.0],
    )
    assert standoff(grasp, inside) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("least", "x", "expected"), [(0.15, 0.0, 0.15), (0.05, 1.0, 0.10)])
def test_a_hand_that_waits_never_comes_nearer(grasp, least, x, expected):
    corridor = CORRIDOR._replace(min_standoff=least)
    assert standoff(grasp, hand_at(grasp, x=x), corridor) == pytest.approx(expected)


def test_the_standoff_grows_with_what_exceeds_the_tolerances(grasp):
    beyond = 0.004
    x, y = CORRIDOR.closing_tolerance + beyond, CORRIDOR.width_tolerance + beyond
    gain = CORRIDOR.lateral_gain
    for sign in (-1, 1):
        assert standoff(grasp, hand_at(grasp, x=sign * x)) == pytest.approx(gain * beyond)
        assert standoff(grasp, hand_at(grasp, y=sign * y)) == pytest.approx(gain * beyond)
    both = standoff(grasp, hand_at(grasp, x=x, y=y))
    assert both == pytest.approx(gain * np.hypot(beyond, beyond))

    turn = (CORRIDOR.angular_tolerance + 0.1) * np.array([0.6, 0.0, 0.8])
    expected = CORRIDOR.angular_gain * 0.1
    assert standoff(grasp, hand_at(grasp, turn=turn)) == pytest.approx(expected)
    turned_and_aside = hand_at(grasp, x=x, turn=turn)
    assert standoff(grasp, turned_and_aside) == pytest.approx(expected + gain * beyond)


def test_the_standoff_has_a_longest(grasp):
    assert standoff(grasp, hand_at(grasp, x=1.0)) == pytest.approx(CORRIDOR.max_standoff)
    assert standoff(grasp, hand_at(grasp, turn=[np.pi, 0, 0])) == pytest.approx(
        CORRIDOR.max_standoff
    )


def test_no_funnel_is_the_grasp_itself(grasp):
    away = hand_at(grasp, x=0.3, y=0.2, turn=[0.0, 1.0, 0.0])
    assert standoff(grasp, away, ApproachCorridor(max_standoff=0.0)) == 0.0


tangents = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)
steps = st.lists(st.floats(-1e-3, 1e-3), min_size=6, max_size=6).map(np.array)


@settings(deadline=None)
@given(tangents, tangents, steps)
def test_the_standoff_is_continuous(g, h, step):
    """A small motion of the hand changes it at most by the gains times that motion."""
    X_OG, before = se3.exp(g), se3.exp(h)
    after = before.copy()
    after[:3, :3] = se3.so3_exp(step[:3]) @ before[:3, :3]
    after[:3, 3] += step[3:]
    bound = CORRIDOR.angular_gain * np.linalg.norm(step[:3])
    bound += CORRIDOR.lateral_gain * np.linalg.norm(step[3:])
    # arccos near angle zero resolves 2e-8 rad.
    assert abs(standoff(X_OG, after) - standoff(X_OG, before)) <= bound + 1e-7


def test_it_moves_with_the_object():
    rng = np.random.default_rng(3)
    X_OG, X_OH, X_AO = (
        se3.random_pose(rng, 6),
        se3.random_pose(rng, 1)[0],
        se3.random_pose(rng, 1)[0],
    )
    for X in X_OG:
        moved = standoff(X_AO @ X, X_AO @ X_OH)
        assert moved == pytest.approx(standoff(X, X_OH), abs=1e-12)
    np.testing.assert_allclose(
        grasp_errors(X_AO @ X_OG, X_AO @ X_OH), grasp_errors(X_OG, X_OH), atol=1e-12
    )


def test_errors_are_distance_and_angle():
    rng = np.random.default_rng(4)
    X_OG, X_OH = se3.random_pose(rng, 50), se3.random_pose(rng, 1)[0]
    errors = grasp_errors(X_OG, X_OH)
    distance = np.linalg.norm(X_OG[:, :3, 3] - X_OH[:3, 3], axis=1)
    cosine = (np.trace(X_OG[:, :3, :3].swapaxes(1, 2) @ X_OH[:3, :3], axis1=1, axis2=2) - 1) / 2
    np.testing.assert_allclose(errors, np.column_stack([distance, np.arccos(cosine)]), atol=1e-7)
    assert grasp_errors(np.zeros((0, 4, 4)), X_OH).shape == (0, 2)
    np.testing.assert_allclose(grasp_errors(X_OG[:1], X_OG[0]), 0.0, atol=1e-7)


def test_following_the_funnel_never_cuts_in_from_the_side():
    """A hand that moves straight to its target, over and over, is lined up before it slides in."""
    X_OG = np.eye(4)
    X_OH = hand_at(X_OG, x=0.15, y=-0.1, z=-0.05, turn=[0.0, 0.3, 0.2])
    for _ in range(400):
        p = X_OH[:3, 3]
        # The fingers reach 25 mm in front of the hand's origin.
        if p[2] + 0.025 > -0.02:
            assert abs(p[0]) < 0.025
        target = hand_at(X_OG, z=-standoff(X_OG, X_OH))
        X_OH = X_OH @ se3.exp(0.03 * se3.log(se3.inverse(X_OH) @ target))
    np.testing.assert_allclose(X_OH, X_OG, atol=1e-3)
