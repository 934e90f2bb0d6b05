"""Payload filter: mass of an object, loads of finger pads and cup, and which grasps bear them.

Weight that attacks beside the closing line turns the object about it, and nothing but the friction
of the pads resists. About the other two axes they resist by where they press: on small patches,
such as a hammer's head between the pads, that is not much more.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.grasp_set import GraspSet, Load, MassEstimate, Rejection
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper, SuctionCup
from feasigrasp.models.shape.gpdf import Gpdf

# Mass and center of mass of a completed shape, with their uncertainty.
#
# The inside of an object is unobserved. Small household objects are solid, large ones hollow: their
# mass grows about as their surface does, with the volume to the power of two thirds, and is known
# by that to a factor of about two. The centre of mass is taken for that of the volume.

#: Median mass of household objects of half a litre, as a field sees them, filled [kg]; the standard
#: deviation of its logarithm. Source: guessed.
TYPICAL_VOLUME, TYPICAL_MASS, MASS_SPREAD = 5e-4, 0.35, 0.6


def estimate_mass(gpdf: Gpdf, mass: float | None = None) -> MassEstimate:
    """Mass and centre of mass of a completed shape; the mass is given if it is known [kg]."""
    # Points per axis at which the field is evaluated, inside or outside.
    grid = 12
    surface = gpdf.completion.points
    lower, upper = surface.min(axis=0), surface.max(axis=0)
    step = (upper - lower) / grid
    axes = lower + (np.arange(grid)[:, None] + 0.5) * step
    points = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = gpdf.distance(points) < 0.0
    inside[inside] = gpdf.possible(points[inside])
    # A wall that is thinner than the grid is all surface.
    filled = points[inside] if inside.any() else surface
    centre = filled.mean(axis=0)
    gyration = float(np.sqrt(((filled - centre) ** 2).sum(axis=1).mean()))
    volume = max(1, int(np.count_nonzero(inside))) * float(np.prod(step))
    typical = TYPICAL_MASS * (volume / TYPICAL_VOLUME) ** (2.0 / 3.0)
    # The error of a weighed mass is small.
    mass, spread = (typical, MASS_SPREAD) if mass is None else (mass, 0.05)
    # The deviation of the centre of mass is a share of the radius of gyration of the volume.
    return MassEstimate(mass, spread, centre, 0.2 * gyration)


#: Of gravity, and what comes on top in any direction when the hand lifts and shakes [m/s^2].
#: Source: definition: gravity; the hand's own motion is guessed.
GRAVITY, HAND_ACCELERATION = 9.81, 2.0


def unit_gravity(down: ArrayLike) -> Array:
    """Direction of gravity as a unit vector (3,).

    Raises:
        GraspError: It is none.
    """
    g = np.asarray(down, dtype=float)
    if g.shape != (3,) or not np.linalg.norm(g) > 0.0:
        raise GraspError(f"down = {down!r}: give the direction of gravity, three numbers")
    return np.asarray(g / np.linalg.norm(g))


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


@dataclass(frozen=True, eq=False)
class PadLoad(Load):
    """Loads on the pads in n grasps of one object.

    Attributes:
        force: Tangential force that both pads bear, shape (n,) [N].
        moment: Moments about the axes of the grasp frame that both bear, shape (n, 3) [Nm].
    """

    force: Array
    moment: Array
    _per_grasp = (*Load._per_grasp, "force", "moment")

    def per_kilogram(self, down: ArrayLike | None = None) -> Array:
        """See `Load.per_kilogram`; without ``down`` gravity is the worst one for each moment.

        The share is 1 on the limit surface, the ellipsoid ``(f / f_max)^2 + sum_i (m_i /
        m_max,i)^2 = 1``.
        """
        r, e = np.einsum("nji,nj->ni", self.R_OG, self.lever), self.body.centre_error
        beside = (r**2).sum(axis=1, keepdims=True) - r**2  # squared, of every axis
        if down is None:
            sideways, turning = np.ones(len(r)), beside + e * e
        else:
            g = self.R_OG.transpose(0, 2, 1) @ unit_gravity(down)
            across = np.maximum(1.0 - g**2, 0.0)
            sideways, turning = across[:, 0], np.cross(r, g) ** 2 + across * e * e
        force = GRAVITY * np.sqrt(sideways) + HAND_ACCELERATION
        by_hand = HAND_ACCELERATION * np.sqrt(beside + 2.0 * e * e)
        moment = GRAVITY * np.sqrt(turning) + by_hand
        with np.errstate(divide="ignore"):  # a patch of one cell bears no moment
            shares = np.column_stack([force / self.force, moment / self.moment])
        return np.asarray(np.linalg.norm(shares, axis=1))


# What a suction cup can hold (Dex-Net 3.0; Mahler et al., ICRA 2018). The vacuum V presses the
# sealed lip on with ``f_N = V - pull``; the contact is a soft finger on a ring of radius r:
#
#     friction  ``hypot(f_t, m_z / r) <= mu f_N``      bending  ``2 m_t / r <= f_N``
#
# The paper bounds friction by a pyramid and bending by a constant of the material; here friction is
# the ellipsoid around that pyramid, and bending what opens one side of the ring, whose line load is
# ``(f_N + 2 m_t cos(a) / r) / (2 pi r)``.


def needed_vacuum(force: ArrayLike, moment: ArrayLike, cup: SuctionCup) -> Array:
    """Vacuum force V that bears a wrench of the object on the cup (see above), shape (n,) [N].

    Force (n, 3) [N] and moment (n, 3) about the middle of the lip [Nm] are in G; z pulls.
    """
    f, m = np.asarray(force, dtype=float), np.asarray(moment, dtype=float)
    across, bending = np.hypot(f[..., 0], f[..., 1]), np.hypot(m[..., 0], m[..., 1])
    friction = np.hypot(across, m[..., 2] / cup.radius) / cup.friction
    return np.asarray(f[..., 2] + np.maximum(friction, 2.0 * bending / cup.radius))


@dataclass(frozen=True, eq=False)
class CupLoad(Load):
    """Loads on a suction cup in n grasps of one object."""

    cup: SuctionCup

    def per_kilogram(self, down: ArrayLike | None = None) -> Array:
        """Share of the vacuum that one kilogram of the object takes, shape (n,)."""
        # Axes and diagonals: directions among which the worst is looked for.
        ways = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        around = np.stack([self._needed(each) for each in ways]).max(axis=0)
        if down is None:
            share = (GRAVITY + HAND_ACCELERATION) * around
        else:
            share = GRAVITY * self._needed(unit_gravity(down)) + HAND_ACCELERATION * around
        # A cup that is pressed on bears the more.
        return np.maximum(share / self.cup.vacuum_force, 1e-6)

    def _needed(self, direction: Array) -> Array:
        """`needed_vacuum` of a force of 1 N at the center of mass, as far off as it may be."""
        force = self.R_OG.transpose(0, 2, 1) @ direction
        lever = np.einsum("nji,nj->ni", self.R_OG, self.lever)
        moment = np.cross(lever, force)
        bending = np.hypot(moment[:, 0], moment[:, 1]) + self.body.centre_error
        turned = np.column_stack([bending, np.zeros(len(bending)), moment[:, 2]])
        return needed_vacuum(force, turned, self.cup)


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
