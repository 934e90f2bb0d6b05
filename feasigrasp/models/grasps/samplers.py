"""The grasp samplers by name, for scenarios and commands."""

from __future__ import annotations

from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn
from feasigrasp.models.grasps.thinning import LEAST_SCORE
from feasigrasp.models.robot.gripper import ParallelGripper

#: ``network`` (learned, see `NetworkSampler`) or ``antipodal`` (model-free, `AntipodalSampler`).
METHODS = ("network", "antipodal")


def make_sampler(
    method: str,
    gripper: ParallelGripper | None = None,
    *,
    n_candidates: int = 800,
    n_grasps: int = 64,
    least_score: float = LEAST_SCORE,
) -> GraspSamplerFn:
    """A grasp sampler: from a distance field to filtered grasps, best first.

    Args:
        method: One of `METHODS`.
        gripper: The hand; the default one unless given.
        n_candidates: Grasps that are filtered, at most.
        n_grasps: Grasps that are returned, at most.
        least_score: Grasps that score less are left out, while there are enough. Who judges grasps
            further, by reach above all, gives 0 and has the choice.

    Raises:
        GraspError: There is no such method.
        GraspWeightsError: The network's weights are missing or broken.
    """
    gripper = gripper or ParallelGripper()
    if method == "antipodal":
        return AntipodalSampler(
            gripper, n_candidates=n_candidates, n_grasps=n_grasps, least_score=least_score
        )
    if method != "network":
        raise GraspError(f"sampler {method!r} is unknown; choose one of {', '.join(METHODS)}")
    from feasigrasp.models.grasps.network_sampler import (
        NetworkSampler,  # torch takes a second to import
    )

    default = NetworkSampler(gripper)
    contacts = max(1, n_candidates // default.n_approaches)
    return NetworkSampler(
        gripper,
        default.network,
        n_contacts=contacts,
        n_grasps=n_grasps,
        least_score=least_score,
    )
