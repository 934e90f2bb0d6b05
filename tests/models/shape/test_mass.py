"""Mass and centre of mass of completed shapes, against meshes."""

import numpy as np
import pytest
import trimesh

from feasigrasp.models.grasps.payload import (
    MASS_SPREAD,
    TYPICAL_MASS,
    TYPICAL_VOLUME,
    estimate_mass,
)
from feasigrasp.models.objects.rigid_object import find_objects, load_object
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.resources import model_path


def field_of(mesh):
    return fit_gpdf(trimesh.sample.sample_surface_even(mesh, 1500, seed=0)[0])


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.box((0.05, 0.08, 0.12)),
        trimesh.creation.cylinder(0.03, 0.12),
        trimesh.creation.cone(0.04, 0.10),
    ],
    ids=["box", "cylinder", "cone"],
)
def test_volume_and_centre_are_those_of_the_mesh(mesh):
    shift = np.array([0.3, -0.2, 0.5])
    estimate = estimate_mass(field_of(mesh.copy().apply_translation(shift)))
    typical = TYPICAL_MASS * (mesh.volume / TYPICAL_VOLUME) ** (2 / 3)
    assert estimate.mass == pytest.approx(typical, rel=0.1)
    np.testing.assert_allclose(estimate.p_OC, mesh.center_mass + shift, atol=0.003)


def test_a_weighed_object_has_its_mass():
    field = field_of(trimesh.creation.box((0.05, 0.08, 0.12)))
    guessed, weighed = estimate_mass(field), estimate_mass(field, 1.25)
    assert weighed.mass == 1.25 and weighed.spread < 0.1 < guessed.spread
    np.testing.assert_array_equal(weighed.p_OC, guessed.p_OC)


def test_most_objects_weigh_what_is_expected():
    """Of the built-in ones two thirds within a standard deviation, nearly all within two."""
    off = []
    for obj in map(load_object, find_objects(model_path("objects")).values()):
        guessed = estimate_mass(field_of(obj.mesh)).mass
        off.append(abs(np.log(obj.mass / guessed)) / MASS_SPREAD)
    assert np.mean(np.array(off) < 1.0) > 0.6
    assert np.mean(np.array(off) < 2.0) > 0.85
