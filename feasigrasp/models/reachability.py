"""Which hand poses the arm can reach, and with which configuration, by exact inverse kinematics.

A pose counts as reached by a configuration that is inside the joint limits, free of
self-collision and clear of the table; candidates come from the closed form over the arm angle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.models import se3
from feasigrasp.models.gripper import ParallelGripper
from feasigrasp.models.iiwa_capsules import CapsuleModel, capsule_model
from feasigrasp.models.inverse_kinematics import (
    arm_angle_kernel,
    branches_kernel,
    inside_limits_kernel,
    reference_kernel,
    travel_time_kernel,
)
from feasigrasp.models.self_collision import capsule_ends_kernel, ends_collide_kernel

FloatArray = NDArray[np.float64]


@nb.njit(cache=True)
def admissible_kernel(q, model, limit_margin, clearance, table_height):  # type: ignore[no-untyped-def]
    """Whether a configuration is inside the limits and clear of itself and of the table."""
    if not inside_limits_kernel(q, limit_margin):
        return False
    R, p, ends = np.empty((8, 3, 3)), np.empty((8, 3)), np.empty(model.ends.shape)
    capsule_ends_kernel(q, model, R, p, ends)
    for c in model.movers:
        if min(ends[c, 0, 2], ends[c, 1, 2]) - model.radius[c] < table_height + clearance:
            return False
    return not ends_collide_kernel(ends, model, clearance)


@nb.njit(cache=True)
def nearest_kernel(  # type: ignore[no-untyped-def]
    X_WF, q_near, psi_near, psis, model, limit_margin, clearance, table_height, best
):
    """Writes the admissible configuration that is soonest reached from ``q_near``.

    The arm angle ``psi_near`` of ``q_near`` itself is tried first, so that the answer moves
    smoothly with the pose. Returns the travel time [s], infinite if there is none.
    """
    R0, axis, q4 = np.empty((2, 3, 3)), np.empty(3), np.empty(2)
    if not reference_kernel(X_WF, R0, axis, q4):
        return np.inf
    work, candidates = np.empty((4, 3, 3)), np.empty((8, 7))
    shortest = np.inf
    for k in range(len(psis) + 1):
        psi = psi_near if k == 0 else psis[k - 1]
        branches_kernel(X_WF, R0, axis, q4, psi, work, candidates)
        for b in range(8):
            time = travel_time_kernel(candidates[b], q_near)
            if time < shortest and admissible_kernel(
                candidates[b], model, limit_margin, clearance, table_height
            ):
                shortest = time
                best[:] = candidates[b]
    return shortest


@nb.njit(cache=True)
def _nearest_batch(  # type: ignore[no-untyped-def]
    X_WF, q_near, psis, model, limit_margin, clearance, table_height, q, times
):
    psi_near = arm_angle_kernel(q_near)
    for k in range(len(X_WF)):
        times[k] = nearest_kernel(
            X_WF[k], q_near, psi_near, psis, model, limit_margin, clearance, table_height, q[k]
        )


@nb.njit(cache=True)
def _is_reachable(X_WF, psis, model, limit_margin, clearance, table_height):  # type: ignore[no-untyped-def]
    R0, axis, q4 = np.empty((2, 3, 3)), np.empty(3), np.empty(2)
    if not reference_kernel(X_WF, R0, axis, q4):
        return False
    work, candidates = np.empty((4, 3, 3)), np.empty((8, 7))
    for psi in psis:
        branches_kernel(X_WF, R0, axis, q4, psi, work, candidates)
        for b in range(8):
            if admissible_kernel(candidates[b], model, limit_margin, clearance, table_height):
                return True
    return False


@nb.njit(cache=True)
def _reachable_batch(X_WF, psis, model, limit_margin, clearance, table_height, out):  # type: ignore[no-untyped-def]
    for k in range(len(X_WF)):
        out[k] = _is_reachable(X_WF[k], psis, model, limit_margin, clearance, table_height)


@dataclass(frozen=True, eq=False)
class Reachability:
    """Exact reachability of hand poses for the iiwa 7 with a gripper.

    Attributes:
        gripper: Tool at the flange.
        n_arm_angles: Arm angles tried per pose, evenly spaced over the circle.
        limit_margin: Distance kept from the joint limits [rad].
        clearance: Distance kept between bodies, and to the table [m].
        table_height: Height of the table top in the base frame [m].
    """

    gripper: ParallelGripper = field(default_factory=ParallelGripper)
    n_arm_angles: int = 12
    limit_margin: float = 0.05
    clearance: float = 0.02
    table_height: float = 0.0
    _model: CapsuleModel = field(init=False, repr=False)
    _psis: FloatArray = field(init=False, repr=False)
    _X_GF: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Derives what every query needs."""
        psis = np.linspace(-np.pi, np.pi, self.n_arm_angles, endpoint=False)
        object.__setattr__(self, "_model", capsule_model(self.gripper))
        object.__setattr__(self, "_psis", psis)
        object.__setattr__(self, "_X_GF", se3.inverse(self.gripper.X_FG))

    @property
    def search(self) -> tuple[FloatArray, CapsuleModel, float, float, float]:
        """What `nearest_kernel` takes: arm angles, capsules, limit margin, clearance, table."""
        return self._psis, self._model, self.limit_margin, self.clearance, self.table_height

    def reachable(self, X_WG: ArrayLike) -> NDArray[np.bool_]:
        """Which hand poses (n, 4, 4) have an admissible configuration, shape (n,)."""
        X_WF = self._flange(X_WG)
        out = np.zeros(len(X_WF), dtype=bool)
        _reachable_batch(X_WF, *self.search, out)
        return out

    def nearest(self, X_WG: ArrayLike, q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """The admissible configuration for each hand pose that is soonest reached from ``q``.

        Args:
            X_WG: Hand poses in the base frame, shape (n, 4, 4) [m].
            q: Present joint positions [rad], shape (7,).

        Returns:
            Configurations (n, 7) [rad], NaN where there is none, and travel times (n,) [s],
            ``max_j |dq_j| / v_j``, infinite where there is none.
        """
        X_WF = self._flange(X_WG)
        found, times = np.full((len(X_WF), 7), np.nan), np.empty(len(X_WF))
        _nearest_batch(X_WF, np.asarray(q, dtype=float), *self.search, found, times)
        return found, times

    def _flange(self, X_WG: ArrayLike) -> FloatArray:
        return np.ascontiguousarray(np.asarray(X_WG, dtype=float).reshape(-1, 4, 4) @ self._X_GF)
