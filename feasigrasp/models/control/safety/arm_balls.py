"""How far the arm's capsules are from a scene, and how the joints change that.

A capsule is covered by balls of its radius along its segment. With a ball's centre c on link k and
the scene's distance d and unit gradient n there, the ball keeps ``d(c) - r``, and joint j <= k with
axis ``a_j`` through ``p_j`` changes that by ``n . (a_j x (c - p_j))``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.robot.capsules import CapsuleModel
from feasigrasp.models.robot.iiwa import JOINT_AXES, JOINT_HEIGHTS, NUM_JOINTS
from feasigrasp.models.robot.self_collision import IIWA_CAPSULES
from feasigrasp.models.shape.scene_field import SceneField

#: Balls along a segment are at most this share of their radius apart: what sticks out of the union
#: of balls, at most ``r - sqrt(r^2 - (r/2)^2/4)``, is 3 % of the radius.
_SPACING = 0.5
#: From each link's frame to the next one's, along z [m].
_STEPS = np.diff(JOINT_HEIGHTS, prepend=0.0)


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


def obstacle_distances_and_gradients(
    q: ArrayLike,
    scene: SceneField,
    balls: ArmBalls | CapsuleModel = IIWA_CAPSULES,
    max_distance: float = 0.25,
) -> tuple[Array, Array]:
    """Signed distances between the arm's balls and a scene, and their gradients in the joints.

    Args:
        q: Joint positions, shape (7,) [rad].
        scene: The scene, in the arm's base frame, without the arm itself.
        balls: What to check, from `arm_balls`; or a capsule model, which is covered at every call.
        max_distance: Farther away is far enough [m].

    Returns:
        Distances (k,) [m], negative where a ball penetrates, ``max_distance`` at most, and
        gradients (k, 7) [m/rad], zero where it is that.

    Raises:
        ValueError: ``q`` does not have shape (7,).
        PointCloudError: ``q`` holds NaN or infinity.
    """
    q = np.ascontiguousarray(q, dtype=float)
    if q.shape != (NUM_JOINTS,):
        raise ValueError(f"joint positions must have shape (7,), got {q.shape}")
    if isinstance(balls, CapsuleModel):
        balls = arm_balls(balls)
    R, p = _link_poses(q)
    center = np.einsum("kij,kj->ki", R[balls.link], balls.center) + p[balls.link]
    distance, normal = scene.distance_and_gradient(center, max_distance + balls.radius.max())
    axis = np.einsum("jik,jk->ji", R[1:], JOINT_AXES)
    lever = np.cross(axis[None], center[:, None] - p[None, 1:])
    gradient = np.einsum("kji,ki->kj", lever, normal)
    gradient[np.arange(NUM_JOINTS)[None] >= balls.link[:, None]] = 0.0
    distance = distance - balls.radius
    gradient[distance >= max_distance] = 0.0
    return np.minimum(distance, max_distance), gradient


def _link_poses(q: Array) -> tuple[Array, Array]:
    """Rotations (8, 3, 3) and origins (8, 3) of the frames of links 0 to 7."""
    turns = Rotation.from_rotvec(q[:, None] * JOINT_AXES).as_matrix()
    R, p = np.empty((NUM_JOINTS + 1, 3, 3)), np.zeros((NUM_JOINTS + 1, 3))
    R[0] = np.eye(3)
    for k in range(NUM_JOINTS):
        p[k + 1] = p[k] + _STEPS[k] * R[k, :, 2]
        R[k + 1] = R[k] @ turns[k]
    return R, p
