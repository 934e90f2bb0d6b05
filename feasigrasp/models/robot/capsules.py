"""Capsules around the arm and its hand: the one source for URDF, self-collision and table checks.

A capsule is a segment with a radius. The links' sizes follow the real arm (tubes of 0.136 m
diameter; at the shoulder, the elbow and the wrist each link bulges to one side of the joint, to
0.115 m or 0.099 m from the arm's centre line; a capsule's round end goes a little further, because
the drums are flatter). The hand is `ParallelGripper` fully opened.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7

HAND_NAMES = ("palm", "left_finger", "right_finger", "camera")
#: Rigid bodies that carry capsules; ``BODY_LINK`` names the link that each of them moves with.
BODY_NAMES = (*IIWA_7.link_names, *HAND_NAMES)
BODY_LINK = np.array([*range(IIWA_7.joints + 1), *[IIWA_7.joints] * len(HAND_NAMES)])
PALM, LEFT_FINGER, RIGHT_FINGER, CAMERA = 8, 9, 10, 11

TUBE_RADIUS = 0.068

#: Pairs of bodies that can come close inside the joint limits. Left out are neighbours, links 5 and
#: 7 (both turn about the wrist, which keeps them 7 mm apart), and every pair whose distance never
#: falls below 3 cm; a test searches for the minima.
BODY_PAIRS: tuple[tuple[int, int], ...] = (
    *product((0,), (4, 5, 6, 7, PALM, LEFT_FINGER, RIGHT_FINGER, CAMERA)),
    *product((1,), (7, PALM, LEFT_FINGER, RIGHT_FINGER, CAMERA)),
    *product((2,), (PALM, LEFT_FINGER, RIGHT_FINGER)),
)

#: Every pair that is not neighbours: joints that leave their limits can bring any of them together.
NON_ADJACENT_PAIRS: tuple[tuple[int, int], ...] = tuple(
    (low, high)
    for low, high in combinations(range(len(BODY_NAMES)), 2)
    if BODY_LINK[high] - BODY_LINK[low] >= 2
)


class Capsule(NamedTuple):
    """A segment from ``a`` to ``b`` with a radius, in the frame of the body's link [m]."""

    body: int
    a: tuple[float, float, float]
    b: tuple[float, float, float]
    radius: float


class CapsuleModel(NamedTuple):
    """Capsules and the pairs to check, as the arrays that the kernels of self_collision take.

    Attributes:
        link: Link that each capsule moves with, shape (c,).
        ends: End points in that link's frame, shape (c, 2, 3) [m].
        radius: Shape (c,) [m].
        reach: Radius of the ball about the segment's middle that holds the capsule, shape (c,) [m].
        balls: Centre in the link's frame and radius of a ball that holds all capsules of a link,
            shape (8, 4) [m]; the radius is negative for a link without any.
        pairs: Indices of the capsules of each checked pair, the lower link first, shape (p, 2).
        groups: Runs of pairs between the same two links: lower link, upper link, first pair, end;
            shape (g, 4).
        movers: Indices of the capsules whose height can change (links 2 to 7), shape (m,).
    """

    link: Indices
    ends: Array
    radius: Array
    reach: Array
    balls: Array
    pairs: Indices
    groups: Indices
    movers: Indices

    def with_pairs(self, pairs: ArrayLike) -> CapsuleModel:
        """The same capsules with other pairs to check, shape (p, 2), in the same order."""
        pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        model = self._replace(pairs=pairs, groups=_groups(self.link, pairs))
        for array in model:
            array.flags.writeable = False
        return model


def arm_capsules() -> tuple[Capsule, ...]:
    """The capsules of the base and the seven links."""
    _, shoulder, upper_tube, elbow, lower_tube, wrist, _, _ = IIWA_7.link_steps
    r, out = TUBE_RADIUS, 0.120 - TUBE_RADIUS
    return (
        Capsule(0, (-0.010, 0.0, 0.0), (-0.010, 0.0, 0.050), 0.108),
        Capsule(1, (0.0, 0.0, 0.02), (0.0, 0.0, shoulder), r),
        Capsule(1, (0.0, -out, shoulder), (0.0, 0.0, shoulder), r),
        Capsule(2, (0.0, 0.0, 0.0), (0.0, 0.0, upper_tube - 0.02), r),
        Capsule(2, (0.0, 0.0, 0.0), (0.0, out, 0.0), r),
        Capsule(3, (0.0, 0.0, 0.02), (0.0, 0.0, elbow), r),
        Capsule(3, (0.0, 0.0, elbow), (0.0, out, elbow), r),
        Capsule(4, (0.0, 0.0, 0.0), (0.0, 0.0, lower_tube - 0.02), r),
        Capsule(4, (0.0, -out, 0.0), (0.0, 0.0, 0.0), r),
        Capsule(5, (0.0, 0.0, 0.02), (0.0, 0.0, 0.05), r),
        Capsule(5, (0.0, -0.054, wrist - 0.09), (0.0, -0.054, wrist), 0.045),
        Capsule(6, (0.0, -0.018, 0.0), (0.0, 0.022, 0.0), 0.070),
        Capsule(7, (0.0, 0.0, 0.020), (0.0, 0.0, 0.024), 0.050),
    )


