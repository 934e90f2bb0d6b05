"""Learned grasp sampler: proposals of the equivariant network, filtered by the distance field."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import ENOUGH, GraspSet, grasp_frames
from feasigrasp.models.grasps.hand_clearance import THIN_WALL
from feasigrasp.models.grasps.network.network import (
    GraspNetwork,
    GraspProposals,
    load_grasp_network,
)
from feasigrasp.models.grasps.network.surface_input import GraspInput, grasp_input
from feasigrasp.models.grasps.non_maximum_suppression import suppress_non_maxima
from feasigrasp.models.grasps.success_probability import odds, probability
from feasigrasp.models.quantities import Count, Share
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf, surface_deviation, unit_normals

#: Poses X_OG (n, 4, 4), widths (n,) [m], and probabilities of the network (n, 2) of the
#: contact and of a free hand, NaN where it does not.
Candidates = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class NetworkSampler:
    """Samples parallel-jaw grasps from a distance field: ``sampler(gpdf) -> GraspSet``.

    The network says for every point of the completed surface whether a grasp starts there, where
    its other contact is and which approaches are free. The best contacts, spread over the object,
    are put together with their approaches; the field settles the width where both agree; the
    filter judges every one, and weighs its verdict with the network's. Where that leaves too few,
    contact pairs that follow from the field alone are offered as well. The same field gives the
    same grasps.

    Attributes:
        gripper: The hand; the network need not have been trained with it.
        network: The network; by default the one that comes with the package.
        n_points: Surface points shown to the network.
        n_contacts: Contacts that are put together with approaches.
        n_approaches: Approach directions per contact, at most.
        n_grasps: Most grasps returned.
        least_score: Grasps that score less are left out, while there are enough; see
            `suppress_non_maxima`.
        top_up: Whether candidates of an `AntipodalSampler` join in where fewer than `ENOUGH`
            grasps are left.
    """

    gripper: ParallelGripper = field(default_factory=ParallelGripper)
    network: GraspNetwork = field(default_factory=load_grasp_network)
    n_points: Count = 512
    n_contacts: Count = 48
    n_approaches: Count = 4
    n_grasps: Count = 64
    # Least score by default: field and network together are more certain than the field alone.
    least_score: Share = 0.9
    top_up: bool = True

    def __post_init__(self) -> None:
        check_fields(self, GraspError)

    @checked(GraspError)
    def __call__(self, gpdf: Gpdf) -> GraspSet:
        """Filtered grasps, best first, in the frame of the field (object frame O)."""
        surface = grasp_input(gpdf, self.n_points)
        proposals = self._network.propose(surface)
        candidates = self._proposed(gpdf, surface, proposals)
        grasps = self._judged(gpdf, candidates)
        if self.top_up and len(grasps) < ENOUGH:
            opposed = self._opposed(gpdf, surface, proposals.contact)
            both = [np.concatenate(parts) for parts in zip(candidates, opposed, strict=True)]
            grasps = self._judged(gpdf, (both[0], both[1], both[2]))
        return grasps

    @checked(GraspError)
    def candidates(self, gpdf: Gpdf) -> Candidates:
        """Unfiltered grasps of the network: poses X_OG, widths [m], probabilities (n, 2)."""
        surface = grasp_input(gpdf, self.n_points)
        return self._proposed(gpdf, surface, self._network.propose(surface))

    def _judged(self, gpdf: Gpdf, candidates: Candidates) -> GraspSet:
        """What filter and thinning leave of candidates."""
        X_OG, width, prior = candidates
        grasps = filter_grasps(gpdf, X_OG, width, self.gripper, prior=prior)
        return suppress_non_maxima(grasps, self.n_grasps, least_score=self.least_score)

    def _proposed(self, gpdf: Gpdf, surface: GraspInput, proposals: GraspProposals) -> Candidates:
        """The most probable contacts, spread over the object, with their approach directions."""
        chosen = _choose(proposals.contact, surface.points, self.n_contacts)
        first = surface.points[chosen].astype(float)
        b = proposals.closing[chosen]
        width = _settled_width(gpdf, first, proposals, chosen, self.gripper.max_opening)
        z = proposals.approach[chosen, : self.n_approaches]
        middle, b, width = _straightened(gpdf, first + 0.5 * width[:, None] * b, b, width)
        z = z - np.einsum("nmi,ni->nm", z, b)[..., None] * b[:, None]
        z = z / np.linalg.norm(z, axis=2, keepdims=True)
        X_OG = grasp_frames(middle, b, z)
        free = proposals.approach_score[chosen, : self.n_approaches].reshape(-1)
        width, contact = (
            np.repeat(each, z.shape[1]) for each in (width, proposals.contact[chosen])
        )
        return X_OG.reshape(-1, 4, 4), width, np.column_stack([contact, free])

    def _opposed(self, gpdf: Gpdf, surface: GraspInput, contact: Array) -> Candidates:
        """Contact pairs of the field alone; how likely the network finds both contacts."""
        X_OG, width, _ = AntipodalSampler(self.gripper).candidates(gpdf)
        half = 0.5 * width[:, None] * X_OG[:, :3, 0]
        tree = cKDTree(surface.points)
        ends = [tree.query(X_OG[:, :3, 3] + way * half)[1] for way in (-1.0, 1.0)]
        mean = (0.0, 0.5, 0.5)
        good = probability(mean, odds(contact[ends[0]]), odds(contact[ends[1]]))
        return X_OG, width, np.column_stack([good, np.full(len(good), np.nan)])

    @cached_property
    def _network(self) -> GraspNetwork:
        return replace(self.network, gripper=self.gripper)


def _choose(contact: Array, points: NDArray[np.float32], count: int) -> NDArray[np.intp]:
    """At most ``count`` of the most likely contacts, spread over the object."""
    # Candidates per taken contact that are spread over the object.
    best = np.argsort(-contact, kind="stable")[: 2 * count]
    # Contacts that the network gives less than this are not looked at.
    likely = best[contact[best] >= 0.2]
    if len(likely) <= count:
        return likely
    return likely[farthest_points(points[likely].astype(float), count)]


def _settled_width(
    gpdf: Gpdf, first: Array, proposals: GraspProposals, chosen: NDArray[np.intp], opening: float
) -> Array:
    """Widths that end on the field's far side where network and field agree about it [m]."""
    # The far side is taken from the field if it is this near to the predicted width: in standard
    # deviations of the width, and at least [m].
    deviations, near = 2.0, 0.004
    width = proposals.width[chosen]
    reach = np.maximum(deviations * proposals.width_deviation[chosen], near)
    # First point looked at on the way through the object; thinner walls are not seen [m].
    to_exit = gpdf.ray_exits(first, proposals.closing[chosen], opening, 0.002)
    return np.where(np.abs(to_exit - width) <= reach, to_exit, width)  # NaN is not near


