"""Generated shapes are closed solids of household size, told by their seeds."""

import numpy as np
import pytest

from feasigrasp.errors import MeshError
from feasigrasp_lab.training.data.household_shapes import (
    FAMILIES,
    HELD_OUT,
    TRAINED,
    make_shape,
    shape_of,
)


@pytest.mark.parametrize("family", FAMILIES)
def test_shapes_are_closed_solids_of_their_size(family):
    for seed in range(6):
        obj = make_shape(family, seed)
        mesh = obj.mesh
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
        assert 0.019 < obj.extents.max() < 0.261
        np.testing.assert_allclose(mesh.center_mass, 0.0, atol=1e-6)
        assert len(obj.faces) <= 4000
        assert 0.02 <= obj.mass <= 0.6
        np.testing.assert_allclose(
            obj.inertia, mesh.moment_inertia * obj.mass / mesh.volume, rtol=1e-4, atol=1e-9
        )


def test_same_seed_same_shape_and_other_seed_another():
    first, again, other = (make_shape("compound", seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    assert len(first.vertices) != len(other.vertices) or not np.allclose(
        first.vertices, other.vertices
    )


def test_open_vessels_are_hollow():
    for family in ("cup", "bowl", "mug"):
        mesh = make_shape(family, 1).mesh
        assert mesh.volume < 0.6 * mesh.convex_hull.volume


def test_families_are_split():
    assert set(HELD_OUT) | set(TRAINED) == set(FAMILIES)
    assert not set(HELD_OUT) & set(TRAINED)


def test_stream_visits_families_in_turn():
    n = len(TRAINED)
    visited = [shape_of(i) for i in range(4 * n)]
    trained = [family for family, _ in visited if family in TRAINED]
    assert trained[: 3 * n] == 3 * list(TRAINED)
    assert len(set(visited)) == 4 * n
    assert shape_of(0, seed=1) != shape_of(0, seed=2)


def test_unknown_family():
    with pytest.raises(MeshError, match="sofa"):
        make_shape("sofa", 0)
