"""Width of a convex hull: the least distance between two parallel planes with all points between.

Of a polytope it is taken over the planes of its faces (Houle & Toussaint, "Computing the width of a
set", IEEE PAMI 1988, where pairs of edges count, too: those are hardly closer here).
"""

from typing import Annotated

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.quantities import CLOUD, Positive


@checked(GraspError)
def is_wider(
    points: Annotated[Array, CLOUD], normals: Annotated[Array, CLOUD], opening: Positive
) -> bool:
    """Whether observed surface is convex, and wider than a hand's opening in every direction.

    Then no view of the rest makes it narrower. A bowl or a mug that is seen from above is not.

    Args:
        points: Of the observed surface, shape (n, 3) [m].
        normals: Outward unit normals there, shape (n, 3).
        opening: Of the hand [m].
    """
    most, off, share = 300, 5e-3, 0.97  # points; [m] below the hull, of so many of them
    points, normals = (each[:: 1 + len(each) // most] for each in (points, normals))
    if len(points) < 20 or (np.ptp(points, axis=0) <= opening).any():
        return False
    try:
        planes = ConvexHull(points).equations
    except QhullError:
        return False
    depth = -(points @ planes[:, :3].T + planes[:, 3])
    # On a face that looks where the surface does: the inside of a bowl is on its hull, too.
    outside = (depth <= off) & (normals @ planes[:, :3].T > 0.5)
    convex = np.mean(outside.any(axis=1)) >= share
    return bool(convex and depth.max(axis=0).min() > opening)