def _straightened(gpdf: Gpdf, middle: Array, b: Array, width: Array) -> tuple[Array, Array, Array]:
    """Closing lines turned towards both normals, where that makes the contacts more opposed.

    The network's direction is a few degrees off; between observed faces the field is more accurate.
    The line turns about its middle to the mean of both inward normals and ends on the surface
    again. Lines are given and returned as middles (n, 3) [m], unit directions (n, 3) and lengths
    (n,) [m].
    """
    # How often a line is turned, and by less than which angle (cosine); how far it is followed from
    # its middle, and how far off its end is expected to be, at most [m].
    turns, least_cosine, farthest, well_known = 2, np.cos(np.deg2rad(20.0)), 0.06, 0.0025
    middle, b, width = middle.copy(), b.copy(), width.copy()
    ends = middle + 0.5 * width[:, None] * b
    known = np.flatnonzero((width > THIN_WALL) & (surface_deviation(gpdf, ends) < well_known))
    p, x, w = middle[known], b[known], width[known]
    n1, n2 = _end_normals(gpdf, p, x, w)
    turning = np.arange(len(p))
    for _ in range(turns):  # a line that gained nothing would gain nothing by the same turn again
        turned = unit_normals(n2[turning] - n1[turning])
        near = np.einsum("ni,ni->n", turned, x[turning]) > least_cosine
        turning, turned = turning[near], turned[near]
        ahead, behind = gpdf.ray_exits(
            np.tile(p[turning], (2, 1)), np.concatenate([turned, -turned]), farthest, 0.0
        ).reshape(2, -1)
        length, there = ahead + behind, p[turning] + 0.5 * (ahead - behind)[:, None] * turned
        found = np.isfinite(length)
        turning, turned = turning[found], turned[found]
        length, there = length[found], there[found]
        after = _end_normals(gpdf, there, turned, length)
        better = _opposition(*after, turned) < _opposition(n1[turning], n2[turning], x[turning])
        turning = turning[better]
        p[turning], x[turning], w[turning] = there[better], turned[better], length[better]
        n1[turning], n2[turning] = (normals[better] for normals in after)
    middle[known], b[known], width[known] = p, x, w
    return middle, b, width


def _end_normals(gpdf: Gpdf, middle: Array, b: Array, width: Array) -> tuple[Array, Array]:
    """Outward normals at both ends of closing lines, shapes (n, 3)."""
    half = 0.5 * width[:, None] * b
    first, second = gpdf.normals(np.concatenate([middle - half, middle + half])).reshape(2, -1, 3)
    return first, second


def _opposition(n1: Array, n2: Array, b: Array) -> Array:
    """As in `contact_state`, of normals at both ends: -1 if these are perfectly opposed, (n,)."""
    return np.maximum(np.einsum("ni,ni->n", n1, b), -np.einsum("ni,ni->n", n2, b))
