"""Fits Riemannian mixtures by EM: fixed size, selected size, and warm start."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.geometry import se3
from feasigrasp.models.quantities import POSES, Count, Number, Positive
from feasigrasp_lab.mixtures.em import expectation_maximization
from feasigrasp_lab.mixtures.mixture import RiemannianMixture, bic

#: The distance that weighs as much as one radian in seeding [m/rad]. Source: guessed.
LENGTH_SCALE = 0.1


def seed_means(X: Array, draws: Array) -> tuple[Indices, float]:
    """Greedy k-means++ (Arthur, Vassilvitskii 2007) in the metric angle^2 + (distance / scale)^2.

    Args:
        X: Poses, shape (n, 4, 4) [m].
        draws: Uniform variates in [0, 1), shape (K, candidates): the randomness.

    Returns:
        Indices of at most K distinct seeds, and the root mean square distance to the nearest
        seed per tangent dimension [rad].
    """
    # Squared distance [rad^2] under which a pose counts as a duplicate of a seed.
    duplicate = 1e-12
    n, quaternions, positions = len(X), se3.quaternions(X), X[:, :3, 3] / LENGTH_SCALE
    seeds: list[int] = []
    nearest, chance = np.full(n, np.inf), np.ones(n)
    for row in draws:
        if seeds and nearest.mean() <= duplicate:
            break
        cumulative = np.cumsum(chance)
        found = []
        for i in np.searchsorted(cumulative, row * cumulative[-1], side="right"):
            angle = 2.0 * np.arccos(np.minimum(1.0, np.abs(quaternions @ quaternions[i])))
            square = angle**2 + ((positions - positions[i]) ** 2).sum(axis=1)
            square = np.minimum(square, nearest)
            found.append((float(square.sum()), int(i), square))
        _, seed, nearest = min(found, key=itemgetter(0))
        seeds.append(seed)
        chance = nearest
    return np.array(seeds), math.sqrt(nearest.mean() / 6.0)


@checked(GraspError)
def fit_riemannian_mixture(
    X: Annotated[ArrayLike, POSES],
    n_components: Count,
    rng: np.random.Generator,
    *,
    rotation_floor: Positive = 0.05,
    translation_floor: Positive = 0.005,
    max_iterations: Count = 50,
    tolerance: float = 1e-4,
) -> RiemannianMixture:
    """Fits a mixture to poses by expectation maximisation with Riemannian means.

    Components start at k-means++ seeds. Each M step iterates every mean to convergence and adds
    the squared floors once to the diagonal of every covariance. A component that is left with
    less than one effective pose is dropped, and K never exceeds the number of distinct poses.
    The fit of ``T X`` is ``T`` times the fit of ``X`` for the same state of ``rng``.

    Args:
        X: Poses, shape (n, 4, 4), n >= 1 [m].
        n_components: Number of components K wanted; the result may have fewer.
        rng: Source of randomness of the seeds.
        rotation_floor: Standard deviation added to every rotational direction [rad].
        translation_floor: Standard deviation added to every translational direction [m].
        max_iterations: Upper bound on the number of EM iterations.
        tolerance: EM ends when the mean log likelihood per pose gains less than this.

    Raises:
        GraspError: If X is empty, not finite or not rigid, or a parameter is out of range.
    """
    settings = max_iterations, tolerance, rotation_floor, translation_floor
    return _Problem(np.asarray(X), *settings).seeded(n_components, rng).mixture


@checked(GraspError)
def fit_best_mixture(
    X: Annotated[ArrayLike, POSES],
    rng: np.random.Generator,
    max_components: Count = 10,
    *,
    start: RiemannianMixture | None = None,
    max_rotation: Annotated[float, Number(above=0.0, most=math.pi)] = math.pi,
) -> RiemannianMixture:
    """The fit with the lowest Bayesian information criterion (BIC).

    Without ``start`` the candidates are seeded fits of K = 1 ... ``max_components``. With it there
    are three, so that components persist from one set of poses to a similar one and the fit is
    quick: EM from ``start``; the same with one component more, at the pose that ``start`` explains
    least; and with one less, without its lightest.

    Args:
        X: Poses, shape (n, 4, 4), n >= 1 [m].
        rng: Source of randomness of the seeds.
        max_components: Largest K.
        start: A mixture fitted to similar poses.
        max_rotation: Fits that leave a pose farther than this from all means [rad] are taken only
            if all do. A wide Gaussian that straddles opposite hand poses has its mean where no
            pose is; BIC alone can prefer it when poses are few.

    Raises:
        GraspError: As :func:`fit_riemannian_mixture`.
    """
    # Coarser than a fit alone: most of these are thrown away.
    problem = _Problem(np.asarray(X), max_iterations=20, tolerance=1e-3)
    most = max(1, min(max_components, len(problem.X)))
    if start is None:
        fits = [problem.seeded(k, rng) for k in range(1, most + 1)]
    else:
        fits = problem.continued(start, most)
    return min(fits, key=lambda fit: fit.cost(problem, max_rotation)).mixture


@dataclass(frozen=True, eq=False)
class _Fit:
    """What EM found, and the log likelihood of the poses under it."""

    mixture: RiemannianMixture
    log_likelihood: float

    def cost(self, problem: _Problem, max_rotation: float) -> tuple[bool, float]:
        """Sorts by whether a pose is too far from all means, then by BIC."""
        criterion = bic(len(self.mixture), len(problem.X), self.log_likelihood)
        if max_rotation >= math.pi:
            return False, criterion
        cosine = np.abs(se3.quaternions(problem.X) @ se3.quaternions(self.mixture.means).T)
        return bool(cosine.max(axis=1).min() < math.cos(0.5 * max_rotation)), criterion


@dataclass(eq=False)
class _Problem:
    """Poses (n, 4, 4) to fit to, and how to fit."""

    X: Array
    max_iterations: int
    tolerance: float
    rotation_floor: float = 0.05
    translation_floor: float = 0.005
    scale: Array = field(init=False)
    floor: Array = field(init=False)

    def __post_init__(self) -> None:
        if len(self.X) == 0:
            raise GraspError("a mixture's X is empty; give poses (n, 4, 4), n >= 1")
        self.scale = np.array([1.0] * 3 + [LENGTH_SCALE] * 3)
        floors = [self.rotation_floor] * 3 + [self.translation_floor] * 3
        self.floor = np.array(floors) ** 2

    def seeded(self, n_components: int, rng: np.random.Generator) -> _Fit:
        """EM from k-means++ seeds."""
        draws = rng.random((min(n_components, len(self.X)), 4))
        seeds, spread = seed_means(self.X, draws)
        k = len(seeds)
        covariance = np.diag(spread**2 * self.scale**2 + self.floor)
        return self._em(np.full(k, 1.0 / k), self.X[seeds], np.tile(covariance, (k, 1, 1)))

    def continued(self, start: RiemannianMixture, max_components: int) -> list[_Fit]:
        """EM from ``start``, from one component more and from one less, as far as allowed."""
        keep = np.sort(np.argsort(-start.weights, kind="stable")[:max_components])
        weights, means = start.weights[keep] / start.weights[keep].sum(), start.means[keep]
        covariances, k = start.covariances[keep], len(keep)
        fits = [self._em(weights, means, covariances)]
        if k < max_components:
            lonely = int(np.argmin(start.log_density(self.X)))
            share = 1.0 / (k + 1)
            fits.append(
                self._em(
                    np.append((1.0 - share) * weights, share),
                    np.concatenate([means, self.X[lonely, None]]),
                    np.concatenate([covariances, covariances.mean(axis=0, keepdims=True)]),
                )
            )
        if k > 1:
            rest = np.arange(k) != int(np.argmin(weights))
            fits.append(
                self._em(weights[rest] / weights[rest].sum(), means[rest], covariances[rest])
            )
        return fits

    def _em(self, weights: Array, means: Array, covariances: Array) -> _Fit:
        start, stop = (weights, means, covariances), (self.max_iterations, self.tolerance)
        *found, history = expectation_maximization(self.X, *start, self.floor, *stop)
        return _Fit(RiemannianMixture(*found), history[-1])
