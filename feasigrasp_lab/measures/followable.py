"""Moving hand poses that the arm can keep up with."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.ik.closed_form import closed_form
from feasigrasp.models.robot.iiwa import IIWA_7


def followable(
    X_WF: Array, dt: float, shares: tuple[float, float] = (1.0, 1.0), arm_angles: int = 16
) -> Mask:
    """Whether some configuration follows moving flange poses inside the arm's limits.

    The arm keeps its branch and its arm angle, one of so many; it may collide with itself or the
    table. Velocities and accelerations are central differences.

    Args:
        X_WF: Flange poses at k instants, shape (..., k, 4, 4), k > 2 [m]; limits are kept at all
            but the first and the last.
        dt: Time between instants [s].
        shares: Of the velocity and of the acceleration limits that are used.
        arm_angles: How many arm angles are tried.

    Returns:
        Shape (...).
    """
    poses = np.ascontiguousarray(X_WF, dtype=float)
    found = np.zeros(poses.shape[:-3], dtype=bool)
    fastest = np.multiply(shares[0], IIWA_7.velocity_limits)
    sharpest = np.multiply(shares[1], IIWA_7.acceleration_limits)
    for psi in np.linspace(-np.pi, np.pi, arm_angles, endpoint=False):
        q = closed_form(poses, psi)  # (..., k, 8, 7), NaN out of reach
        before, now, after = q[..., :-2, :, :], q[..., 1:-1, :, :], q[..., 2:, :, :]
        kept = np.abs(now) <= IIWA_7.position_limits
        kept &= np.abs(after - before) <= 2.0 * dt * fastest
        kept &= np.abs(after - 2.0 * now + before) <= dt**2 * sharpest
        found |= kept.all(axis=(-3, -1)).any(axis=-1)
    return found
