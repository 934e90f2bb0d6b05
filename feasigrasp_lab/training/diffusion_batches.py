"""Batches for grasp diffusion: clouds, noisy hand poses, and target scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.geometry import se3
from feasigrasp_lab.baselines.diffusion_energy import LENGTH, standard_deviation
from feasigrasp_lab.results.finished import read_shards
from feasigrasp_lab.training.loop import TrainingError, split_families

#: Least time, at which noise is 2.6 mm and 1.2 degrees. Source: guessed.
LEAST_TIME = 4.5e-4
_ENTRIES = ("points", "normals", "X_OG", "places", "distance", "family")


class Batch(NamedTuple):
    """What one step sees, lengths in units and relative to the mean of each of B clouds.

    Attributes:
        points: Shape (B, n, 3).
        normals: Shape (B, n, 3).
        R: Rotations of noised hands, shape (B, P, 3, 3).
        p: Their positions, shape (B, P, 3).
        time: Noise levels in [0, 1], shape (B, P).
        gradient: What the gradient of the energy there should be, shape (B, P, 6).
        places: Shape (B, S, 3).
        axes: Random axes there, shape (B, S, 3, 3).
        times: Random noise levels there, shape (B, S).
        distance: Signed distances of the places, shape (B, S).
    """

    points: Tensor
    normals: Tensor
    R: Tensor
    p: Tensor
    time: Tensor
    gradient: Tensor
    places: Tensor
    axes: Tensor
    times: Tensor
    distance: Tensor


#: The arrays of some examples by name, as `feasigrasp_lab.training.train_diffusion` writes them.
PoseExamples = dict[str, NDArray[Any]]


def drawn_batch(
    examples: PoseExamples, rows: Indices, rng: np.random.Generator, poses: int
) -> Batch:
    """Some examples with noise.

    Args:
        examples: All of them.
        rows: Which.
        rng: Draws everything.
        poses: Hand poses beside each cloud.
    """
    # Points of a cloud and places beside it that a step looks at.
    points, places, B = 256, 64, len(rows)
    some = rng.random((B, examples["points"].shape[1])).argsort(1)[:, :points]
    cloud, normals = (
        examples[name][rows[:, None], some].astype(float) for name in ("points", "normals")
    )
    mean = cloud.mean(axis=1, keepdims=True)
    kept = rng.integers(examples["X_OG"].shape[1], size=(B, poses))
    X = examples["X_OG"][rows[:, None], kept].astype(float)
    X[..., :3, 3] = (X[..., :3, 3] - mean) / LENGTH
    time = rng.uniform(LEAST_TIME, 1.0, (B, poses))
    deviation = standard_deviation(torch.from_numpy(time)).numpy().astype(float)
    noised, gradient = with_noise(X, deviation, rng)
    where = rng.integers(examples["places"].shape[1], size=(B, places))
    at = (examples["places"][rows[:, None], where] - mean) / LENGTH
    axes = se3.rotations(rng.standard_normal((B, places, 4)))
    times = rng.uniform(LEAST_TIME, 1.0, (B, places))
    distance = examples["distance"][rows[:, None], where] / LENGTH
    parts = (
        *((cloud - mean) / LENGTH, normals, noised[..., :3, :3], noised[..., :3, 3]),
        *(time, gradient, at, axes, times, distance),
    )
    return Batch(*(torch.from_numpy(np.ascontiguousarray(part)).float() for part in parts))


def with_noise(X: Array, deviation: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Poses moved by Gaussian noise in their own tangent spaces, and where the noise points.

    The density of ``X exp(v)``, v normal with the same deviation in all six directions, by the
    volume of the group is ``N(v) / |det J_r(v)|``. The gradient of its negative logarithm by a
    body twist there is what denoising score matching teaches.

    Args:
        X: Poses in units, shape (..., 4, 4).
        deviation: Shape (...).
        rng: Draws the noise.

    Returns:
        The noised poses, shape (..., 4, 4), and the gradients, shape (..., 6).
    """
    v = rng.standard_normal((*X.shape[:-2], 6)) * deviation[..., None]
    slope = v / deviation[..., None] ** 2
    angle = np.linalg.norm(v[..., :3], axis=-1, keepdims=True)
    # J_r of SE(3) has the determinant of that of SO(3) squared, (2 (1 - cos) / angle^2)^2.
    by_volume = 2.0 * (1.0 / np.tan(0.5 * angle) - 2.0 / angle)
    slope[..., :3] += by_volume * v[..., :3] / angle
    gradient = np.einsum("...ji,...j->...i", se3.right_jacobian_inverse(v), slope)
    return X @ se3.exp(v), gradient


def load_pose_examples(
    files: Sequence[Path], seed: int, n_held_out: int
) -> tuple[PoseExamples, PoseExamples]:
    """Reads shards; examples to train on, and some of the families that are held out.

    Raises:
        TrainingError: One side would be empty.
        InputError: A shard is broken.
    """
    if not files:
        raise TrainingError("no example has enough grasps; make more objects")
    everything = read_shards(files, _ENTRIES)
    rest, held = (
        {name: array[rows] for name, array in everything.items()}
        for rows in split_families(everything["family"], "there are grasps", seed, n_held_out)
    )
    return rest, held
