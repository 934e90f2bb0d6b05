"""Baseline sampler: hand poses of grasp diffusion, filtered by the distance field."""

from dataclasses import dataclass, field

import numpy as np

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.network.surface_input import grasp_input
from feasigrasp.models.grasps.non_maximum_suppression import LEAST_SCORE, suppress_non_maxima
from feasigrasp.models.quantities import Count
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp_lab.baselines.grasp_diffusion import GraspDiffusion, load_grasp_diffusion


@dataclass(frozen=True, eq=False)
class DiffusionSampler:
    """Samples grasps from a distance field: ``sampler(gpdf) -> GraspSet``.

    A pose of grasp diffusion says where the open hand is, and nothing of contacts: these are where
    its closing line meets the field. Poses are centred between them, filtered and thinned as those
    of the other samplers. The same field gives the same grasps.

    Attributes:
        gripper: The hand of the filter; the energy was trained for the default one.
        diffusion: The energy; by default the one that comes with the package.
        n_samples: Poses that are drawn; the paper takes 100.
        n_points: Surface points shown to the energy, as many as it was trained on.
        n_grasps: Most grasps returned.
        least_score: Grasps that score less are left out, while there are enough; see
            `suppress_non_maxima`.
        seed: Seeds the samples.
    """

    gripper: ParallelGripper = field(default_factory=ParallelGripper)
    diffusion: GraspDiffusion = field(default_factory=load_grasp_diffusion)
    n_samples: Count = 100
    n_points: Count = 256
    n_grasps: Count = 64
    least_score: float = LEAST_SCORE
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks the counts."""
        check_fields(self, GraspError)

    def __call__(self, gpdf: Gpdf) -> GraspSet:
        """Filtered grasps, best first, in the frame of the field (object frame O)."""
        return self.judged(gpdf, self.candidates(gpdf)[0])

    def judged(self, gpdf: Gpdf, X_OG: Array) -> GraspSet:
        """What filter and thinning leave of hand poses (n, 4, 4)."""
        X_OG, width, held = closed_on(gpdf, X_OG, self.gripper.max_opening)
        grasps = filter_grasps(gpdf, X_OG[held], width[held], self.gripper)
        distinct_grasps = suppress_non_maxima(grasps, self.n_grasps, least_score=self.least_score)
        return distinct_grasps.counted({Rejection.NOTHING_BETWEEN: int(np.count_nonzero(~held))})

    def candidates(self, gpdf: Gpdf) -> tuple[Array, Array, None]:
        """The poses X_OG (n, 4, 4) as they were drawn, and the distances of the contacts (n,) [m].

        The opening stands where there are no contacts; nothing else is learned of a pose.
        """
        surface = grasp_input(gpdf, self.n_points)
        rng = np.random.default_rng(self.seed)
        X_OG = self.diffusion.at(surface).sample(self.n_samples, rng)
        return X_OG, closed_on(gpdf, X_OG, self.gripper.max_opening)[1], None


def closed_on(gpdf: Gpdf, X_OG: Array, opening: float) -> tuple[Array, Array, Mask]:
    """Where pads that close from an opening meet the field.

    Returns:
        Poses centred between the contacts (n, 4, 4), widths (n,) [m], and where there is something
        between the pads, (n,); elsewhere the poses as they are, with the opening.
    """
    # Samples of a closing line; contacts are interpolated between them.
    samples = 41
    along = np.linspace(-0.5 * opening, 0.5 * opening, samples)
    places = X_OG[:, None, :3, 3] + along[:, None] * X_OG[:, None, :3, 0]
    d = gpdf.distance(places.reshape(-1, 3)).reshape(-1, samples)
    inside = d < 0.0
    # A pad that starts inside the object does not meet it from outside.
    held = inside.any(axis=1) & ~inside[:, 0] & ~inside[:, -1]
    rows = np.flatnonzero(held)
    ends = []
    for first, way in ((inside.argmax(axis=1), 1), (samples - 1 - inside[:, ::-1].argmax(1), -1)):
        i = first[rows]
        inner, outer = d[rows, i], d[rows, i - way]
        ends.append(along[i] + (along[i - way] - along[i]) * inner / (inner - outer))
    middle, width = np.zeros(len(X_OG)), np.full(len(X_OG), opening)
    middle[rows], width[rows] = 0.5 * (ends[0] + ends[1]), ends[1] - ends[0]
    centred = X_OG.copy()
    centred[:, :3, 3] += middle[:, None] * X_OG[:, :3, 0]
    return centred, width, held


def make_sampler(
    gripper: ParallelGripper, *, n_candidates: int, n_grasps: int, least_score: float, seed: int = 0
) -> DiffusionSampler:
    """The sampler ``diffusion``; whatever ``n_candidates``, it draws the paper's number."""
    return DiffusionSampler(gripper, n_grasps=n_grasps, least_score=least_score, seed=seed)
