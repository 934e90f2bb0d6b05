"""The stream of training examples: the same again, and what a shard holds."""

import argparse

import numpy as np
import pytest
import trimesh

from feasigrasp.models.grasps.network.surface_input import SCALARS
from feasigrasp_lab.training import train_sampler_data
from feasigrasp_lab.training.data.grasp_examples import (
    POINTS,
    completed_input,
    true_input,
)
from feasigrasp_lab.training.data.grasp_labels import N_TURNS
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.household_shapes import (
    HELD_OUT,
    HELD_OUT_EVERY,
    TRAINED,
    make_shape,
    shape_of,
)
from feasigrasp_lab.training.data.views import ViewedObject

SHAPES = {
    "points": (POINTS, 3),
    "normals": (POINTS, 3),
    "scalars": (POINTS, len(SCALARS)),
    "contact": (POINTS,),
    "width": (POINTS,),
    "closing": (POINTS, 3),
    "across": (POINTS, 3),
    "free": (POINTS, N_TURNS),
}


def run(folder, *words):
    parser = argparse.ArgumentParser()
    train_sampler_data.add_arguments(parser)
    args = parser.parse_args(["--out", str(folder), "--jobs", "1", "--inputs", "1", *words])
    assert train_sampler_data.main(args) == 0


@pytest.fixture(scope="module")
def shard(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    run(folder, "--objects", "8")
    return folder / "shape_00000.npz"


def test_a_shard_holds_what_is_agreed(shard):
    content = np.load(shard)
    n = len(content["family"])
    assert 7 <= n <= 8
    for name, shape in SHAPES.items():
        assert content[name].shape == (n, *shape), name
        assert np.isfinite(content[name].astype(float)).all(), name
    contact = content["contact"]
    assert 0.1 < contact.mean() < 0.9
    np.testing.assert_allclose(np.linalg.norm(content["closing"][contact], axis=-1), 1, atol=1e-5)
    assert (content["width"][~contact] == 0).all() and (content["width"][contact] > 0).all()
    assert (content["free"].any(axis=-1) == contact).all()
    assert (content["true_surface"] == (content["n_views"] == 0)).all()


def test_the_stream_is_told_by_its_seed(shard, tmp_path):
    run(tmp_path, "--objects", "8")
    again, first = np.load(tmp_path / shard.name), np.load(shard)
    for name in first.files:
        np.testing.assert_array_equal(first[name], again[name])


def test_finished_shards_are_left_alone(shard):
    before = shard.stat().st_mtime_ns
    run(shard.parent, "--objects", "8")
    assert shard.stat().st_mtime_ns == before


def test_one_object_in_eight_is_held_out():
    families = [shape_of(i)[0] for i in range(3 * HELD_OUT_EVERY)]
    held = [i for i, family in enumerate(families) if family in HELD_OUT]
    assert held == [HELD_OUT_EVERY * k - 1 for k in (1, 2, 3)]
    assert {families[i] for i in held} == set(HELD_OUT)
    assert set(families) - set(HELD_OUT) == set(TRAINED)


def test_true_surfaces_have_exact_chords():
    truth = TrueGrasps(make_shape("box", 1).mesh)
    made = true_input(truth, np.random.default_rng(0))
    points, normals = made.points.astype(float), made.normals.astype(float)
    assert np.linalg.norm(truth.closest(points)[0] - points, axis=1).max() < 1e-5
    chord = made.scalars[:, 1].astype(float)
    hit = chord > 0
    ends = points[hit] - chord[hit, None] * normals[hit]
    assert np.linalg.norm(truth.closest(ends)[0] - ends, axis=1).max() < 1e-4


@pytest.mark.parametrize(("radius", "chord"), [(0.034, 0.068), (0.05, 0.004)])
def test_chords_of_a_tube_end_where_the_pads_would(radius, chord):
    """On its far outside if it fits between the pads, else on the inside of its wall."""
    tube = trimesh.creation.annulus(radius - 0.004, radius, 0.08, sections=128)
    made = true_input(TrueGrasps(tube), np.random.default_rng(0))
    outward = np.einsum("ij,ij->i", made.points[:, :2], made.normals[:, :2])
    outside = outward > 0.9 * radius
    assert outside.sum() > 100
    np.testing.assert_allclose(made.scalars[outside, 1], chord, atol=5e-4)
    inside = outward < -0.5 * radius
    np.testing.assert_allclose(made.scalars[inside, 1], 0.004, atol=5e-4)


def test_views_make_an_input_near_the_surface():
    obj = make_shape("bottle", 3)
    viewed = ViewedObject(obj)
    made = completed_input(viewed, 3, np.random.default_rng(2))
    assert made is not None and len(made) == POINTS
    assert np.median(viewed.surface.distance(made.points.astype(float))) < 0.002
