"""Seal and wrench limits of a suction cup (Dex-Net 3.0; Mahler et al., ICRA 2018).

The lip is a ring of points on springs to each other and to the apex. It seals if every point meets
the surface along the approach direction with little strain in the springs, and if the surface has
no gap inside the ring. The vacuum V presses the sealed lip on with ``f_N = V - pull``; the contact
is a soft finger on a ring of radius r:

    friction  ``hypot(f_t, m_z / r) <= mu f_N``      bending  ``2 m_t / r <= f_N``

The paper bounds friction by a pyramid and bending by a constant of the material; here friction is
the ellipsoid around that pyramid, and bending what opens one side of the ring, whose line load is
``(f_N + 2 m_t cos(a) / r) / (2 pi r)``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.grasps.pad_load import GRAVITY, HAND_ACCELERATION, Load, unit_gravity
from feasigrasp.models.robot.gripper import SuctionCup

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


def needed_vacuum(force: ArrayLike, moment: ArrayLike, cup: SuctionCup) -> Array:
    """Vacuum force V that bears a wrench of the object on the cup (see above), shape (n,) [N].

    Force (n, 3) [N] and moment (n, 3) about the middle of the lip [Nm] are in G; z pulls.
    """
    f, m = np.asarray(force, dtype=float), np.asarray(moment, dtype=float)
    across, bending = np.hypot(f[..., 0], f[..., 1]), np.hypot(m[..., 0], m[..., 1])
    friction = np.hypot(across, m[..., 2] / cup.radius) / cup.friction
    return np.asarray(f[..., 2] + np.maximum(friction, 2.0 * bending / cup.radius))


@dataclass(frozen=True, eq=False)
class CupLoad(Load):
    """Loads on a suction cup in n grasps of one object."""

    cup: SuctionCup

    def per_kilogram(self, down: ArrayLike | None = None) -> Array:
        """Share of the vacuum that one kilogram of the object takes, shape (n,)."""
        # Axes and diagonals: directions among which the worst is looked for.
        ways = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        around = np.stack([self._needed(each) for each in ways]).max(axis=0)
        if down is None:
            share = (GRAVITY + HAND_ACCELERATION) * around
        else:
            share = GRAVITY * self._needed(unit_gravity(down)) + HAND_ACCELERATION * around
        # A cup that is pressed on bears the more.
        return np.maximum(share / self.cup.vacuum_force, 1e-6)

    def _needed(self, direction: Array) -> Array:
        """`needed_vacuum` of a force of 1 N at the center of mass, as far off as it may be."""
        force = self.R_OG.transpose(0, 2, 1) @ direction
        lever = np.einsum("nji,nj->ni", self.R_OG, self.lever)
        moment = np.cross(lever, force)
        bending = np.hypot(moment[:, 0], moment[:, 1]) + self.body.centre_error
        turned = np.column_stack([bending, np.zeros(len(bending)), moment[:, 2]])
        return needed_vacuum(force, turned, self.cup)