def hand_capsules(gripper: ParallelGripper | None = None) -> tuple[Capsule, ...]:
    """The capsules of palm, opened fingers and wrist camera, carried by link 7.

    The palm and the camera are enclosed. A finger's capsule ends at its tip and is as wide as the
    finger, so the finger's corners stand out of it by less than its radius of ``finger_width/2``.
    """
    gripper = gripper or ParallelGripper()
    X_7G = _link_to_grasp(gripper)

    def capsule(body: int, a: list[float], b: list[float], radius: float) -> Capsule:
        ends = np.array([a, b]) @ X_7G[:3, :3].T + X_7G[:3, 3]
        return Capsule(body, tuple(ends[0].tolist()), tuple(ends[1].tolist()), radius)

    palm_x, palm_y, palm_z = gripper.palm_size
    finger = gripper.finger_width / 2
    x = gripper.max_opening / 2 + gripper.finger_thickness / 2
    top = gripper.tip - finger
    length, height, _ = gripper.camera_box
    _, y, z = gripper.camera_center
    return (
        capsule(
            PALM,
            [0, 0, gripper.heel - palm_z],
            [0, 0, gripper.heel],
            float(np.hypot(palm_x, palm_y) / 2),
        ),
        capsule(LEFT_FINGER, [x, 0, gripper.heel], [x, 0, top], finger),
        capsule(RIGHT_FINGER, [-x, 0, gripper.heel], [-x, 0, top], finger),
        capsule(CAMERA, [-length / 2, y, z], [length / 2, y, z], height / np.sqrt(2)),
    )


def hand_points(gripper: ParallelGripper | None = None) -> Array:
    """Points on the outside of the opened hand in the frame of link 7, shape (k, 3) [m]."""
    gripper = gripper or ParallelGripper()
    X_7G = _link_to_grasp(gripper)
    return gripper.surface_points(gripper.max_opening) @ X_7G[:3, :3].T + X_7G[:3, 3]


def _link_to_grasp(gripper: ParallelGripper) -> Array:
    """X_7G, the grasp frame on link 7."""
    X_7G = gripper.X_FG.copy()
    X_7G[2, 3] += IIWA_7.link_steps[-1]
    return X_7G


def capsule_model(
    gripper: ParallelGripper | None = None,
    *,
    with_hand: bool = True,
    body_pairs: Sequence[tuple[int, int]] = BODY_PAIRS,
) -> CapsuleModel:
    """The arrays of the arm, and of its hand unless ``with_hand`` is false.

    Args:
        gripper: The hand; the default one if not given.
        with_hand: Whether there is a hand.
        body_pairs: Pairs of bodies to check, the one nearer to the base first.
    """
    capsules = arm_capsules() + (hand_capsules(gripper) if with_hand else ())
    by_body: dict[int, list[int]] = {}
    for index, capsule in enumerate(capsules):
        by_body.setdefault(capsule.body, []).append(index)
    pairs = [
        pair
        for low, high in body_pairs
        for pair in product(by_body.get(low, ()), by_body.get(high, ()))
    ]
    link = np.array([BODY_LINK[c.body] for c in capsules])
    ends = np.array([(c.a, c.b) for c in capsules])
    radius = np.array([c.radius for c in capsules])
    model = CapsuleModel(
        link=link,
        ends=ends,
        radius=radius,
        reach=radius + np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / 2,
        balls=np.array(
            [_ball(ends[link == k], radius[link == k]) for k in range(IIWA_7.joints + 1)]
        ),
        pairs=np.empty((0, 2), dtype=np.int64),
        groups=np.empty((0, 4), dtype=np.int64),
        movers=np.flatnonzero(link >= 2),
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
    runs = [(*links[a].tolist(), a, b) for a, b in zip(starts, ends, strict=True)]
    return np.array(runs, dtype=np.int64).reshape(-1, 4)
