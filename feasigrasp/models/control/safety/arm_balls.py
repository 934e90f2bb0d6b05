"""Balls that cover the arm, whose distances to a scene are looked up one by one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.robot.capsule_kernels import LINKS, link_poses_kernel
from feasigrasp.models.robot.capsules import CapsuleModel
from feasigrasp.models.robot.self_collision import IIWA_CAPSULES

#: Balls along a segment are at most this share of their radius apart: what sticks out of the union
#: of balls, at most ``r - sqrt(r^2 - (r/2)^2/4)``, is 3 % of the radius.
_SPACING = 0.5


class ArmBalls(NamedTuple):
    """Balls that cover the capsules whose links can move, base and link 1 apart.

    Attributes:
        link: Link that each ball moves with, shape (k,).
        center: Its centre in that link's frame, shape (k, 3) [m].
        radius: Its radius, shape (k,) [m].
    """

    link: Indices
    center: Array
    radius: Array

    def placed(self, q: Array) -> Array:
        """The centres at joint positions q (7,), shape (k, 3) [m]."""
        R, p = np.empty((LINKS, 3, 3)), np.empty((LINKS, 3))
        link_poses_kernel(np.array(q, dtype=float), R, p)
        center: Array = np.einsum("kij,kj->ki", R[self.link], self.center) + p[self.link]
        return center


def arm_balls(model: CapsuleModel = IIWA_CAPSULES) -> ArmBalls:
    """Covers the moving capsules of a model with balls of their radii."""
    links, centers, radii = [], [], []
    for c in model.movers:
        first, last = model.ends[c]
        gaps = np.linalg.norm(last - first) / (_SPACING * model.radius[c])
        share = np.linspace(0.0, 1.0, int(np.ceil(gaps - 1e-9)) + 1)[:, None]
        centers.append(first + share * (last - first))
        links.append(np.full(len(share), model.link[c]))
        radii.append(np.full(len(share), model.radius[c]))
    return ArmBalls(np.concatenate(links), np.concatenate(centers), np.concatenate(radii))
