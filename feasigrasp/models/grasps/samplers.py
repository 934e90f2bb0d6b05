"""The grasp samplers by name, for scenarios and commands."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from feasigrasp.errors import GraspError, needed_by
from feasigrasp.models.arguments import checked
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.grasps.network.network import Preset, load_grasp_network
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.grasps.thinning import LIKELY, thin_grasps
from feasigrasp.models.quantities import Count, Share, Whole
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf

if TYPE_CHECKING:
    from feasigrasp.models.grasps.diffusion.sampler import DiffusionSampler


class SamplerName(StrEnum):
    """Where grasps come from.

    ``network`` is the learned `NetworkSampler`, ``paper`` the same with the paper's architecture
    and nothing else to fall back on, ``antipodal`` the model-free `AntipodalSampler`, ``diffusion``
    a baseline, the `DiffusionSampler`.
    """

    NETWORK = "network"
    PAPER = "paper"
    ANTIPODAL = "antipodal"
    DIFFUSION = "diffusion"


@dataclass(frozen=True, eq=False)
class Unfiltered:
    """What a sampler proposes, as it comes: the paper's sampler without its post-filter.

    A network's proposals are ranked by its own probabilities, others are all alike; near copies
    are left out.

    Attributes:
        sampler: The sampler; as many grasps are returned, at most.
    """

    sampler: AntipodalSampler | NetworkSampler | DiffusionSampler

    def __call__(self, gpdf: Gpdf) -> GraspSet:
        """Grasps in the frame of the field, best first."""
        X_OG, width, told = self.sampler.candidates(gpdf)
        score = told.prod(axis=1) if isinstance(told, np.ndarray) else np.ones(len(width))
        order = np.argsort(-score, kind="stable")
        grasps = GraspSet(X_OG[order], width[order], score[order], {}, order)
        return thin_grasps(grasps, self.sampler.n_grasps, least_score=0.0)


@checked(GraspError)
def make_sampler(
    name: str = SamplerName.NETWORK,
    gripper: ParallelGripper | None = None,
    *,
    filtered: bool = True,
    n_candidates: Count = 800,
    n_grasps: Count = 64,
    least_score: Share | None = None,
    seed: Whole = 0,
) -> GraspSamplerFn:
    """A grasp sampler: from a distance field to filtered grasps, best first.

    Whatever is called like that, ``sampler(gpdf) -> GraspSet``, can take its place.

    Args:
        name: One of `SamplerName`.
        gripper: The hand; the default one unless given.
        filtered: Whether what is proposed is judged on the field; if not, it is taken as it comes.
        n_candidates: Grasps that are filtered, at most; ``diffusion`` draws the 100 of the paper.
        n_grasps: Grasps that are returned, at most.
        least_score: Grasps that score less are left out, while there are enough; None for 0.9 of
            our network and 0.87 of the others, which are never so sure. Who judges grasps further,
            by reach above all, gives 0 and has the choice.
        seed: Of the approach directions of ``antipodal`` and the samples of ``diffusion``; other
            samplers draw nothing.

    Raises:
        GraspError: There is no such sampler.
        WeightsError: The network's weights are missing or broken.
        MissingPackageError: ``paper`` or ``diffusion``, and there is no torch.
    """
    chosen = parse_choice(SamplerName, name, "sampler", GraspError)
    gripper = gripper or ParallelGripper()
    if chosen == SamplerName.ANTIPODAL:
        antipodal = AntipodalSampler(
            gripper,
            n_candidates=n_candidates,
            n_grasps=n_grasps,
            least_score=LIKELY if least_score is None else least_score,
            seed=seed,
        )
        return antipodal if filtered else Unfiltered(antipodal)
    if chosen == SamplerName.DIFFUSION:
        with needed_by("the sampler 'diffusion'"):
            from feasigrasp.models.grasps.diffusion.sampler import DiffusionSampler

        diffusion = DiffusionSampler(
            gripper,
            n_grasps=n_grasps,
            least_score=LIKELY if least_score is None else least_score,
            seed=seed,
        )
        return diffusion if filtered else Unfiltered(diffusion)
    paper = chosen == SamplerName.PAPER
    n_approaches = NetworkSampler.n_approaches
    likely = LIKELY if paper else NetworkSampler.least_score
    network = NetworkSampler(
        gripper,
        load_grasp_network(Preset.PAPER if paper else Preset.DEFAULT),
        n_contacts=max(1, n_candidates // n_approaches),
        n_grasps=n_grasps,
        least_score=likely if least_score is None else least_score,
        top_up=not paper,
    )
    return network if filtered else Unfiltered(network)
