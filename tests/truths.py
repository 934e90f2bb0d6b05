"""What several tests compare with."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.capsules import CapsuleModel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.arm import IIWA_CAPSULES, capsule_ends_kernel


def table_distances(
    q: ArrayLike, table_height: float = 0.0, model: CapsuleModel = IIWA_CAPSULES
) -> Array:
    """Clearance above a horizontal plane of the ends of the capsules whose height can change.

    Args:
        q: Joint positions, shape (7,) [rad].
        table_height: Height of the plane in the base frame [m].
        model: The capsules; each of ``model.movers`` has two entries in a row, one per end (links 2
            to 7 and the hand; the height of link 1 never changes).

    Returns:
        Shape (2 m,) [m], negative below the plane.

    Raises:
        ValueError: ``q`` does not have shape (7,).
    """
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(IIWA_7.positions(q, 1), model, ends)
    radius = model.radius[model.movers, None]
    return np.asarray((ends[model.movers, :, 2] - radius - table_height).reshape(-1))
