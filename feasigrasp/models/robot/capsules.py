"""Capsule model of arm and hand, for the URDF, self-collision and table tests.

A capsule is a segment with a radius. Every vertex of a visible link lies in a capsule of that link,
so that what the capsules keep apart is apart. ``python tools/fit_capsules.py`` finds the capsules
of least volume that do so; `Arm.capsules` are what it prints. Those of the hand follow from
`ParallelGripper`, fully opened.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.robot.arm import Arm, Capsule
from feasigrasp.models.robot.capsule_kernels import link_poses_kernel
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7

HAND_NAMES = ("palm", "left_finger", "right_finger", "camera")


class CapsuleModel(NamedTuple):
    """Capsules and the pairs to check, as the arrays that the kernels of self_collision take.

    Attributes:
        chain: That of the `Arm`.
        link: Link that each capsule moves with, shape (c,).
        ends: End points in that link's frame, shape (c, 2, 3) [m].
        radius: Shape (c,) [m].
        reach: Radius of the ball about the segment's middle that holds the capsule, shape (c,) [m].
        balls: Centre in the link's frame and radius of a ball that holds all capsules of a link,
            shape (n + 1, 4) [m]; the radius is negative for a link without any.
        pairs: Indices of the capsules of each checked pair, the lower link first, shape (p, 2).
        groups: Runs of pairs between the same two links: lower link, upper link, first pair, end;
            shape (g, 4).
        movers: Indices of the capsules whose height can change (from link 2 on), shape (m,).
    """

    chain: Array
    link: Indices
    ends: Array
    radius: Array
    reach: Array
    balls: Array
    pairs: Indices
    groups: Indices
    movers: Indices

    def placed(self, q: Array) -> Array:
        """The end points in the world at joint positions q (n,) [rad], shape (c, 2, 3) [m]."""
        R, p = link_poses(self.chain, q)
        ends: Array = np.einsum("cij,cej->cei", R[self.link], self.ends) + p[self.link][:, None]
        return ends

    def with_pairs(self, pairs: ArrayLike) -> Self:
        """The capsules with other collision pairs, shape (p, 2), in the same order."""
        pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        model = self._replace(pairs=pairs, groups=_groups(self.link, pairs))
        for array in model:
            array.flags.writeable = False
        return model


def link_poses(chain: Array, q: Array) -> tuple[Array, Array]:
    """Rotations (n + 1, 3, 3) and origins (n + 1, 3) [m] of the link frames in the world."""
    R, p = np.empty((len(chain), 3, 3)), np.empty((len(chain), 3))
    link_poses_kernel(chain, np.array(q, dtype=float), R, p)
    return R, p


def hand_capsules(gripper: Gripper | None = None, arm: Arm = IIWA_7) -> tuple[Capsule, ...]:
    """The capsules of palm, opened fingers and wrist camera, carried by the last link.

    They hold the boxes of `ParallelGripper` and what the hand's visible bodies add to them: the
    guide in which the fingers run, and the bracket of the camera.
    """
    gripper = gripper or ParallelGripper()
    X_LG = arm.X_LF @ gripper.X_FG
    palm, first, _, camera = range(arm.joints + 1, arm.joints + 5)

    def capsule(body: int, a: ArrayLike, b: ArrayLike, radius: float) -> Capsule:
        ends = np.array([a, b]) @ X_LG[:3, :3].T + X_LG[:3, 3]
        return Capsule(body, tuple(ends[0].tolist()), tuple(ends[1].tolist()), float(radius))

    palm_x, palm_y, palm_z = np.array(gripper.palm_size) / 2
    reach_x, reach_y, _ = gripper.reach
    guide = np.array([reach_x, reach_y, palm_z]) + (0.003, 0.003, 0.0)
    palm_radius = 1.1 * max(np.hypot(palm_y, palm_z), np.hypot(*guide[1:]))
    halves = (
        half - np.sqrt(palm_radius**2 - y**2 - palm_z**2)
        for half, y in ((palm_x, palm_y), (guide[0], guide[1]))
    )
    palm_half = max(*halves, 0.001)
    middle = gripper.heel - palm_z
    length, height, depth = gripper.camera_box
    _, y, z = gripper.camera_center
    back = gripper.heel - 2 * palm_z
    return (
        capsule(palm, [-palm_half, 0, middle], [palm_half, 0, middle], palm_radius),
        capsule(palm, [0, 0, back - 0.014], [0, y, back - 0.014], 0.024),
        *(capsule(first + k, *each) for k, each in enumerate(gripper.capsules())),
        capsule(camera, [-length / 2, y, z], [length / 2, y, z], np.hypot(height, depth) / 2),
    )


def hand_points(gripper: Gripper | None = None, arm: Arm = IIWA_7) -> Array:
    """Points all over the opened hand in the frame of the last link, shape (k, 3) [m]."""
    gripper = gripper or ParallelGripper()
    X_LG = arm.X_LF @ gripper.X_FG
    return gripper.skin_points() @ X_LG[:3, :3].T + X_LG[:3, 3]


def body_pairs_of(gripper: Gripper | None = None, arm: Arm = IIWA_7) -> Sequence[tuple[int, int]]:
    """The pairs of bodies that are kept apart, the one nearer to the base first.

    Of the default hand those that can come close; any other hand is kept off all links but the two
    that carry it.
    """
    if gripper is None or hand_capsules(gripper, arm) == hand_capsules(None, arm):
        return arm.pairs
    n = arm.joints
    links = [pair for pair in arm.pairs if pair[1] <= n]
    return sorted({*links, *product(range(n - 1), range(n + 1, n + 1 + len(HAND_NAMES)))})


def capsule_model(
    gripper: Gripper | None = None,
    arm: Arm = IIWA_7,
    *,
    with_hand: bool = True,
    body_pairs: Sequence[tuple[int, int]] | None = None,
) -> CapsuleModel:
    """The arrays of an arm, and of its hand, by default the packaged one, unless without.

    Checked are pairs of bodies, the one nearer to the base first: `body_pairs_of`, if not given.
    """
    body_pairs = body_pairs_of(gripper, arm) if body_pairs is None else body_pairs
    capsules = arm.capsules + (hand_capsules(gripper, arm) if with_hand else ())
    by_body: dict[int, list[int]] = {}
    for index, capsule in enumerate(capsules):
        by_body.setdefault(capsule.body, []).append(index)
    pairs = [
        pair
        for low, high in body_pairs
        for pair in product(by_body.get(low, ()), by_body.get(high, ()))
    ]
    link = np.array([min(c.body, arm.joints) for c in capsules])
    ends = np.array([(c.a, c.b) for c in capsules])
    radius = np.array([c.radius for c in capsules])
    model = CapsuleModel(
        chain=arm.chain,
        link=link,
        ends=ends,
        radius=radius,
        reach=radius + np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / 2,
        balls=np.array([_ball(ends[link == k], radius[link == k]) for k in range(arm.joints + 1)]),
        pairs=np.empty((0, 2), dtype=np.int64),
        groups=np.empty((0, 4), dtype=np.int64),
        movers=np.flatnonzero(link >= (2 if arm.upright else 1)),
    )
    return model.with_pairs(pairs)


def _ball(ends: Array, radius: Array) -> list[float]:
    """A ball about the middle of the bounding box, [x, y, z, radius]."""
    if len(ends) == 0:
        return [0.0, 0.0, 0.0, -1.0]
    low = (ends - radius[:, None, None]).min(axis=(0, 1))
    high = (ends + radius[:, None, None]).max(axis=(0, 1))
    centre = (low + high) / 2
    reach = np.linalg.norm(ends - centre, axis=2) + radius[:, None]
    return [*centre.tolist(), float(reach.max())]


def _groups(link: Indices, pairs: Indices) -> Indices:
    """The runs of pairs between the same two links."""
    links = link[pairs].reshape(-1, 2)
    starts = [k for k in range(len(pairs)) if k == 0 or (links[k] != links[k - 1]).any()]
    ends = [*starts[1:], len(pairs)]
    runs = [(*links[a].tolist(), a, b) for a, b in zip(starts, ends, strict=False)]
    return np.array(runs, dtype=np.int64).reshape(-1, 4)


class ArmBalls(NamedTuple):
    """Balls that cover the capsules whose links can move, base and link 1 apart.

    Attributes:
        chain: That of the `Arm`.
        link: Link that each ball moves with, shape (k,).
        center: Its centre in that link's frame, shape (k, 3) [m].
        radius: Its radius, shape (k,) [m].
    """

    chain: Array
    link: Indices
    center: Array
    radius: Array

    def placed(self, q: Array) -> Array:
        """The centres at joint positions q (n,), shape (k, 3) [m]."""
        R, p = link_poses(self.chain, q)
        center: Array = np.einsum("kij,kj->ki", R[self.link], self.center) + p[self.link]
        return center


def arm_balls(model: CapsuleModel) -> ArmBalls:
    """Covers the moving capsules of a model with balls of their radii."""
    links, centers, radii = [], [], []
    for c in model.movers:
        first, last = model.ends[c]
        # Balls along a segment are at most this share of their radius apart: what sticks out of the
        # union of balls, at most ``r - sqrt(r^2 - (r/2)^2/4)``, is 3 % of the radius.
        gaps = np.linalg.norm(last - first) / (0.5 * model.radius[c])
        share = np.linspace(0.0, 1.0, int(np.ceil(gaps - 1e-9)) + 1)[:, None]
        centers.append(first + share * (last - first))
        links.append(np.full(len(share), model.link[c]))
        radii.append(np.full(len(share), model.radius[c]))
    return ArmBalls(
        model.chain, np.concatenate(links), np.concatenate(centers), np.concatenate(radii)
    )
