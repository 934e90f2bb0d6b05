"""Exact reachability of hand poses by closed-form inverse kinematics.

A pose counts as reached by a configuration that is inside the joint limits, free of
self-collision and clear of the table; candidates come from the closed form over the arm angle.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.quantities import ANY_POSES, JOINT_POSITIONS, JOINTS, Count
from feasigrasp.models.reach.kernels import REACHABLE as REACHABLE
from feasigrasp.models.reach.kernels import (
    Search,
    admissible_batch_kernel,
    nearest_batch_kernel,
    verdict_batch_kernel,
)
from feasigrasp.models.robot.arm import Arm, Family
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7


class Verdict(StrEnum):
    """Verdict on the reachability of a hand pose or grasp."""

    REACHABLE = "reachable"
    WRIST = "wrist out of reach"
    LIMITS = "joint limits"
    SELF_COLLISION = "self-collision"
    TABLE = "table"
    UNLIKELY = "unlikely under the reachable-space mixture"
    KEPT = "kept"
    SOON = "out of reach soon"
    BETTER = "better grasps in reach"
    NO_WAY_IN = "no way in"


#: What the codes of verdicts on poses stand for.
VERDICTS = tuple(Verdict)


@dataclass(frozen=True, eq=False)
class Reachability(Frozen):
    """Exact reachability of hand poses for an arm with a gripper.

    Whether some configuration is inside the joint limits is decided exactly, by the intervals of
    arm angle that are; collisions are looked at inside these intervals, at steps of at most
    ``2 pi / n_arm_angles``.

    Attributes:
        gripper: Tool at the flange.
        arm: The arm.
        n_arm_angles: Arm angles tried per pose, evenly spaced over the circle.
        limit_margin: Distance kept from the joint limits [rad]; negative for a tolerance.
        clearance: Distance kept between bodies [m]; likewise.
        table_clearance: Distance kept to the table [m]; likewise.
        table_height: Height of the table top in the base frame [m].
    """

    gripper: Gripper = field(default_factory=ParallelGripper)
    n_arm_angles: Count = 12
    limit_margin: float = 0.05
    clearance: float = 0.02
    table_clearance: float = 0.02
    table_height: float = 0.0
    arm: Arm = IIWA_7
    search: Search = field(init=False, repr=False)
    _X_GF: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Derives what every query needs."""
        check_fields(self, ReachabilityError)
        object.__setattr__(self, "search", _make_search(self))
        object.__setattr__(self, "_X_GF", se3.inverse(self.gripper.X_FG))

    @checked(ReachabilityError)
    def reachable(self, X_WG: Annotated[ArrayLike, ANY_POSES]) -> Mask:
        """Mask of hand poses (n, 4, 4) with an admissible configuration, shape (n,)."""
        return self.verdicts(X_WG) == REACHABLE

    @checked(ReachabilityError)
    def verdicts(self, X_WG: Annotated[ArrayLike, ANY_POSES]) -> NDArray[np.int8]:
        """Why hand poses cannot be reached, as places in `VERDICTS`.

        Args:
            X_WG: Hand poses in the base frame, shape (n, 4, 4) [m].

        Returns:
            Shape (n,). "wrist out of reach" also stands for an unknown pose (not finite); "joint
            limits": no arm angle is inside them; "self-collision": every configuration inside the
            limits collides; "table": those that do not are too close to the table, or the hand is.

        Raises:
            ReachabilityError: Another shape, or a rotation that is none; within
                `ROTATION_TOLERANCE` it is projected onto SO(3).
        """
        return self.flange_verdicts(self.flange(X_WG))

    @checked(ReachabilityError)
    def flange_verdicts(self, X_WF: Annotated[ArrayLike, ANY_POSES]) -> NDArray[np.int8]:
        """`verdicts` of flange poses (n, 4, 4)."""
        poses = np.asarray(X_WF).reshape(-1, 4, 4)
        verdicts = np.empty(len(poses), dtype=np.int8)
        verdict_batch_kernel(poses, self.search, verdicts)
        return verdicts

    @checked(ReachabilityError)
    def nearest(
        self, X_WG: Annotated[ArrayLike, ANY_POSES], q: Annotated[ArrayLike, JOINT_POSITIONS]
    ) -> tuple[Array, Array]:
        """The admissible configuration for each hand pose that is soonest reached from ``q``.

        Of hand poses (n, 4, 4) in the base frame and present joint positions ``q`` (7,) [rad]:
        configurations (n, 7) [rad], NaN where there is none, and travel times (n,) [s],
        ``max_j |dq_j| / v_j``, infinite where there is none.
        """
        X_WF = self.flange(X_WG)
        found, times = np.full((len(X_WF), self.arm.joints), np.nan), np.empty(len(X_WF))
        nearest_batch_kernel(X_WF, self.arm.positions(q, 1), self.search, found, times)
        return found, times

    @checked(ReachabilityError)
    def admissible(self, q: Annotated[ArrayLike, JOINTS]) -> Mask:
        """Mask of configurations (n, 7) inside the limits and without collision."""
        Q = self.arm.positions(q).reshape(-1, self.arm.joints)
        out = np.empty(len(Q), dtype=np.bool_)
        admissible_batch_kernel(Q, self.search, out)
        return out

    @checked(ReachabilityError)
    def flange(self, X_WG: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Flange poses (n, 4, 4) of hand poses (n, 4, 4)."""
        return np.ascontiguousarray(np.asarray(X_WG).reshape(-1, 4, 4) @ self._X_GF)


def _redundancies(arm: Arm, n: int) -> Array:
    """Arm angles of an S-R-S arm, else positions of the last of seven joints [rad]."""
    if arm.family == Family.SRS:
        return np.linspace(-np.pi, np.pi, n, endpoint=False)
    if arm.family in (Family.PARALLEL, Family.SEEDED):
        return np.zeros(1)
    low, high = arm.turns[0][6], arm.turns[1][6]
    return np.asarray(low + (np.arange(n) + 0.5) / n * (high - low))


def _make_search(reachability: Reachability) -> Search:
    """Sorts out which pairs of capsules the flange pose alone decides."""
    arm = reachability.arm
    capsules = capsule_model(reachability.gripper, arm)
    # What is on the axis of joint 1 does not move with it.
    around = (capsules.link == 1) & (np.abs(capsules.ends[:, :, :2]).max(axis=(1, 2)) == 0.0)
    around &= arm.upright
    ends = capsules.ends.copy()
    ends[capsules.link == 1] += arm.points[0]
    low, high = capsules.pairs.T
    decided = (around | (capsules.link == 0))[low] & (capsules.link[high] == arm.joints)
    movers = capsules.movers[capsules.link[capsules.movers] < arm.joints]
    X_FL = se3.inverse(arm.X_LF)
    return Search(
        chain=arm.chain,
        psis=_redundancies(arm, reachability.n_arm_angles),
        spacing=2.0 * np.pi / reachability.n_arm_angles,
        limit_margin=float(reachability.limit_margin),
        clearance=float(reachability.clearance),
        floor=float(reachability.table_height + reachability.table_clearance),
        capsules=capsules,
        open=capsules._replace(movers=movers).with_pairs(capsules.pairs[~decided]),
        hand=np.flatnonzero(capsules.link == arm.joints),
        on_flange=capsules.ends @ X_FL[:3, :3].T + X_FL[:3, 3],
        fixed=ends,
        fixed_pairs=np.ascontiguousarray(capsules.pairs[decided]),
    )
