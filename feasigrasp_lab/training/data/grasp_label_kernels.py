"""Compiled loops of `grasp_truth` and `grasp_labels`: surface points inside the boxes of a hand."""

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.compiled import compiled

#: Cells of a turn table [m]: a turn's collision is decided at the middle of a cell. Source:
#: guessed.
CELL = 1e-3


@compiled(nogil=True)
def collides(points: Array, poses: Array, boxes: Array) -> Mask:
    """Whether a surface point lies in a box of a posed hand.

    Args:
        points: Dense samples of the surface, shape (n, 3) [m].
        poses: Poses of the hand's frame, shape (m, 4, 4).
        boxes: Lower and upper corners of boxes in that frame, shape (k, 2, 3) [m].

    Returns:
        Shape (m,).
    """
    lower, upper = np.empty(3), np.empty(3)
    for axis in range(3):
        lower[axis], upper[axis] = boxes[:, 0, axis].min(), boxes[:, 1, axis].max()
    hit = np.zeros(len(poses), dtype=np.bool_)
    for i in range(len(poses)):
        X = poses[i]
        for j in range(len(points)):
            dx, dy, dz = points[j, 0] - X[0, 3], points[j, 1] - X[1, 3], points[j, 2] - X[2, 3]
            x = dx * X[0, 0] + dy * X[1, 0] + dz * X[2, 0]
            if x < lower[0] or x > upper[0]:
                continue
            y = dx * X[0, 1] + dy * X[1, 1] + dz * X[2, 1]
            z = dx * X[0, 2] + dy * X[1, 2] + dz * X[2, 2]
            for k in range(len(boxes)):
                a, b = boxes[k, 0], boxes[k, 1]
                if a[0] <= x <= b[0] and a[1] <= y <= b[1] and a[2] <= z <= b[2]:
                    hit[i] = True
                    break
            if hit[i]:
                break
    return hit


def turn_table(boxes: Array, n_turns: int) -> NDArray[np.uint64]:
    """Which turns of boxes about their x-axis cover each cell of the plane across it.

    Turn k has the approach ``z = cos(t) u + sin(t) (x x u)`` with ``t = 2 pi k / n_turns``.

    Args:
        boxes: Lower and upper corners of the boxes, shape (k, 2, 3) [m].
        n_turns: Number of turns, at most 64.

    Returns:
        Per box, one bit per turn for every cell (u, v), shape (s, s, k); the origin is in the
        middle.
    """
    reach = float(np.linalg.norm(np.abs(boxes[:, :, 1:]).max(axis=1), axis=1).max())
    half = int(np.ceil(reach / CELL)) + 1
    middle = (np.arange(2 * half) - half + 0.5) * CELL
    u, v = np.meshgrid(middle, middle, indexing="ij")
    table = np.zeros((*u.shape, len(boxes)), dtype=np.uint64)
    for turn in range(n_turns):
        t = 2 * np.pi * turn / n_turns
        y, z = np.sin(t) * u - np.cos(t) * v, np.cos(t) * u + np.sin(t) * v
        for k, (low, high) in enumerate(boxes):
            inside = (low[1] <= y) & (y <= high[1]) & (low[2] <= z) & (z <= high[2])
            table[inside, k] |= np.uint64(1 << turn)
    return table


@compiled(nogil=True)
def blocked_turns(
    points: Array,
    centers: Array,
    closing: Array,
    across: Array,
    ranges: Array,
    table: NDArray[np.uint64],
) -> NDArray[np.uint64]:
    """In which turns about its closing line each box of a hand holds a surface point.

    Args:
        points: Dense samples of the surface, shape (n, 3) [m].
        centers: Origins of the grasp frames, shape (m, 3) [m].
        closing: Closing directions (x-axes), unit, shape (m, 3).
        across: Approach of turn 0, unit, perpendicular to those, shape (m, 3).
        ranges: Extent of every box along x, shape (k, 2) [m].
        table: Of these boxes, see `turn_table`.

    Returns:
        One bit per turn, shape (m, k).
    """
    n_boxes, side = len(ranges), table.shape[0]
    half = side * 0.5
    low, high = ranges[:, 0].min(), ranges[:, 1].max()
    out = np.zeros((len(centers), n_boxes), dtype=np.uint64)
    for i in range(len(centers)):
        cx, cy, cz = centers[i]
        b0, b1, b2 = closing[i]
        u0, u1, u2 = across[i]
        v0, v1, v2 = b1 * u2 - b2 * u1, b2 * u0 - b0 * u2, b0 * u1 - b1 * u0
        for j in range(len(points)):
            dx, dy, dz = points[j, 0] - cx, points[j, 1] - cy, points[j, 2] - cz
            x = dx * b0 + dy * b1 + dz * b2
            if x < low or x > high:
                continue
            u = (dx * u0 + dy * u1 + dz * u2) / CELL + half
            v = (dx * v0 + dy * v1 + dz * v2) / CELL + half
            if u < 0.0 or v < 0.0 or u >= side or v >= side:
                continue
            row, column = int(u), int(v)
            for k in range(n_boxes):
                if ranges[k, 0] <= x <= ranges[k, 1]:
                    out[i, k] |= table[row, column, k]
    return out
