"""Suction sampler: places of a completed surface that a cup closes on (Mahler et al. 2018).

The lip is a ring of points on springs to each other and to the apex. It seals if every point meets
the surface along the approach direction with little strain in the springs, and if the surface has
no gap inside the ring.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtr

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.grasps.filter import above_table
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection, grasp_frames
from feasigrasp.models.grasps.hand_clearance import MARGIN, hand_clearance
from feasigrasp.models.grasps.non_maximum_suppression import LEAST_SCORE, suppress_non_maxima
from feasigrasp.models.grasps.success_probability import free_probability
from feasigrasp.models.quantities import Count, Share
from feasigrasp.models.robot.gripper import SuctionCup
from feasigrasp.models.shape.gpdf import MARGIN_GROWTH, Gpdf, surface_deviation

#: Points on the lip. Source: numerical.
LIP = 16


def cup_points(cup: SuctionCup) -> Array:
    """Points in the plane of the lip: `LIP` on it, then those inside, (k, 3) in G [m]."""
    angle = np.arange(LIP) * 2.0 * np.pi / LIP
    ring = cup.radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(LIP)], axis=1)
    return np.concatenate([ring, 0.67 * ring[::2], 0.33 * ring[::4], np.zeros((1, 3))])


def strain(heights: Array, cup: SuctionCup) -> Array:
    """Largest strain (n,) of the springs of a lip on a surface with heights (n, `LIP`) in G [m].

    Springs join neighbours on the lip, next but one neighbours, and each point with the apex, which
    stands ``cup.height`` behind their mean.
    """
    z = heights - heights.mean(axis=1, keepdims=True)
    worst = np.zeros(len(z))
    for apart in (1, 2):
        rest = 2.0 * cup.radius * np.sin(apart * np.pi / LIP)
        length = np.hypot(rest, z - np.roll(z, apart, axis=1))
        worst = np.maximum(worst, (length / rest - 1.0).max(axis=1))
    cone = np.hypot(cup.radius, cup.height + z) / np.hypot(cup.radius, cup.height)
    return np.asarray(np.maximum(worst, np.abs(cone - 1.0).max(axis=1)))


def seals(heights: Array, cup: SuctionCup) -> Mask:
    """Whether the lip closes on a surface, shape (n,).

    The strain is below ``max_strain``, the lip is set down on the surface, and that has no gap
    inside it, nor does it reach to the apex. Heights (n, k) of the surface in G are those at all
    `cup_points`, infinite where there is none [m].
    """
    # A vacuum draws the lip on from this far [m]. Further in than half its height it is crushed.
    near, deep = 0.001, 0.5 * cup.height
    there = np.isfinite(heights).all(axis=1)
    heights = np.where(np.isfinite(heights), heights, 0.0)
    mean = heights[:, :LIP].mean(axis=1)
    inside = np.abs(heights[:, LIP:] - mean[:, None]).max(axis=1) <= deep
    down = (mean <= near) & (mean >= -deep)
    return np.asarray(there & inside & down & (strain(heights[:, :LIP], cup) <= cup.max_strain))


def mesh_heights(vertices: Array, faces: Indices, X_OG: Array, cup: SuctionCup) -> Array:
    """Heights in G at which rays out of the cup meet a mesh first, at all `cup_points`, (k,) [m].

    Triangles (f, 3) of vertices (v, 3) in O [m] are intersected in the plane of the lip, by
    barycentric coordinates; rays start at the height of the apex.
    """
    in_G = (vertices - X_OG[:3, 3]) @ X_OG[:3, :3]
    a, b, c = (in_G[faces[:, i]] for i in range(3))
    xy = cup_points(cup)[:, None, :2]
    u, v, w = (_twice_area(p, q, xy) for p, q in ((b, c), (c, a), (a, b)))
    total = u + v + w
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (u * a[:, 2] + v * b[:, 2] + w * c[:, 2]) / total
    outside = np.minimum(np.minimum(u, v), w) * np.maximum(np.maximum(u, v), w) < 0.0
    hit = ~outside & (np.abs(total) > 0.0) & (z >= -cup.height)
    return np.asarray(np.where(hit, z, np.inf).min(axis=1, initial=np.inf))


def _twice_area(p: Array, q: Array, at: Array) -> Array:
    """Twice the signed area of triangles of edges (f, 3) and points (k, 1, 2), shape (k, f)."""
    to_p, to_q = p[:, :2] - at, q[:, :2] - at
    return np.asarray(to_p[..., 0] * to_q[..., 1] - to_p[..., 1] * to_q[..., 0])


def filter_suction(gpdf: Gpdf, X_OG: Array, cup: SuctionCup) -> GraspSet:
    """Keeps the poses (n, 4, 4) at which a cup closes on the surface and the hand hits nothing.

    The score is the probability that the cup seals (`seal_state`) times that of a free hand. Best
    first, with rejections counted; the ``id`` is the number of the pose.
    """
    n = len(X_OG)
    grasps = GraspSet(X_OG, np.full(n, 2.0 * cup.radius), np.ones(n), {}, np.arange(n))
    grasps = grasps.select(above_table(gpdf, grasps.X_OG, cup), Rejection.HITS_TABLE)
    there, sealed, score = seal_state(gpdf, grasps.X_OG, cup)
    grasps = replace(grasps, score=score).select(there, Rejection.OFF_SURFACE)
    grasps = grasps.select(sealed[there], Rejection.NOT_FLAT)
    clearance, deviation = hand_clearance(gpdf, grasps.X_OG, cup)
    free = clearance >= MARGIN + MARGIN_GROWTH * deviation
    likely = free_probability(clearance, deviation)
    grasps = replace(grasps, score=grasps.score * likely).select(free, Rejection.COLLIDES)
    return grasps.select(np.argsort(-grasps.score, kind="stable"))


def seal_state(gpdf: Gpdf, X_OG: Array, cup: SuctionCup) -> tuple[Mask, Mask, Array]:
    """Masks of poses (n, 4, 4) on the surface and of those that seal, and the probability of that.

    Everywhere under the cup the surface is at the lip, and its normal within 20 degrees of the
    approach; the springs of the lip are strained little (`strain`), the surface being as uncertain
    as it is there.
    """
    # Error of the surface where it was seen, and how far off the lip it may be [m].
    seen_error, off, most = 0.0005, 0.004, cup.max_strain
    # Turns about the normal have their place in common.
    place = np.hstack([X_OG[:, :3, 3], X_OG[:, :3, 2]]).round(7)
    _, first, place_of = np.unique(place, axis=0, return_index=True, return_inverse=True)
    points, pose, place_of = cup_points(cup), X_OG[first], place_of.reshape(-1)
    at = pose[:, None, :3, 3] - cup.press * pose[:, None, :3, 2]
    at = at + np.einsum("nij,kj->nki", pose[:, :3, :3], points)
    gap, surface, normal = gpdf.refine(at.reshape(-1, 3), 3)
    gap = gap.reshape(len(pose), len(points))
    cosine = -np.einsum("nki,ni->nk", normal.reshape(*gap.shape, 3), pose[:, :3, 2])
    near = np.abs(gap) <= off
    # Largest angle between approach and normals under the cup: 20 degrees, a guess.
    level = cosine >= np.cos(np.deg2rad(20.0))
    there, flat = near[:, -1], (near & level).all(axis=1)
    bent = strain(gap[:, :LIP], cup)
    possible = gpdf.possible(surface).reshape(gap.shape).all(axis=1)
    # What strain one metre of error brings, at the cone's springs.
    per_metre = cup.height / (cup.radius**2 + cup.height**2)
    error = surface_deviation(gpdf, surface).reshape(gap.shape)[:, :LIP].mean(axis=1)
    score = ndtr((most - bent) / (per_metre * np.hypot(seen_error, error)))
    kept, sealed = there & possible, flat & (bent <= most)
    return np.asarray(kept)[place_of], np.asarray(sealed)[place_of], score[place_of]


def recheck_suction(gpdf: Gpdf, grasps: GraspSet, gripper: SuctionCup) -> GraspSet:
    """The grasps that pass the filter on another field, with their ids and new scores."""
    good = filter_suction(gpdf, grasps.X_OG, gripper)
    return replace(good, id=grasps.id[good.id])


@dataclass(frozen=True, eq=False)
class SuctionSampler:
    """Samples suction grasps from a distance field: ``sampler(gpdf) -> GraspSet``.

    Points of the completed surface and observed ones are approached along their inward normals,
    with ``n_turns`` turns about it, which are as many poses of the arm for one grasp.

    Attributes:
        gripper: The cup.
        n_candidates: Grasps that are filtered.
        n_grasps: Most grasps returned.
        least_score: Grasps that score less are left out, while there are enough; see
            `suppress_non_maxima`.
        n_turns: Turns about the normal, evenly over half a circle: each has its flip.
    """

    gripper: SuctionCup = field(default_factory=SuctionCup)
    n_candidates: Count = 1600
    n_grasps: Count = 64
    least_score: Share = LEAST_SCORE
    n_turns: Count = 4

    def __post_init__(self) -> None:
        check_fields(self, GraspError)

    @checked(GraspError)
    def __call__(self, gpdf: Gpdf) -> GraspSet:
        """Filtered grasps, best first, in the frame of the field (object frame O)."""
        grasps = filter_suction(gpdf, self.candidates(gpdf)[0], self.gripper)
        return suppress_non_maxima(grasps, self.n_grasps, least_score=self.least_score)

    @checked(GraspError)
    def candidates(self, gpdf: Gpdf) -> tuple[Array, Array, None]:
        """Unfiltered grasps: poses X_OG (n, 4, 4) and the diameter of the cup, (n,)."""
        places = -(-self.n_candidates // self.n_turns)
        observed, completed = gpdf.seen()[0], gpdf.completion.points
        some = farthest_points(np.ascontiguousarray(observed), min(len(observed), places // 2))
        points = np.concatenate([observed[some], completed])
        some = farthest_points(np.ascontiguousarray(points), min(len(points), places))
        _, points, normals = gpdf.refine(points[some], 3)
        u, v = perpendiculars(normals)
        angle = (np.arange(self.n_turns) * np.pi / self.n_turns)[:, None, None]
        x = (np.cos(angle) * u + np.sin(angle) * v).reshape(-1, 3)
        z = np.tile(-normals, (self.n_turns, 1))
        middle = np.tile(points, (self.n_turns, 1)) + self.gripper.press * z
        X_OG = grasp_frames(middle, x, z[:, None]).reshape(-1, 4, 4)
        return X_OG, np.full(len(X_OG), 2.0 * self.gripper.radius), None
