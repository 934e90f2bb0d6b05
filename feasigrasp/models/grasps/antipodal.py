"""Model-free grasp sampler: contact pairs on the completed surface along the inward normal."""

from dataclasses import dataclass, field

import numpy as np

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection, grasp_frames
from feasigrasp.models.grasps.hand_clearance import MARGIN
from feasigrasp.models.grasps.non_maximum_suppression import LEAST_SCORE, suppress_non_maxima
from feasigrasp.models.quantities import Count, Share, Whole
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf


@dataclass(frozen=True, eq=False)
class AntipodalSampler:
    """Samples parallel-jaw grasps from a distance field: ``sampler(gpdf) -> GraspSet``.

    For each point of the completed surface the ray along the inward normal b gives the opposite
    contact. Pairs whose normals oppose each other, spread over the object, are approached from
    several directions perpendicular to b; what the filter leaves is thinned to different grasps.
    The same field gives the same grasps.

    Attributes:
        gripper: The hand.
        n_candidates: Grasps that are filtered.
        n_grasps: Most grasps returned.
        least_score: Grasps that score less are left out, while there are enough; see
            `suppress_non_maxima`.
        n_approaches: Approach directions per contact pair.
        seed: Seeds the approach directions.
    """

    gripper: ParallelGripper = field(default_factory=ParallelGripper)
    n_candidates: Count = 800
    n_grasps: Count = 64
    least_score: Share = LEAST_SCORE
    n_approaches: Count = 8
    seed: Whole = 0

    def __post_init__(self) -> None:
        check_fields(self, GraspError)

    @checked(GraspError)
    def __call__(self, gpdf: Gpdf) -> GraspSet:
        """Filtered grasps, best first, in the frame of the field (object frame O)."""
        X_OG, width, no_exit = self.candidates(gpdf)
        grasps = filter_grasps(gpdf, X_OG, width, self.gripper)
        distinct_grasps = suppress_non_maxima(grasps, self.n_grasps, least_score=self.least_score)
        return distinct_grasps.counted({Rejection.TOO_WIDE: no_exit})

    @checked(GraspError)
    def candidates(self, gpdf: Gpdf) -> tuple[Array, Array, int]:
        """Unfiltered grasps.

        Returns:
            Poses X_OG (n, 4, 4), widths (n,), and the number of surface points without an
            opposite side within the hand's opening.
        """
        rng = np.random.default_rng(self.seed)
        n_pairs = -(-self.n_candidates // self.n_approaches)
        surface = gpdf.completion
        # So many times as many rays as pairs leave a choice; more only cost time.
        stride = max(1, len(surface.points) // (5 * n_pairs))
        first, b = surface.points[::stride], -surface.normals[::stride]
        widest = self.gripper.max_opening - 2 * MARGIN
        # First point looked at on the way through the object; thinner walls are not seen [m].
        width = gpdf.ray_exits(first, b, widest, 0.002)
        hit = np.isfinite(width)
        first, b, width = first[hit], b[hit], width[hit]
        if len(width) > n_pairs:
            cosine = -np.einsum("ni,ni->n", gpdf.normals(first + width[:, None] * b), b)
            chosen = _spread(first, cosine, n_pairs)
            first, b, width = first[chosen], b[chosen], width[chosen]
        approaches = _approaches(b, self.n_approaches, rng)
        X_OG = grasp_frames(first + 0.5 * width[:, None] * b, b, approaches).reshape(-1, 4, 4)
        width, n = np.repeat(width, self.n_approaches), self.n_candidates
        return X_OG[:n], width[:n], int((~hit).sum())


def _spread(first: Array, cosine: Array, count: int) -> Indices:
    """At most ``count`` contact pairs, spread over the object, of the strictest opposition.

    Taking those with the best cosine instead would crowd them on one well-formed part.
    """
    # Cosines between opposed normals by which pairs are chosen, strictest first.
    for limit in (-0.95, -0.9, -0.8, -0.7):
        opposed = np.flatnonzero(cosine <= limit)
        if len(opposed) >= count:
            return opposed[farthest_points(first[opposed], count)]
    return opposed


def _approaches(b: Array, n_approaches: int, rng: np.random.Generator) -> Array:
    """Directions evenly round b, shape (n, n_approaches, 3)."""
    u, v = perpendiculars(b)
    phase = rng.uniform(0.0, 2 * np.pi, (len(b), 1))
    angle = (phase + np.arange(n_approaches) * 2 * np.pi / n_approaches)[..., None]
    return np.asarray(np.cos(angle) * u[:, None] + np.sin(angle) * v[:, None])
