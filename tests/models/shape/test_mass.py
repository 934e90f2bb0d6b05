"""Mass and centre of mass of completed shapes, against meshes."""

import numpy as np
import pytest
import trimesh

from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.models.shape.mass import DENSITY, estimate_mass


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
    assert estimate.mass == pytest.approx(DENSITY * mesh.volume, rel=0.12)
    np.testing.assert_allclose(estimate.p_OC, mesh.center_mass + shift, atol=0.003)


def test_a_weighed_object_has_its_mass():
    field = field_of(trimesh.creation.box((0.05, 0.08, 0.12)))
    guessed, weighed = estimate_mass(field), estimate_mass(field, 1.25)
    assert weighed.mass == 1.25 and weighed.spread < 0.1 < guessed.spread
    np.testing.assert_array_equal(weighed.p_OC, guessed.p_OC)
