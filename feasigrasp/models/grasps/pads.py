"""What two soft pads can hold: pressure on the patches they touch, and the moment of its friction.

A pad is an elastic foundation (Winkler's; Johnson, "Contact Mechanics", 1985, section 4.3): where
it is pressed in by u it pushes back with ``k u``, whatever its neighbours do. A patch with the
pressure p bears a moment about the closing line of at most ``mu int |r - r_p| p dA``, with its
centre of pressure r_p, and moment and tangential force together inside an ellipsoid, its limit
surface (Howe & Cutkosky, "Practical force-motion models for sliding manipulation", 1996). About an
axis across the closing line the pressure moves to one side of the patch; ``int |s - s_p| p dA``,
with the distance s from the axis, is about what that brings before the patch opens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf

#: Cells that a pad is divided into along y and z of the grasp frame.
CELLS = (5, 7)
#: How finely a field tells the gap between pad and surface [m]: the pads are taken to be so
#: soft that their force presses the whole pad in by this much; the simulated ones are harder.
ROUGHNESS = 2e-4
_STEPS = 2


@dataclass(frozen=True, eq=False)
class Grip(Frozen):
    """What the pads bear in n grasps.

    Attributes:
        force: Tangential force that both pads bear together, for a coefficient of friction of 1,
            which scales it [N].
        moment: Moments about x, y and z of the grasp frame that both bear together, shape (n, 3);
            that about x, the closing line, likewise for a coefficient of 1 [Nm].
        p_OP: Where they bear it, the mean of the centres of pressure, shape (n, 3) [m].
    """

    force: float
    moment: Array
    p_OP: Array

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        self._freeze(moment=self.moment, p_OP=self.p_OP)


def grip_of(gpdf: Gpdf, grasps: GraspSet, gripper: ParallelGripper) -> Grip:
    """What the pads bear where they meet a completed surface.

    Args:
        gpdf: Distance field in frame O.
        grasps: Grasps in O; their widths say where the pads stop.
        gripper: The hand: size and force of its pads.
    """
    y, z, area = pad_cells(gripper)
    x, half = grasps.X_OG[:, :3, 0], 0.5 * grasps.width[:, None]
    across = np.einsum("nij,kj->nki", grasps.X_OG[:, :3, 1:3], np.column_stack([y, z]))
    stiffness = gripper.grip_force / (ROUGHNESS * area * len(y))
    moment, middle = np.zeros((len(grasps), 3)), np.zeros((len(grasps), 2))
    for way in (-1.0, 1.0):
        on_pad = (grasps.X_OG[:, :3, 3] + way * half * x)[:, None] + across
        gap = gpdf.refine(on_pad.reshape(-1, 3), _STEPS)[0].reshape(len(grasps), len(y))
        pressure = contact_pressure(gap, area, stiffness, gripper.grip_force)
        moment += moment_limits(y, z, pressure * area)
        middle += 0.5 * pressure_centre(y, z, pressure)
    p_OP = grasps.X_OG[:, :3, 3] + np.einsum("nij,nj->ni", grasps.X_OG[:, :3, 1:3], middle)
    return Grip(2.0 * gripper.grip_force, moment, p_OP)


def pad_cells(gripper: ParallelGripper) -> tuple[Array, Array, float]:
    """Middles y, z of the cells of a pad in G, shapes (k,) [m], and the area of one [m^2]."""
    sides = (gripper.finger_width, 2.0 * gripper.tip)
    y, z = (s * ((np.arange(n) + 0.5) / n - 0.5) for s, n in zip(sides, CELLS, strict=True))
    y, z = (part.ravel() for part in np.meshgrid(y, z, indexing="ij"))
    return y, z, sides[0] * sides[1] / len(y)


def contact_pressure(gap: Array, area: float, stiffness: float, force: float) -> Array:
    """Pressure of pads that are pushed against surfaces until they bear a force.

    Args:
        gap: Distance of the surface from the face of the pad, in every cell, shape (n, k) [m].
        area: Of a cell [m^2].
        stiffness: k of the foundation [Pa/m].
        force: The force [N].

    Returns:
        ``k max(0, d - gap)``, shape (n, k) [Pa], with the depth d at which it sums up to the force.
    """
    sorted_gap = np.sort(gap, axis=1)
    cells = np.arange(1, gap.shape[1] + 1)
    depth = (force / (stiffness * area) + np.cumsum(sorted_gap, axis=1)) / cells
    # With j cells in touch the depth is beyond the j-th gap and before the next.
    touching = np.maximum(1, (depth > sorted_gap).sum(axis=1))
    depth = np.take_along_axis(depth, touching[:, None] - 1, axis=1)
    return np.asarray(stiffness * np.maximum(0.0, depth - gap))


def pressure_centre(y: Array, z: Array, weight: Array) -> Array:
    """Centres of pressure (n, 2) [m] of cells at y, z, shapes (k,), with weights (n, k)."""
    share = weight / weight.sum(axis=1, keepdims=True)
    return np.column_stack([share @ y, share @ z])


def moment_limits(y: Array, z: Array, force: Array) -> Array:
    """Greatest moments that patches bear about their centres of pressure.

    Args:
        y: Where the cells are, shape (k,) [m].
        z: The same, shape (k,) [m].
        force: Normal force in every cell, shape (n, k) [N].

    Returns:
        About x, y and z: ``sum_i f_i |r_i - r_p|``, by friction with a coefficient of 1,
        ``sum_i f_i |z_i - z_p|`` and ``sum_i f_i |y_i - y_p|``, shape (n, 3) [Nm].
    """
    centre = pressure_centre(y, z, force)
    across, along = np.abs(y - centre[:, :1]), np.abs(z - centre[:, 1:])
    arms = np.stack([np.hypot(across, along), along, across])
    return np.asarray((force * arms).sum(axis=-1).T)
