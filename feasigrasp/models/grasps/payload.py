"""Payload filter: grasp wrench capacity of soft pads (Howe and Cutkosky 1996)."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.pad_load import PadLoad, estimate_mass
from feasigrasp.models.grasps.seal import CupLoad
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper, SuctionCup
from feasigrasp.models.shape.gpdf import Gpdf

# What two soft pads can hold: pressure on the patches they touch, and the moment of its friction.
#
# A pad is an elastic foundation (Winkler's; Johnson, "Contact Mechanics", 1985, section 4.3): where
# it is pressed in by u it pushes back with ``k u``, whatever its neighbours do. A patch with the
# pressure p bears a moment about the closing line of at most ``mu int |r - r_p| p dA``, with its
# centre of pressure r_p, and moment and tangential force together inside an ellipsoid, its limit
# surface (Howe & Cutkosky, "Practical force-motion models for sliding manipulation", 1996). About
# an axis across the closing line the pressure moves to one side of the patch; ``int |s - s_p| p
# dA``, with the distance s from the axis, is about what that brings before the patch opens.


def grip_of(gpdf: Gpdf, grasps: GraspSet, gripper: ParallelGripper) -> tuple[Array, Array]:
    """Grasp wrench capacity of pads on a completed surface (Johnson 1985, section 4.3).

    Field and grasps are in O; the widths of the grasps say where the pads stop.

    Returns:
        Moments about x, y and z of the grasp frame that both pads bear together, shape (n, 3) [Nm];
        that about x, the closing line, for a coefficient of friction of 1, which scales it. Where
        they bear it, the mean of the centres of pressure, shape (n, 3) [m].
    """
    # How finely a field resolves the gap between pad and surface [m]: the pads are taken to be so
    # soft that their force presses the whole pad in by this much; the simulated ones are harder.
    roughness = 2e-4
    y, z, area = pad_cells(gripper)
    x, half = grasps.X_OG[:, :3, 0], 0.5 * grasps.width[:, None]
    across = np.einsum("nij,kj->nki", grasps.X_OG[:, :3, 1:3], np.column_stack([y, z]))
    stiffness = gripper.grip_force / (roughness * area * len(y))
    moment, middle = np.zeros((len(grasps), 3)), np.zeros((len(grasps), 2))
    for way in (-1.0, 1.0):
        on_pad = (grasps.X_OG[:, :3, 3] + way * half * x)[:, None] + across
        gap = gpdf.refine(on_pad.reshape(-1, 3), 2)[0].reshape(len(grasps), len(y))
        pressure = contact_pressure(gap, area, stiffness, gripper.grip_force)
        moment += moment_limits(y, z, pressure * area)
        middle += 0.5 * pressure_centre(y, z, pressure)
    p_OP = grasps.X_OG[:, :3, 3] + np.einsum("nij,nj->ni", grasps.X_OG[:, :3, 1:3], middle)
    return moment, p_OP


def pad_cells(gripper: ParallelGripper) -> tuple[Array, Array, float]:
    """Middles y, z of the cells of a pad in G, shapes (k,) [m], and the area of one [m^2]."""
    sides = (gripper.finger_width, 2.0 * gripper.tip)
    # Cells that a pad is divided into along y and z of the grasp frame.
    y, z = (s * ((np.arange(n) + 0.5) / n - 0.5) for s, n in zip(sides, (5, 7), strict=True))
    y, z = (part.ravel() for part in np.meshgrid(y, z, indexing="ij"))
    return y, z, sides[0] * sides[1] / len(y)


def contact_pressure(gap: Array, area: float, stiffness: float, force: float) -> Array:
    """Pressure of pads that are pushed against surfaces until they bear a force [N].

    It is ``k max(0, d - gap)``, shape (n, k) [Pa], with the stiffness k of the foundation [Pa/m],
    the gap between surface and face of the pad in cells of an area [m^2], shape (n, k) [m], and the
    depth d at which it sums up to the force.
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
    """Greatest moments (n, 3) that patches bear about their centres of pressure [Nm].

    Of cells at y and z (k,) [m] with normal forces f (n, k) [N]. About x, y and z:
    ``sum_i f_i |r_i - r_p|``, by friction with a coefficient of 1, ``sum_i f_i |z_i - z_p|`` and
    ``sum_i f_i |y_i - y_p|``.
    """
    centre = pressure_centre(y, z, force)
    across, along = np.abs(y - centre[:, :1]), np.abs(z - centre[:, 1:])
    arms = np.stack([np.hypot(across, along), along, across])
    return np.asarray((force * arms).sum(axis=-1).T)


