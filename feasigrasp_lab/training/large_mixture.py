"""Expectation maximization on SE(3) for millions of poses: `fit_large_mixture`.

The E step and the moments that the M step needs are one fused pass in single precision over blocks
of poses (`em_pass`), on as many threads as wanted; nothing has the size n x K. Sums are kept in
single precision within a block of 256 poses only, and in double precision beyond. The blocks are
dealt out in a fixed number of parts, so that a result does not depend on the number of threads.

Compared with `fit_riemannian_mixture`, which is for tens to thousands of poses: one step of the
means per pass instead of several (the fixed points are the same), and a first fit to a subset.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp_lab.mixtures.fit import LENGTH_SCALE, seed_means
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.float32_kernels import pack
from feasigrasp_lab.training.pose_blocks import PoseBlocks, moments_of_blocks

#: Most passes over all poses, and over the subset that is fitted first. Source: guessed.
PASSES, WARM_PASSES = 25, 150


class Moments(NamedTuple):
    """What one EM pass yields.

    Attributes:
        mass: Sum of the responsibilities r of each component, shape (K,).
        first: Sum of r v with the tangents v at the component's mean, shape (K, 6).
        second: Sum of r v v^T, shape (K, 6, 6).
        log_likelihood: Sum of the log densities of all poses.
    """

    mass: Array
    first: Array
    second: Array
    log_likelihood: float


@dataclass(frozen=True)
class LargeFit:
    """Settings of `fit_large_mixture`.

    Attributes:
        rotation_floor: Standard deviation added to every rotational direction [rad].
        translation_floor: Standard deviation added to every translational direction [m].
        tolerance: EM ends when the mean log likelihood per pose gains less than this.
        warm_poses: Size of the subset that is fitted first.
        threads: Threads of a pass.
    """

    rotation_floor: float = 0.05
    translation_floor: float = 0.005
    tolerance: float = 2e-4
    warm_poses: int = 200_000
    threads: int = 1

    @property
    def floor(self) -> Array:
        """Standard deviations added, by direction of the tangent space, shape (6,)."""
        return np.repeat([self.rotation_floor, self.translation_floor], 3)


def em_pass(poses: PoseBlocks, mixture: RiemannianMixture, threads: int = 1) -> Moments:
    """The E step and the moments about the means, in one pass over the poses.

    Responsibilities below 2^-20 count as zero; sums are exact to about 1e-6 of the mass.

    Args:
        poses: The poses.
        mixture: The present estimate, K components.
        threads: Threads that share the work.
    """
    packed, k = pack(mixture), len(mixture)
    # Parts that a pass is dealt out in, whatever the number of threads.
    edges = np.linspace(0, len(poses.blocks), min(16, len(poses.blocks)) + 1).astype(int)

    def part(i: int) -> Moments:
        mass, first, second = np.zeros(k), np.zeros((k, 6)), np.zeros((k, 6, 6))
        part_of = (int(edges[i]), int(edges[i + 1]), poses.n)
        likelihood = moments_of_blocks(poses.blocks, *part_of, packed, mass, first, second)
        return Moments(mass, first, second, likelihood)

    with ThreadPoolExecutor(threads) as pool:
        parts = list(pool.map(part, range(len(edges) - 1)))
    mass = np.sum([p.mass for p in parts], axis=0)
    first = np.sum([p.first for p in parts], axis=0)
    second = np.sum([p.second for p in parts], axis=0)
    second += np.tril(second, -1).swapaxes(1, 2)  # the kernel fills the lower triangle
    return Moments(mass, first, second, float(sum(p.log_likelihood for p in parts)))


def fit_large_mixture(
    poses: PoseBlocks,
    n_components: int,
    rng: np.random.Generator,
    settings: LargeFit | None = None,
    progress: Callable[[str, int, float], None] | None = None,
) -> tuple[RiemannianMixture, float]:
    """Fits a mixture to very many poses: k-means++ seeds, EM on a subset, EM on all.

    Args:
        poses: The poses.
        n_components: Number of components K wanted; starved ones are dropped.
        rng: Source of randomness of the subset and the seeds.
        settings: See `LargeFit`.
        progress: Called after every pass with the stage (``subset`` or ``all``), the number of the
            pass and the mean log likelihood per pose.

    Returns:
        The mixture, and its mean log likelihood per pose before the last step.

    Raises:
        GraspError: Fewer poses than components, or no components.
    """
    settings = settings or LargeFit()
    if not 1 <= n_components <= poses.n:
        raise GraspError(
            f"fit_large_mixture: {n_components} components for {poses.n} poses; give 1 ... n."
        )
    subset = poses.subset(rng, settings.warm_poses) if poses.n > settings.warm_poses else None
    start = _seeded(subset or poses, n_components, rng, settings)
    if subset is not None:
        start, _ = _iterate(subset, start, WARM_PASSES, "subset", settings, progress)
    return _iterate(poses, start, PASSES, "all", settings, progress)


def maximization_step(
    mixture: RiemannianMixture, moments: Moments, settings: LargeFit
) -> RiemannianMixture:
    """The M step: means move by their mean tangents, covariances are about the new means.

    Components with less than one effective pose are dropped.
    """
    alive = moments.mass >= 1.0
    mass = moments.mass[alive]
    step = moments.first[alive] / mass[:, None]
    covariances = moments.second[alive] / mass[:, None, None] - step[:, :, None] * step[:, None]
    covariances += np.diag(settings.floor**2)
    return RiemannianMixture(mass, mixture.means[alive] @ se3.exp(step), covariances)


def _iterate(
    poses: PoseBlocks,
    mixture: RiemannianMixture,
    iterations: int,
    stage: str,
    settings: LargeFit,
    progress: Callable[[str, int, float], None] | None,
) -> tuple[RiemannianMixture, float]:
    previous = -np.inf
    for i in range(iterations):
        moments = em_pass(poses, mixture, settings.threads)
        likelihood = moments.log_likelihood / poses.n
        if progress:
            progress(stage, i, likelihood)
        # Starved components make the likelihood fall once; that is no convergence.
        settled = likelihood - previous < settings.tolerance and (moments.mass >= 1.0).all()
        previous = likelihood
        mixture = maximization_step(mixture, moments, settings)
        if settled:
            break
    return mixture, previous


def _seeded(
    poses: PoseBlocks, n_components: int, rng: np.random.Generator, settings: LargeFit
) -> RiemannianMixture:
    """Equal components at k-means++ seeds, as wide as the poses are far from them."""
    # Poses that k-means++ looks at.
    seeding_poses = 30_000
    seeding_candidates = 4
    q, p = poses.draw(rng, seeding_poses)
    draws = rng.random((n_components, seeding_candidates))
    seeds, spread = seed_means(q, p, np.ones(q.shape[1]), LENGTH_SCALE, draws)
    scale = np.array([1.0] * 3 + [LENGTH_SCALE] * 3)
    covariance = np.diag((spread * scale) ** 2 + settings.floor**2)
    means = se3.make_pose(se3.rotations(q[:, seeds].T), p[:, seeds].T)
    return RiemannianMixture(np.ones(len(seeds)), means, np.tile(covariance, (len(seeds), 1, 1)))
