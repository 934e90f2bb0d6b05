"""``feasigrasp train diffusion``: noise and what it teaches, poses to learn from, the command."""

import csv

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.baselines.grasp_diffusion import GraspDiffusion
from feasigrasp_lab.results.finished import read_shard
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.household_shapes import make_shape
from feasigrasp_lab.training.diffusion_batches import with_noise
from feasigrasp_lab.training.train_diffusion import LEAST


def log_density(center, X, deviation):
    """Log density of a pose with normal noise, but for a constant, by the volume of the group."""
    v = se3.log(se3.inverse(center) @ X)
    volume = np.sinc(np.linalg.norm(v[:, :3], axis=1) / (2.0 * np.pi)) ** 4  # |det J_r|
    return -(v**2).sum(axis=1) / (2.0 * deviation**2) - np.log(volume)


def score(center, X, deviation):
    """Its gradient by a body twist, by central differences."""
    steps = [se3.exp(1e-5 * axis) for axis in np.eye(6)]
    differences = [
        log_density(center, X @ step, deviation)
        - log_density(center, X @ se3.inverse(step), deviation)
        for step in steps
    ]
    return np.stack(differences, axis=1) / 2e-5


@pytest.mark.parametrize("deviation", [0.03, 0.2, 0.7])
def test_the_noise_of_one_pose_points_down_its_density(deviation):
    rng = np.random.default_rng(0)
    X = se3.random_pose(rng, 1)
    noised, gradient = with_noise(np.repeat(X, 50, axis=0), np.full(50, deviation), rng)
    np.testing.assert_allclose(gradient, -score(X, noised, deviation), rtol=1e-4, atol=1e-3)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sampler_data")
    arguments = ["--objects", "8", "--inputs", "1", "--jobs", "1", "--seed", "3"]
    assert cli.main(["train", "sampler-data", "--out", str(folder), *arguments]) == 0
    return folder


def train(data, out, *arguments):
    sizes = ["--batch", "2", "--poses", "4", "--held-out", "1", "--every", "1", "--device", "cpu"]
    where = ["--data", str(data), "--out", str(out), "--jobs", "1"]
    return cli.main(["train", "diffusion", *where, *sizes, *arguments])


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("diffusion")
    assert train(data, out, "--steps", "2") == 0
    return out


def test_it_leaves_weights_and_goes_on(data, trained, capsys):
    GraspDiffusion.load(trained / "grasp_diffusion.npz")
    assert train(data, trained, "--steps", "3") == 0
    with (trained / "curve.csv").open() as file:
        assert [row["step"] for row in csv.DictReader(file)] == ["1", "2", "3"]
    assert train(data, trained, "--steps", "4", "--seed", "1") != 0
    assert "holds a run with" in capsys.readouterr().err


def test_it_learns_from_valid_grasps_and_true_distances(data, trained):
    made = read_shard(next((trained / "poses").glob("*.npz")), ("X_OG", "places", "distance"))
    source = read_shard(next(data.glob("*.npz")), ("family", "object_seed", "contact"))
    graspable = np.flatnonzero(source["contact"].any(axis=1))
    assert len(made["X_OG"]) > 1
    row = int(graspable[0])
    truth = TrueGrasps(make_shape(str(source["family"][row]), int(source["object_seed"][row])).mesh)
    X_OG = np.unique(made["X_OG"][0].astype(float), axis=0)
    assert len(X_OG) >= LEAST
    assert truth.valid(X_OG, ParallelGripper()).mean() > 0.98  # float32 moves some off the edge
    off, _ = truth.closest(made["places"][0].astype(float))
    np.testing.assert_allclose(
        np.linalg.norm(off - made["places"][0], axis=1), np.abs(made["distance"][0]), atol=1e-6
    )


def test_without_data_it_says_what_makes_some(tmp_path, capsys):
    assert train(tmp_path, tmp_path / "out") != 0
    assert "feasigrasp train sampler-data" in capsys.readouterr().err
