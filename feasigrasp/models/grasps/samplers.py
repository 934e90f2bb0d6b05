"""The grasp samplers by name, for scenarios and commands."""

from collections.abc import Callable
from enum import StrEnum
from functools import partial

import numpy as np

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.choices import parse_word
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.grasps.non_maximum_suppression import (
    LEAST_SCORE,
    recheck_grasps,
    suppress_non_maxima,
)
from feasigrasp.models.grasps.suction import SuctionSampler, recheck_suction
from feasigrasp.models.quantities import Count, Share, Whole
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper, SuctionCup
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.plugins import load_plugin, plugins


class SamplerName(StrEnum):
    """Grasp samplers by name.

    ``network`` is the learned `NetworkSampler`, ``antipodal`` the model-free `AntipodalSampler`.
    Packages may add others (`feasigrasp.plugins`).
    """

    NETWORK = "network"
    ANTIPODAL = "antipodal"


def sampler_names() -> list[str]:
    """The names that `make_sampler` takes."""
    return [*map(str, SamplerName), *plugins("samplers")]


#: Samplers whose proposals can be had before they are filtered.
Proposer = AntipodalSampler | NetworkSampler | SuctionSampler


def unfiltered(sampler: Proposer, gpdf: Gpdf) -> GraspSet:
    """Proposals of a sampler, best first: the paper's sampler without its post-filter.

    A network's proposals are ranked by its own probabilities, others are all alike; near copies
    are left out.
    """
    X_OG, width, learned = sampler.candidates(gpdf)
    score = learned.prod(axis=1) if isinstance(learned, np.ndarray) else np.ones(len(width))
    order = np.argsort(-score, kind="stable")
    grasps = GraspSet(X_OG[order], width[order], score[order], {}, order)
    return suppress_non_maxima(grasps, sampler.n_grasps, least_score=0.0)


def recheck_of(gripper: Gripper) -> Callable[[Gpdf, GraspSet], GraspSet]:
    """What checks earlier grasps of a hand on a new field: its contact model."""
    if isinstance(gripper, SuctionCup):
        return partial(recheck_suction, gripper=gripper)
    assert isinstance(gripper, ParallelGripper)
    return partial(recheck_grasps, gripper=gripper)


@checked(GraspError)
def make_sampler(
    name: str = SamplerName.NETWORK,
    gripper: Gripper | None = None,
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
        name: One of `SamplerName`; a suction cup has a sampler of its own, `SuctionSampler`.
        gripper: The hand; the default one unless given.
        filtered: Whether what is proposed is judged on the field; if not, it is taken as it comes.
        n_candidates: Grasps that are filtered, at most.
        n_grasps: Grasps that are returned, at most.
        least_score: Grasps that score less are left out, while there are enough; None for 0.9 of
            our network and 0.87 of the others, which are never so sure. Who judges grasps further,
            by reach above all, gives 0 and has the choice.
        seed: Of the approach directions of ``antipodal``; the network draws nothing.

    Raises:
        GraspError: There is no such sampler.
        WeightsError: The network's weights are missing or broken.
        MissingPackageError: An added sampler needs a package that is not installed.
    """
    chosen = parse_word(sampler_names(), name, "sampler", GraspError)
    gripper = gripper or ParallelGripper()
    least = LEAST_SCORE if least_score is None else least_score
    counts = {"n_candidates": n_candidates, "n_grasps": n_grasps}
    sampler: Proposer
    if isinstance(gripper, SuctionCup):
        sampler = SuctionSampler(gripper, 2 * n_candidates, n_grasps, least)
        return sampler if filtered else partial(unfiltered, sampler)
    assert isinstance(gripper, ParallelGripper)
    if chosen in plugins("samplers"):
        make = load_plugin("samplers", chosen)
        sampler = make(gripper, **counts, least_score=least, seed=seed)
    elif chosen == SamplerName.ANTIPODAL:
        sampler = AntipodalSampler(gripper, **counts, least_score=least, seed=seed)
    else:
        sampler = NetworkSampler(
            gripper,
            n_contacts=max(1, n_candidates // NetworkSampler.n_approaches),
            n_grasps=n_grasps,
            least_score=NetworkSampler.least_score if least_score is None else least_score,
        )
    return sampler if filtered else partial(unfiltered, sampler)
