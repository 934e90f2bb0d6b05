"""Weights of the grasp networks: saved, loaded, and refused when they are wrong."""

import copy
import json

import numpy as np
import pytest

from feasigrasp.models.grasps.network.network import GraspNetwork
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.weights_file import WeightsError
from feasigrasp_lab.paper.grasp_network import NETWORKS, trained_network

#: Semi-axes of an ellipsoid of 4 x 6 x 10 cm [m].
RADII = np.array([0.02, 0.03, 0.05])


def ellipsoid(seed, n=120):
    """Input of a network on the ellipsoid: its surface, and what the inward normals meet."""
    direction = np.random.default_rng(seed).normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = direction * RADII
    normals = normals_at(points)
    # Where p - t n is on the ellipsoid again.
    chord = 2 * np.sum(points * normals / RADII**2, axis=1) / np.sum((normals / RADII) ** 2, axis=1)
    cosine = np.sum(normals * normals_at(points - chord[:, None] * normals), axis=1)
    small = np.full(n, 1e-3)
    scalars = np.stack([small, chord, cosine, small], axis=1)
    return GraspInput(*(x.astype(np.float32) for x in (points, normals, scalars)))


def normals_at(points):
    normals = points / RADII**2
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def graspable(surface):
    """Where the hand fits round the ellipsoid and both faces are opposed enough to hold it."""
    chord, cosine = surface.scalars[:, 1], surface.scalars[:, 2]
    return (chord < 0.08) & (cosine < -np.cos(np.deg2rad(40.0)))


@pytest.mark.parametrize("preset", NETWORKS)
def test_loaded_is_what_was_saved(preset, tmp_path):
    network = NETWORKS[preset].untrained(seed=7)
    network.save(tmp_path / "weights.npz")
    assert [file.name for file in tmp_path.iterdir()] == ["weights.npz"]
    loaded = NETWORKS[preset].load(tmp_path / "weights.npz")
    assert loaded.preset == preset
    surface = ellipsoid(17)
    a, b = network.propose(surface), loaded.propose(surface)
    np.testing.assert_array_equal(a.contact, b.contact)
    np.testing.assert_array_equal(a.approach, b.approach)


@pytest.mark.parametrize("preset", NETWORKS)
def test_the_trained_networks_are_there(preset):
    network = trained_network(preset)
    assert trained_network(preset) is network
    assert copy.deepcopy(network) is network


@pytest.mark.parametrize("preset", NETWORKS)
def test_the_weights_are_those_of_a_trained_network(preset):
    """It tells where the ellipsoid can be held; networks with random weights do not."""
    surface = ellipsoid(18, n=512)
    holds = graspable(surface)

    def told_apart(network):
        contact = network.propose(surface).contact
        return contact[holds].mean() - contact[~holds].mean()

    assert told_apart(trained_network(preset)) > 0.15
    assert max(told_apart(NETWORKS[preset].untrained(seed)) for seed in range(3)) < 0.05


def test_missing_weights_are_named(tmp_path):
    with pytest.raises(WeightsError, match="no grasp network weights.*train sampler"):
        GraspNetwork.load(tmp_path / "grasp_network.npz")


def broken_files():
    name = "second.weight"
    header = {"format": "feasigrasp grasp_network 1", "preset": "default"}
    sizes = {"vectors": 24, "hidden": 128, "ring": 32}

    def made(**changes):
        return {"header": np.array(json.dumps({**header, "sizes": sizes, **changes}))}

    return [
        ("no header", lambda arrays: arrays.pop("header"), "header"),
        ("another format", made(format="grasps 7"), "format is 'grasps 7'"),
        ("another preset", made(preset="paper", sizes={}), "holds preset paper, not default"),
        ("unknown preset", made(preset="best"), "holds preset best"),
        ("other sizes", made(sizes={**sizes, "hidden": 8}), "not float32"),
        ("unknown sizes", made(sizes={"depth": 3}), "depth"),
        ("array missing", lambda arrays: arrays.pop(name), f"missing: .*{name}"),
        ("array too many", {"extra": np.zeros(3)}, "unknown: .*extra"),
        ("array too small", {name: np.zeros((2, 2), dtype=np.float32)}, "not float32"),
        ("not finite", {name: np.full((128, 128), np.nan, dtype=np.float32)}, "not finite"),
        ("a pickle", {name: np.array([{}], dtype=object)}, "is no whole npz file"),
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [pytest.param(change, message, id=name) for name, change, message in broken_files()],
)
def test_broken_weights_are_named(tmp_path, change, message):
    NETWORKS["default"].untrained().save(tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as file:
        arrays = dict(file)
    if callable(change):
        change(arrays)
    else:
        arrays.update(change)
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(WeightsError, match=message):
        GraspNetwork.load(tmp_path / "bad.npz")
    (tmp_path / "text.npz").write_text("weights")
    with pytest.raises(WeightsError, match="is no whole npz file"):
        GraspNetwork.load(tmp_path / "text.npz")
