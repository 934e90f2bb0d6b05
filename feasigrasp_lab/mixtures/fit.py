"""Fits Riemannian mixtures by EM: fixed size, selected size, and warm start."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp.models.quantities import POSES, Count, Number, Positive
from feasigrasp_lab.mixtures.em import Samples, Stop, expectation_maximization
from feasigrasp_lab.mixtures.mixture import RiemannianMixture, bic

#: The distance that weighs as much as one radian in seeding [m/rad]. Source: guessed.
LENGTH_SCALE = 0.1


@compiled
def seed_means(
    quaternions: Array, positions: Array, weights: Array, length_scale: float, draws: Array
) -> tuple[Indices, float]:
    """Greedy k-means++ in the metric angle^2 + (distance / length_scale)^2.

    Args:
        quaternions: Unit quaternions, shape (4, n).
        positions: Positions, shape (3, n) [m].
        weights: Weight of each pose, shape (n,).
        length_scale: Metres that weigh as much as a radian.
        draws: Uniform variates in [0, 1), shape (K, candidates): the randomness.

    Returns:
        Indices of at most K distinct seeds, and the root mean square distance to the nearest
        seed per tangent dimension [rad].
    """
    n, k = len(weights), len(draws)
    seeds = np.empty(k, dtype=np.int64)
    nearest = np.full(n, np.inf)
    candidate, best = np.empty(n), np.empty(n)
    count, potential = 0, np.inf
    for i in range(k):
        # Squared distance [rad^2] under which a pose counts as a duplicate of a seed.
        if i > 0 and potential <= 1e-12 * n:
            break
        lowest = np.inf
        for j in range(draws.shape[1]):
            index = _draw(weights, nearest, draws[i, j], i == 0)
            _squared_distances(quaternions, positions, index, length_scale, candidate)
            total = 0.0
            for m in range(n):
                candidate[m] = min(candidate[m], nearest[m])
                total += weights[m] * candidate[m]
            if total < lowest:
                lowest, seeds[i] = total, index
                candidate, best = best, candidate
        nearest, best = best, nearest
        potential, count = lowest, i + 1
    return seeds[:count], math.sqrt(potential / 6.0 / len(weights))


@compiled
def _draw(weights: Array, nearest: Array, uniform: float, first: bool) -> int:
    """Index drawn with probability weight (times squared distance after the first seed)."""
    total = 0.0
    for i in range(len(weights)):
        total += weights[i] * (1.0 if first else nearest[i])
    target, chosen, reached = uniform * total, 0, 0.0
    for i in range(len(weights)):
        mass = weights[i] * (1.0 if first else nearest[i])
        if mass > 0.0:
            chosen = i
            reached += mass
            if reached > target:
                break
    return chosen


@compiled
def _squared_distances(q: Array, p: Array, index: int, length_scale: float, out: Array) -> None:
    scale = 1.0 / length_scale**2
    for i in range(len(out)):
        cosine = 0.0
        for j in range(4):
            cosine += q[j, i] * q[j, index]
        angle = 2.0 * math.acos(min(1.0, abs(cosine)))
        square = 0.0
        for j in range(3):
            square += (p[j, i] - p[j, index]) ** 2
        out[i] = angle * angle + scale * square


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
    problem = _Problem(
        np.asarray(X), Stop(max_iterations, tolerance), rotation_floor, translation_floor
    )
    return problem.seeded(n_components, rng).mixture()


@checked(GraspError)
def fit_best_mixture(
    X: Annotated[ArrayLike, POSES],
    rng: np.random.Generator,
    max_components: Count = 10,
    *,
    start: RiemannianMixture | None = None,
    max_rotation: Annotated[float, Number(above=0.0, most=math.pi)] = math.pi,
    max_iterations: Count = 50,
    tolerance: float = 1e-4,
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
        max_iterations: See :func:`fit_riemannian_mixture`.
        tolerance: See there.

    Raises:
        GraspError: As :func:`fit_riemannian_mixture`.
    """
    problem = _Problem(np.asarray(X), Stop(max_iterations, tolerance))
    most = max(1, min(max_components, len(problem.X)))
    if start is None:
        fits = [problem.seeded(k, rng) for k in range(1, most + 1)]
    else:
        fits = problem.continued(start, most)
    return min(fits, key=lambda fit: fit.cost(problem, max_rotation)).mixture()


@dataclass(frozen=True, eq=False)
class _Fit:
    """What EM found, and the log likelihood of the poses under it."""

    weights: Array
    means: Array
    covariances: Array
    log_likelihood: float

    def mixture(self) -> RiemannianMixture:
        return RiemannianMixture(self.weights, self.means, self.covariances)

    def cost(self, problem: _Problem, max_rotation: float) -> tuple[bool, float]:
        """Sorts by whether a pose is too far from all means, then by BIC."""
        criterion = bic(len(self.weights), len(problem.X), self.log_likelihood)
        if max_rotation >= math.pi:
            return False, criterion
        means = se3.quaternions(self.means)
        cosine = _smallest_cosine(problem.samples.quaternions, means)
        return cosine < math.cos(0.5 * max_rotation), criterion


@dataclass(eq=False)
class _Problem:
    """Poses (n, 4, 4) to fit to, and how to fit."""

    X: Array
    stop: Stop
    rotation_floor: float = 0.05
    translation_floor: float = 0.005
    samples: Samples = field(init=False)
    scale: Array = field(init=False)
    floor: Array = field(init=False)

    def __post_init__(self) -> None:
        if len(self.X) == 0:
            raise GraspError("a mixture's X is empty; give poses (n, 4, 4), n >= 1")
        self.samples = Samples(
            np.ascontiguousarray(se3.quaternions(self.X).T),
            np.ascontiguousarray(self.X[:, :3, 3].T),
            np.ones(len(self.X)),
        )
        self.scale = np.array([1.0] * 3 + [LENGTH_SCALE] * 3)
        floors = [self.rotation_floor] * 3 + [self.translation_floor] * 3
        self.floor = np.array(floors) ** 2

    def seeded(self, n_components: int, rng: np.random.Generator) -> _Fit:
        """EM from k-means++ seeds."""
        draws = rng.random((min(n_components, len(self.X)), 4))
        seeds, spread = seed_means(*self.samples, LENGTH_SCALE, draws)
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
        found = expectation_maximization(
            self.samples,
            np.maximum(weights, 1e-300),
            np.ascontiguousarray(means),
            np.ascontiguousarray(covariances),
            self.scale,
            self.floor,
            self.stop,
        )
        return _Fit(found[0], found[1], found[2], float(found[3][-1]))


@compiled
def _smallest_cosine(quaternions: Array, means: Array) -> float:
    """Cosine of half the largest angle of a pose (4, n) to the nearest of the means (K, 4)."""
    smallest = 1.0
    for i in range(quaternions.shape[1]):
        nearest = 0.0
        for k in range(len(means)):
            cosine = 0.0
            for j in range(4):
                cosine += quaternions[j, i] * means[k, j]
            nearest = max(nearest, abs(cosine))
        smallest = min(smallest, nearest)
    return smallest
