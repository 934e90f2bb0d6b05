"""What the reachable-space mixture is compared with: a flat Gaussian mixture and a voxel map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.special import logsumexp

from feasigrasp.models.arrays import Array, Indices

#: Variance added to each of the twelve dimensions of the flat mixture: rotation matrices fill only
#: three of their nine, so that without it every covariance is singular.
FLOOR = 1e-2


def flatten(X: Array) -> Array:
    """Rotation matrix and position as one vector, shape (n, 12)."""
    return np.concatenate([X[:, :3, :3].reshape(-1, 9), X[:, :3, 3]], axis=1)


@dataclass(frozen=True, eq=False)
class FlatMixture:
    """A Gaussian mixture over flattened poses (Kim et al., "Catching Objects in Flight", 2014).

    A log density is linear in the poses' products ``(1, x_i, x_i x_j)``, so that both steps of EM
    are matrix products.

    Attributes:
        coefficients: Log density with weight over these products, shape (91, K).
    """

    coefficients: Array

    @classmethod
    def fit(
        cls, X: Array, n_components: int, rng: np.random.Generator, iterations: int = 25
    ) -> FlatMixture:
        """Fits poses (n, 4, 4), starting at k-means++ clusters."""
        x = flatten(X)
        _, label = kmeans2(x, n_components, iter=5, minit="++", seed=rng)
        features = _products(x)
        r = np.zeros((len(x), n_components))
        r[np.arange(len(x)), label] = 1.0
        for _ in range(iterations):
            mixture = cls(_maximize(r.T @ features))
            log = features @ mixture.coefficients
            r = np.exp(log - logsumexp(log, axis=1, keepdims=True))
        return mixture

    def log_density(self, X: Array) -> Array:
        """Log density of poses (n, 4, 4), shape (n,)."""
        return np.asarray(logsumexp(_products(flatten(X)) @ self.coefficients, axis=1))


def _products(x: Array) -> Array:
    """``(1, x_i, x_i x_j with j <= i)``, shape (n, 91)."""
    rows, columns = np.tril_indices(x.shape[1])
    return np.concatenate([np.ones((len(x), 1)), x, x[:, rows] * x[:, columns]], axis=1)


def _maximize(moments: Array) -> Array:
    """Coefficients of the components from the sums of the products under each, shape (K, 91)."""
    moments = moments[moments[:, 0] > 12.0]
    rows, columns = np.tril_indices(12)
    coefficients = []
    for m in moments:
        mean, second = m[1:13] / m[0], np.zeros((12, 12))
        second[rows, columns] = second[columns, rows] = m[13:] / m[0]
        covariance = second - np.outer(mean, mean) + FLOOR * np.eye(12)
        precision = np.linalg.inv(covariance)
        constant = np.log(m[0] / moments[:, 0].sum()) - 6.0 * np.log(2.0 * np.pi)
        constant -= 0.5 * (np.linalg.slogdet(covariance)[1] + mean @ precision @ mean)
        square = np.where(rows == columns, -0.5, -1.0) * precision[rows, columns]
        coefficients.append(np.concatenate([[constant], precision @ mean, square]))
    return np.array(coefficients).T


class VoxelMap:
    """Counts of reached poses in cells: position x approach direction x roll about it.

    Directions are the 26 of a cube's faces, edges and corners; positions and rolls are even.
    """

    def __init__(self, X: Array, voxel: float = 0.1, rolls: int = 8) -> None:
        """Counts poses (n, 4, 4).

        Args:
            X: Reached poses.
            voxel: Edge of a position cell [m].
            rolls: Number of cells of the roll angle.
        """
        steps = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1)
        steps = steps.reshape(-1, 3)
        steps = steps[np.abs(steps).sum(axis=1) > 0]
        self._directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        self._voxel, self._rolls = voxel, rolls
        self._cells, self._counts = np.unique(self._cell(X), return_counts=True)

    def score(self, X: Array) -> Array:
        """How many of the counted poses share the cells of poses (n, 4, 4), shape (n,)."""
        cell = self._cell(X)
        index = np.minimum(np.searchsorted(self._cells, cell), len(self._cells) - 1)
        return np.where(self._cells[index] == cell, self._counts[index], 0).astype(float)

    def _cell(self, X: Array) -> Indices:
        z, x = X[:, :3, 2], X[:, :3, 0]
        direction = np.argmax(z @ self._directions.T, axis=1)
        # Roll against the horizontal that is perpendicular to z (against x, if z is vertical).
        side = np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], axis=1)
        side[np.hypot(z[:, 0], z[:, 1]) < 1e-9] = (1.0, 0.0, 0.0)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        up = np.cross(z, side)
        angle = np.arctan2(np.einsum("ni,ni->n", x, up), np.einsum("ni,ni->n", x, side))
        roll = np.floor((angle / (2 * np.pi) + 0.5) * self._rolls).astype(np.int64) % self._rolls
        position = np.floor(X[:, :3, 3] / self._voxel).astype(np.int64) + 64
        cell = (position[:, 0] * 128 + position[:, 1]) * 128 + position[:, 2]
        return (cell * len(self._directions) + direction) * self._rolls + roll