#: Friction of rubber on household surfaces, and the share of the nominal force of a hand, that
#: estimates reckon with: the low ends of what is found (scenarios draw friction from 0.5 to 0.7),
#: choices. The share of the moments of its patches that pads are trusted with is one too: but for
#: boxes, patches are smaller than they look on a completed surface, not quite opposite each other,
#: and what they press beside takes friction. Source: reasoned.
FRICTION, FORCE_SHARE, MOMENT_SHARE = 0.5, 0.9, 0.35
#: A grasp is sure to carry if it is so likely. Objects are there to be carried: one that seems too
#: heavy for all grasps is taken to be so light that the best one carries it with ``BEST``. Source:
#: guessed.
LEAST_PROBABILITY, BEST = 0.7, 0.76


def with_loads(
    gpdf: Gpdf, grasps: GraspSet, gripper: Gripper, mass: float | None = None
) -> GraspSet:
    """The grasps with the loads of their pads or cup (`GraspSet.load`).

    The mass [kg] is estimated from the field's volume if it is not given.
    """
    if len(grasps) == 0:
        return grasps
    body = estimate_mass(gpdf, mass)
    if isinstance(gripper, SuctionCup):
        lever = body.p_OC - grasps.X_OG[:, :3, 3]
        return replace(grasps, load=CupLoad(grasps.X_OG[:, :3, :3], lever, body, gripper))
    assert isinstance(gripper, ParallelGripper)
    moment, p_OP = grip_of(gpdf, grasps, gripper)
    load = PadLoad(
        R_OG=grasps.X_OG[:, :3, :3],
        lever=body.p_OC - p_OP,
        body=body,
        force=np.full(len(grasps), FRICTION * FORCE_SHARE * (2.0 * gripper.grip_force)),
        moment=MOMENT_SHARE * FORCE_SHARE * moment * [FRICTION, 1.0, 1.0],
    )
    return replace(grasps, load=load)


def rated_by_payload(grasps: GraspSet, down: ArrayLike | None = None) -> GraspSet:
    """The grasps, best first, with scores multiplied by the probability that they bear the load.

    That is of an object that one of them carries (`BEST`). Over what is asked, `LEAST_PROBABILITY`,
    it is `GraspSet.payload_score`. What hardly carries counts as "too heavy there" and is dropped.
    Without the direction of gravity in O, ``down`` (3,), the worst one for each grasp counts, and
    none is dropped: it may yet be lifted another way. Grasps without loads stay as they are.
    """
    if grasps.load is None or len(grasps) == 0:
        return grasps
    likely = grasps.load.probability(down, BEST)
    ranked = replace(grasps, score=grasps.score * likely, payload_score=likely / LEAST_PROBABILITY)
    ranked = ranked.select(np.argsort(-ranked.score, kind="stable"))
    # One that is by this factor less likely than what is asked of it does not carry.
    return ranked if down is None else filter_by_payload(ranked, 0.2)


def payload_filtered(grasps: GraspSet, down: ArrayLike | None = None) -> GraspSet:
    """The grasps that bear the weight, without reachability.

    Arguments as for `rated_by_payload`. Those of its grasps stay that are sure, and without
    ``down`` all.
    """
    some = rated_by_payload(grasps, down)
    return some if down is None else filter_by_payload(some, 1.0)


def filter_by_payload(grasps: GraspSet, least: float) -> GraspSet:
    """Grasps above a payload score; all of an unrated set."""
    if grasps.payload_score is None:
        return grasps
    return grasps.select(np.flatnonzero(grasps.payload_score >= least), Rejection.TOO_HEAVY)
