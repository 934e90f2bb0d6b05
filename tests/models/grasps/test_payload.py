"""Grasps that carry: the weight decides which are offered, and simulation agrees."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.payload import (
    BEST,
    LEAST_PROBABILITY,
    MOMENT_SHARE,
    payload_filtered,
    rated_by_payload,
    with_loads,
)
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp_lab.runs.floating_gripper import FloatingGripper

GRIPPER = ParallelGripper()
#: A bar along y, gripped across x from above.
SIZE = np.array([0.03, 0.24, 0.04])
DOWN = (0.0, 0.0, -1.0)


@pytest.fixture(scope="module")
def bar():
    mesh = trimesh.creation.box(SIZE)
    return fit_gpdf(trimesh.sample.sample_surface_even(mesh, 1500, seed=0)[0])


def from_above(*y):
    X_OG = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(y), 1, 1))
    X_OG[:, 1, 3] = y
    return GraspSet(X_OG, np.full(len(y), SIZE[0]), np.full(len(y), 0.9))


def test_grasps_beside_the_centre_score_less_the_heavier_the_object(bar):
    grasps = from_above(0.0, 0.04, 0.09)
    light, heavy = (
        payload_filtered(with_loads(bar, grasps, GRIPPER, m), DOWN) for m in (0.05, 0.7)
    )
    assert len(light) == 3 and (light.score > 0.85).all()
    assert len(heavy) < 3 and heavy.rejected["too heavy there"] == 3 - len(heavy)
    np.testing.assert_array_equal(heavy.X_OG[0], grasps.X_OG[0])
    assert (np.diff(heavy.score) <= 0.0).all()


def test_where_nothing_carries_what_is_nearly_the_best_is_offered_still(bar):
    grasps = from_above(0.09, 0.05, 0.051)
    left = payload_filtered(with_loads(bar, grasps, GRIPPER, 2.0), DOWN)
    assert len(left) == 2 and left.rejected == {"too heavy there": 1}
    np.testing.assert_array_equal(left.X_OG[0], grasps.X_OG[1])


def test_how_much_too_heavy_an_object_is_changes_nothing(bar):
    """The best of bad grasps are as sure and score as much: guesses of masses are often wrong."""
    grasps = from_above(0.09, 0.05, 0.07)
    ratings = [rated_by_payload(with_loads(bar, grasps, GRIPPER, m), DOWN) for m in (2.0, 20.0)]
    for rating in ratings:
        np.testing.assert_array_equal(rating.X_OG[0], grasps.X_OG[1])
        assert rating.payload_score[0] == pytest.approx(BEST / LEAST_PROBABILITY)
    np.testing.assert_allclose(ratings[0].score, ratings[1].score)


def test_an_unknown_mass_is_a_guess_from_the_volume(bar):
    known, guessed = (with_loads(bar, from_above(0.09), GRIPPER, m).load for m in (0.23, None))
    assert guessed.body.mass == pytest.approx(0.24, rel=0.1)  # of 0.29 litres
    assert guessed.body.spread > 5.0 * known.body.spread
    heavy = replace(known, body=replace(known.body, mass=1.0))
    doubtful = replace(guessed, body=replace(guessed.body, mass=1.0))
    assert heavy.probability(DOWN)[0] < doubtful.probability(DOWN)[0]


def test_sets_without_loads_stay_as_they_are(bar):
    grasps = from_above(0.0, 0.09)
    assert payload_filtered(grasps, DOWN) is grasps
    empty = GraspSet.empty({"off the surface": 3})
    assert payload_filtered(with_loads(bar, empty, GRIPPER), DOWN) is empty


def test_loads_stay_with_their_grasps(bar):
    grasps = with_loads(bar, from_above(0.0, 0.05, 0.09), GRIPPER, 0.3)
    chosen = grasps.select(np.array([2, 0])).with_symmetric()
    np.testing.assert_allclose(
        chosen.load.probability(DOWN), grasps.load.probability(DOWN)[[2, 0, 2, 0]]
    )


def test_simulated_objects_turn_beyond_the_limit_and_not_below(bar):
    """Patches of a box are opposite each other: but for a part they bear all of their moment."""
    grasps = from_above(0.05)
    load = with_loads(bar, grasps, GRIPPER, 1.0).load
    body, moment = replace(load.body, centre_error=0.0), 0.75 / MOMENT_SHARE * load.moment
    exact = replace(load, body=body, moment=moment)
    limit = 1.0 / exact.per_kilogram(DOWN)[0]
    mesh = trimesh.creation.box(SIZE)
    turns = []
    for share in (0.5, 2.0):
        obj = RigidObject.of_mesh("bar", mesh, share * limit)
        turns.append(FloatingGripper(obj, GRIPPER).try_grasp(grasps.X_OG[0]).turn_deg)
    assert turns[0] < 5.0 and turns[1] > 15.0
