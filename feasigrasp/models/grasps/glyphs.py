"""Meshes for grasps and surface points in visualizations."""

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.geometry.se3 import make_pose, perpendiculars
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import FLIP
from feasigrasp.models.robot.gripper import Gripper

#: Corners of a box of edge length 2, and its 12 outward-facing triangles. Source: layout.
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
_FACES = np.array([f for a, b, c, d in _QUADS for f in ((a, b, c), (a, c, d))])


def gripper_glyph(gripper: Gripper) -> tuple[Array, Indices]:
    """A fork in the grasp frame G: two open fingers, the bar that joins them, and a stem.

    The inner faces of the fingers are ``max_opening`` apart, as the pads are when the hand comes;
    the fingers end at ``tip`` and the bar lies at ``heel``, so the fork stands where the hand
    would. The stem points from where the hand comes: against the approach direction z. It has
    vertices (32, 3) [m], and triangles that index them, (48, 3).
    """
    t = 0.0015  # half the edge of the rods' square section [m]
    x = gripper.max_opening / 2 + t
    half, middle = (gripper.tip - gripper.heel) / 2, (gripper.tip + gripper.heel) / 2
    boxes = [  # centre, half sizes
        ((-x, 0.0, middle), (t, t, half)),
        ((x, 0.0, middle), (t, t, half)),
        ((0.0, 0.0, gripper.heel + t), (x - t, t, t)),
        ((0.0, 0.0, gripper.heel - half / 2), (t, t, half / 2)),
    ]
    vertices = [np.array(centre) + _CORNERS * size for centre, size in boxes]
    faces = [_FACES + len(_CORNERS) * i for i in range(len(boxes))]
    return np.concatenate(vertices), np.concatenate(faces)


def disc(radius: float) -> tuple[Array, Indices]:
    """A flat hexagon round the origin that faces z: vertices [m] and triangles."""
    angle = 2.0 * np.pi * np.arange(6) / 6
    vertices = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], axis=1)
    return vertices, np.array([(0, i, i + 1) for i in range(1, 5)])


def frames_along(points: ArrayLike, normals: ArrayLike) -> Array:
    """Frames at points whose z-axes are the unit normals, shape (n, 4, 4)."""
    z = np.asarray(normals, dtype=float)
    return make_pose(np.stack([*perpendiculars(z), z], axis=-1), points)


def place_copies(X_OG: ArrayLike, vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """A mesh with one copy of a glyph per frame (n, 4, 4).

    Of the glyph's vertices (v, 3) in G and triangles (f, 3) it has n v in O [m] and n f.
    """
    X_OG = np.asarray(X_OG, dtype=float).reshape(-1, 4, 4)
    placed = np.einsum("nij,vj->nvi", X_OG[:, :3, :3], vertices) + X_OG[:, None, :3, 3]
    offsets = len(vertices) * np.arange(len(X_OG))
    return placed.reshape(-1, 3), (faces + offsets[:, None, None]).reshape(-1, 3)


def spread_order(X_OG: ArrayLike, score: ArrayLike) -> Indices:
    """A permutation (n,) of grasps so that the first few show the variety of all.

    The best comes first; then always the one farthest from those before it, a grasp and its
    180-degree flip about z being the same. Poses are (n, 4, 4), scores (n,), higher for better.
    """
    X_OG = np.asarray(X_OG, dtype=float).reshape(-1, 4, 4)
    if len(X_OG) == 0:
        return np.zeros(0, dtype=np.int64)
    # Metres that weigh as much as one radian where the spread of grasps is measured.
    weights = np.array([1.0, 0.05])
    order = [int(np.argmax(score))]
    distance = np.full(len(X_OG), np.inf)
    for _ in range(len(X_OG) - 1):
        chosen = X_OG[order[-1]]
        symmetric_grasps = [grasp_errors(X_OG, X) @ weights for X in (chosen, chosen @ FLIP)]
        distance = np.minimum(distance, np.minimum(*symmetric_grasps))
        distance[order] = -1.0
        order.append(int(np.argmax(distance)))
    return np.array(order, dtype=np.int64)
