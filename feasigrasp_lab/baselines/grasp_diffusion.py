"""Grasp diffusion: gradient of the energy at a hand pose, and pose samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.weights_file import WeightArrays, WeightsFormat
from feasigrasp_lab import WEIGHTS
from feasigrasp_lab.baselines.diffusion_energy import LENGTH, Cloud, PoseEnergy, standard_deviation
from feasigrasp_lab.networks import fill_network, network_arrays, seeded

#: Time at the last step: noise of 4 mm and 1.8 degrees. Source: guessed.
LAST_TIME = 1e-3
#: Initial positions are drawn at this distance from the center of the object [m]. Source: guessed.
_SPREAD = 0.1
_FILE = WeightsFormat(
    "grasp diffusion", "feasigrasp grasp_diffusion 1", "feasigrasp train diffusion"
)


@dataclass(frozen=True, eq=False)
class DiffusedObject(Frozen):
    """An object as input of the energy.

    Attributes:
        network: The energy.
        cloud: The encoded cloud of one object.
        middle: Mean of its points in O, shape (3,) [m].
    """

    network: PoseEnergy
    cloud: Cloud
    middle: Array

    def gradient(self, X_OG: Array, time: ArrayLike = LAST_TIME) -> Array:
        """Gradient of the energy by body twists [angular; linear], (n, 6) [1/rad; 1/m].

        Args:
            X_OG: Hand poses, shape (n, 4, 4).
            time: Noise level, in [0, 1], one for all or shape (n,).
        """
        with torch.inference_mode(False):
            R = torch.from_numpy(np.ascontiguousarray(X_OG[:, :3, :3])).float()[None]
            p = torch.from_numpy((X_OG[:, :3, 3] - self.middle) / LENGTH).float()[None]
            levels = np.broadcast_to(np.asarray(time, dtype=np.float32), len(X_OG))
            times = torch.from_numpy(levels.copy())[None]
            found = self.network.gradient(self.cloud, R, p, times)[0].double().numpy()
        found[:, 3:] /= LENGTH
        return np.asarray(found)

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """Hand poses drawn by annealed Langevin dynamics on SE(3).

        ``X <- X exp(-a/2 grad E + sqrt(a) z)`` with a falling as the variance of the noise; then
        without z at the least of it.

        Args:
            count: Their number.
            rng: Draws them.

        Returns:
            Shape (count, 4, 4), in O.
        """
        X = se3.random_pose(rng, count)
        X[:, :3, 3] = self.middle + _SPREAD * rng.standard_normal((count, 3))
        units = np.repeat([1.0, LENGTH], 3)
        for time, noisy in _schedule():
            # Square of the step over the noise, at the last one [rad^2 or units^2].
            a = 1e-3 * float(noise_variance(time) / noise_variance(LAST_TIME))
            step = -0.5 * a * self.gradient(X, time) * units  # per unit of length
            if noisy:
                step += np.sqrt(a) * rng.standard_normal((count, 6))
            X = X @ se3.exp(step * units)
        return X


@dataclass(frozen=True, eq=False)
class GraspDiffusion(Frozen):
    """A trained energy over hand poses.

    Attributes:
        network: Its torch module.
    """

    network: PoseEnergy

    @classmethod
    def untrained(cls, seed: int = 0) -> GraspDiffusion:
        """Random weights, to train or to test."""
        return cls(seeded(PoseEnergy, seed).eval().requires_grad_(False))

    @classmethod
    def load(cls, path: str | Path) -> GraspDiffusion:
        """Loads what `save` wrote.

        Raises:
            WeightsError: The file is missing, broken, or of another network.
        """
        return _FILE.load(path, cls._of)

    @classmethod
    def _of(cls, _: dict[str, Any], arrays: WeightArrays) -> GraspDiffusion:
        network = PoseEnergy()
        fill_network(network, arrays)
        return cls(network.eval().requires_grad_(False))

    def save(self, path: str | Path) -> None:
        """Writes the weights into one ``.npz`` file, whole or not at all."""
        _FILE.save(path, {}, network_arrays(self.network))

    def at(self, surface: GraspInput) -> DiffusedObject:
        """The energy of one object.

        Args:
            surface: Points and normals of its completed surface, in O; n > 0.
        """
        middle = surface.points.mean(axis=0, dtype=float)
        points = torch.from_numpy((surface.points - middle) / LENGTH).float()[None]
        with torch.no_grad():
            cloud = self.network.encode(points, torch.from_numpy(surface.normals.copy())[None])
        return DiffusedObject(self.network, cloud, middle)


@lru_cache(maxsize=1)
def load_grasp_diffusion() -> GraspDiffusion:
    """The energy that comes with the package."""
    return GraspDiffusion.load(WEIGHTS / "grasp_diffusion.npz")


def noise_variance(time: ArrayLike) -> Array:
    """Of the noise at times in [0, 1] [rad^2 or units^2]."""
    times = torch.as_tensor(np.asarray(time, dtype=float))
    return np.asarray(standard_deviation(times) ** 2)


def _schedule() -> list[tuple[float, bool]]:
    """Noise levels of the steps, and whether noise is added."""
    # Annealed steps of Langevin dynamics, and those that follow at the least noise and without any.
    annealed_steps, settling_steps = 70, 50
    annealed = [(float(time), True) for time in np.geomspace(1.0, LAST_TIME, annealed_steps)]
    return annealed + [(LAST_TIME, False)] * settling_steps
