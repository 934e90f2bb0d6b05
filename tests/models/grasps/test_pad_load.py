"""Loads on pads: the limit surface by hand, the probability by drawing masses and centres."""

import numpy as np
import pytest
from scipy.optimize import brentq

from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.grasp_set import GRIP_SPREAD, MassEstimate
from feasigrasp.models.grasps.payload import GRAVITY, HAND_ACCELERATION, PadLoad

#: Nothing but friction about the closing line can give way.
TORSION = (0.4, np.inf, np.inf)


def load_of(lever, R_OG=None, *, mass=0.5, spread=0.3, error=0.0, moment=TORSION):
    lever = np.atleast_2d(np.array(lever, dtype=float))
    n = len(lever)
    return PadLoad(
        R_OG=np.broadcast_to(np.eye(3) if R_OG is None else R_OG, (n, 3, 3)),
        lever=lever,
        body=MassEstimate(mass, spread, np.zeros(3), error),
        force=np.full(n, 48.0),
        moment=np.broadcast_to(moment, (n, 3)),
    )


def test_weight_beside_the_pads_is_on_the_limit_surface():
    a, d = GRAVITY + HAND_ACCELERATION, 0.07
    share = load_of([0.0, d, 0.0]).per_kilogram([0.0, 0.0, -1.0])[0]
    assert share == pytest.approx(np.hypot(a / 48.0, a * d / 0.4))


def test_weight_below_the_pads_does_not_turn():
    hanging = load_of([0.0, 0.0, -0.07]).per_kilogram([0.0, 0.0, -1.0])[0]
    a = GRAVITY + HAND_ACCELERATION
    assert hanging == pytest.approx(np.hypot(a / 48.0, HAND_ACCELERATION * 0.07 / 0.4))


def test_weight_along_the_closing_line_turns_nothing():
    shares = load_of([[0.08, 0.0, 0.0], [0.0, 0.0, 0.0]]).per_kilogram([0.0, 0.0, -1.0])
    assert shares[0] == pytest.approx(shares[1])


def test_weight_across_the_pads_is_borne_by_where_they_press():
    """Along the closing line it bends about y, and the hand's own motion about z as well."""
    d, limits = 0.08, (0.4, 0.5, 0.3)
    share = load_of([d, 0.0, 0.0], moment=limits).per_kilogram([0.0, 0.0, -1.0])[0]
    a = GRAVITY + HAND_ACCELERATION
    by_hand = HAND_ACCELERATION * d
    assert share == pytest.approx(np.linalg.norm([a / 48.0, a * d / 0.5, by_hand / 0.3]))


def test_torques_are_those_of_the_weight_about_the_pads():
    """Without the hand's own motion: share of a moment = |component of r x m g| / limit."""
    rng = np.random.default_rng(4)
    R, lever, down = random_rotation(rng), rng.normal(0.0, 0.05, 3), rng.normal(size=3)
    down /= np.linalg.norm(down)
    torque = R.T @ np.cross(lever, GRAVITY * down)
    hand = HAND_ACCELERATION * np.linalg.norm(np.cross(np.eye(3), R.T @ lever), axis=1)
    for axis in range(3):
        limits = np.full(3, np.inf)
        limits[axis] = 1e-3  # so little that the force beside it does not count
        share = load_of(lever, R, moment=limits).per_kilogram(down)[0]
        assert share == pytest.approx((abs(torque[axis]) + hand[axis]) / 1e-3, rel=1e-3)


def random_rotation(rng):
    R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return R * np.sign(np.linalg.det(R))


@pytest.mark.parametrize("moment", [TORSION, (0.4, 0.6, 0.3)])
def test_no_direction_is_worse_than_the_worst(moment):
    rng = np.random.default_rng(0)
    load = load_of(rng.normal(0.0, 0.05, (20, 3)), random_rotation(rng), error=0.01, moment=moment)
    down = rng.normal(size=(2000, 3))
    shares = np.array([load.per_kilogram(d) for d in down])
    worst = load.per_kilogram()
    assert (shares <= worst + 1e-9).all()
    if moment is TORSION:  # several moments are not at their worst together
        np.testing.assert_allclose(shares.max(axis=0), worst, rtol=0.05)


def test_turning_object_and_gravity_together_changes_nothing():
    rng = np.random.default_rng(2)
    R, G = random_rotation(rng), random_rotation(rng)
    lever, down, moment = rng.normal(0, 0.05, (4, 3)), rng.normal(size=3), (0.4, 0.6, 0.3)
    one = load_of(lever, G, moment=moment).probability(down)
    turned = load_of(lever @ R.T, R @ G, moment=moment).probability(5.0 * R @ down)
    np.testing.assert_allclose(turned, one)


def test_probability_is_how_often_drawn_objects_are_carried():
    rng = np.random.default_rng(1)
    levers = np.array([[0.0, d, 0.0] for d in (0.0, 0.03, 0.06, 0.09, 0.12)])
    load = load_of(levers, mass=0.5, spread=0.5, error=0.01)
    told = load.probability([0.0, 0.0, -1.0])
    n = 20_000
    mass = 0.5 * np.exp(0.5 * rng.normal(size=n))
    borne = np.exp(GRIP_SPREAD * rng.normal(size=n))
    for lever, p in zip(levers, told, strict=True):
        drawn = load_of(lever + rng.normal(0.0, 0.01, (n, 3)))
        share = mass * drawn.per_kilogram([0.0, 0.0, -1.0]) / borne
        assert p == pytest.approx((share <= 1.0).mean(), abs=0.03)
    assert (np.diff(told) < 0.0).all() and told[0] > 0.95 and told[-1] < 0.4


def test_selecting_and_joining():
    load = load_of([[0.0, 0.01, 0.0], [0.0, 0.02, 0.0], [0.0, 0.03, 0.0]])
    both = load.select(np.array([2])).joined(load.select(np.array([True, False, False])))
    np.testing.assert_array_equal(both.lever[:, 1], [0.03, 0.01])
    assert both.body is load.body


def test_no_direction_of_gravity_is_refused():
    with pytest.raises(GraspError, match="direction of gravity"):
        load_of([0.0, 0.0, 0.1]).probability([0.0, 0.0, 0.0])


def test_an_object_that_none_carries_is_taken_to_be_lighter():
    """As if it had the mass that the best grasp carries so likely; a light one keeps its own."""
    down, lever = [0.0, 0.0, -1.0], [[0.0, 0.02, 0.0], [0.0, 0.09, 0.0]]
    heavy, light = (load_of(lever, mass=mass) for mass in (20.0, 0.05))
    assert heavy.probability(down).max() < 0.01
    lighter = heavy.probability(down, 0.6)
    assert lighter.max() == pytest.approx(0.6)
    mass = brentq(lambda m: load_of(lever, mass=m).probability(down).max() - 0.6, 0.05, 20.0)
    np.testing.assert_allclose(lighter, load_of(lever, mass=mass).probability(down), atol=1e-6)
    np.testing.assert_array_equal(light.probability(down, 0.6), light.probability(down))


def test_where_no_grasp_bears_anything_no_object_is_light_enough():
    nothing = load_of([0.0, 0.02, 0.0], moment=(0.0, np.inf, np.inf))
    assert nothing.probability([0.0, 0.0, -1.0], 0.6) == 0.0
