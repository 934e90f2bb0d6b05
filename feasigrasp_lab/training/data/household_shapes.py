"""Procedural household shapes from a seed.

Every family draws its sizes and proportions, in metres and in the range of things that stand in a
kitchen or lie on a bench: 2 to 25 cm, some of them too large for the hand everywhere. Some families
are never trained on (`HELD_OUT`), so that they show whether a network has learnt shapes or
grasps.
"""

from collections.abc import Callable

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold

from feasigrasp.errors import MeshError
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp_lab.training.data.solids import (
    clean,
    ellipsoid,
    lathe,
    loft,
    profile,
    rounded_box,
    solid,
    tube,
)

Rng = np.random.Generator

_X, _Y, _Z = np.eye(3)


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A number whose logarithm is uniform: as many from 2 to 4 cm as from 4 to 8 cm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def box(rng: Rng) -> Manifold:
    """A block, carton, slab or bar with more or less rounded edges."""
    size = np.array([log_uniform(rng, 0.012, 0.16) for _ in range(3)])
    if rng.random() < 0.2:
        size[rng.integers(3)] = log_uniform(rng, 0.004, 0.012)  # books, boards, cards
    size *= max(1.0, 0.03 / size.max())
    radius = min(rng.uniform(0.0005, 0.008), 0.4 * size.min())
    return rounded_box(size.tolist(), radius, arc=2, cell=float(size.max()) / 8)


def cylinder(rng: Rng) -> Manifold:
    """A can, disc, rod or tapered block, its edges rounded; some are pipes."""
    radius = log_uniform(rng, 0.006, 0.055)
    height = log_uniform(rng, 0.008, 0.22)
    top = radius * (1.0 if rng.random() < 0.6 else rng.uniform(0.5, 1.0))
    edge = min(rng.uniform(0.0005, 0.006), 0.3 * top, 0.3 * height)
    body = lathe(profile([(0, 0), (radius, 0, edge), (top, height, edge), (0, height)], arc=2))
    if rng.random() < 0.2 and top > 0.012:
        bore = top - max(0.003, rng.uniform(0.15, 0.6) * top)
        body -= Manifold.cylinder(height + 0.02, bore, bore, 40).translate([0, 0, -0.01])
    return clean(_squeezed(body, rng))


def capsule(rng: Rng) -> Manifold:
    """A cylinder with domed ends, or a ball, an egg."""
    radius = log_uniform(rng, 0.010, 0.050)
    length = 0.0 if rng.random() < 0.3 else log_uniform(rng, 0.01, 0.16)
    t = np.linspace(-np.pi / 2, np.pi / 2, 19)
    r, z = radius * np.cos(t), radius * np.sin(t)
    r[[0, -1]] = 0.0
    z += np.where(t > 0, length / 2, -length / 2)
    taper = 1.0 - rng.uniform(0.0, 0.3) * (0.5 + z / (2 * radius + length))
    return _squeezed(lathe(np.column_stack([r * taper, z]), segments=36), rng)


def superquadric(rng: Rng) -> Manifold:
    """``|x/a|^n + |y/b|^n`` to the ``m/n``, plus ``|z/c|^m``, is 1: from pillow to brick."""
    half = np.array([log_uniform(rng, 0.010, 0.075) for _ in range(3)])
    around, up = rng.uniform(1.4, 5.0, 2)
    t = np.linspace(-np.pi / 2, np.pi / 2, 25)
    c, s = np.abs(np.cos(t)) ** (2 / up), np.sign(t) * np.abs(np.sin(t)) ** (2 / up)
    c[[0, -1]] = 0.0
    centers = np.column_stack([0 * s, 0 * s, half[2] * s])
    sections = np.column_stack([half[0] * c, half[1] * c])
    return loft(centers, sections, _X, _Y, power=around, segments=40)


def blob(rng: Rng) -> Manifold:
    """A smooth lump without symmetry: fruit, pebble, soap, toy."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    u = np.asarray(sphere.vertices, dtype=float)
    radius = np.ones(len(u))
    for _ in range(rng.integers(2, 7)):
        w = rng.normal(size=3) * rng.uniform(0.8, 2.6)
        radius += rng.uniform(0.04, 0.16) * np.cos(u @ w + rng.uniform(0, 2 * np.pi))
    half = log_uniform(rng, 0.014, 0.06) * rng.uniform(0.45, 1.4, 3)
    return solid(u * np.maximum(radius, 0.3)[:, None] * half, np.asarray(sphere.faces))


def prism(rng: Rng) -> Manifold:
    """A polygon with height: wedges, L and U profiles, stars, nuts."""
    kind = rng.integers(3)
    if kind == 0:  # convex or pointed all round
        n = int(rng.integers(3, 9))
        t = np.sort(rng.uniform(0, 2 * np.pi, n)) if rng.random() < 0.3 else None
        t = 2 * np.pi * np.arange(n) / n if t is None or np.diff(t).max() > 2.5 else t
        r = 1.0 if rng.random() < 0.6 else rng.uniform(0.55, 1.0, n)
        outline = np.column_stack([r * np.cos(t), r * np.sin(t)])
    else:  # L, and U by a second leg
        a, b = rng.uniform(0.25, 0.7, 2)
        outline = np.array([[-1, -1], [1, -1], [1, b - 1], [a - 1, b - 1], [a - 1, 1], [-1, 1.0]])
        if kind == 2:
            c = rng.uniform(0.2, 0.6)
            leg = [[1, rng.uniform(0.2, 1.0)], [1 - c, 1.0], [1 - c, b - 1], [a - 1, b - 1]]
            leg[1][1] = leg[0][1]
            outline = np.array([[-1, -1], [1, -1], *leg, [a - 1, 1], [-1, 1.0]])
    outline = outline * [log_uniform(rng, 0.012, 0.07), log_uniform(rng, 0.012, 0.07)]
    area = CrossSection([outline.tolist()])
    if rng.random() < 0.5:
        area = area.offset(-0.002, circular_segments=12).offset(0.002, circular_segments=12)
        if area.is_empty():
            area = CrossSection([outline.tolist()])
    height = log_uniform(rng, 0.010, 0.15)
    # Rays and contact surfaces like long triangles better divided.
    return area.extrude(height).translate([0, 0, -height / 2]).refine_to_length(0.03)


def bottle(rng: Rng) -> Manifold:
    """A closed body of revolution: bottle, jar, vase, bulb, pawn; some are oval."""
    height = log_uniform(rng, 0.05, 0.24)
    n = int(rng.integers(3, 8))
    widest = float(np.clip(height * rng.uniform(0.12, 0.5), 0.010, 0.055))
    r = widest * rng.uniform(0.35, 1.0, n)
    if rng.random() < 0.6:  # a neck above a straight body
        r[: n // 2] = widest
        r[n // 2 :] = widest * rng.uniform(0.25, 0.6)
    z = np.cumsum(np.concatenate([[0.0], rng.uniform(0.4, 1.6, n - 1)]))
    z *= height / z[-1]
    fillet = rng.uniform(0.001, 0.02)
    outline = [(0.0, 0.0), *((a, b, min(fillet, 0.45 * a)) for a, b in zip(r, z, strict=True))]
    return _squeezed(lathe(profile([*outline, (0.0, height)], arc=2), segments=32), rng)


def cup(rng: Rng) -> Manifold:
    """An open vessel with a wall of 2 to 6 mm, straight or tapered, round or square."""
    height, wall = log_uniform(rng, 0.04, 0.16), rng.uniform(0.002, 0.006)
    foot = log_uniform(rng, 0.018, 0.05)
    rim = foot * rng.uniform(0.9, 1.6)
    edge = rng.uniform(0.0005, 0.01)
    outside = profile([(0, 0), (foot, 0, min(edge, 0.4 * foot)), (rim, height), (0, height)])
    slope = (rim - foot) / height
    low, high = foot + slope * wall - wall, rim - wall + 0.01 * slope
    inside = profile([(0, wall), (low, wall, min(edge, 0.4 * low)), (high, height + 0.01)])
    inside = np.concatenate([inside, [[0, height + 0.01]]])
    corners = 36
    if rng.random() < 0.25:
        corners = int(rng.integers(4, 9))
    body = lathe(outside, segments=corners) - lathe(inside, segments=corners)
    return clean(_squeezed(body, rng))


def bowl(rng: Rng) -> Manifold:
    """A bowl, saucer or tray: wide, open, its wall 2.5 to 7 mm."""
    rim, wall = log_uniform(rng, 0.035, 0.11), rng.uniform(0.0025, 0.007)
    depth = rim * rng.uniform(0.2, 1.0)
    bulge = rng.uniform(0.5, 2.0)
    s = np.linspace(0.0, 1.0, 12)
    foot = rim * rng.uniform(0.25, 0.6)
    r = foot + (rim - foot) * s
    z = depth * s ** (1.0 + bulge)
    slope = np.gradient(np.column_stack([r, z]), axis=0)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    inner = np.column_stack([r - wall * slope[:, 1], z + wall * slope[:, 0]])
    inner[:, 0] = np.maximum(inner[:, 0], 0.003)
    outline = [[0, 0], *np.column_stack([r, z]).tolist(), *inner[::-1].tolist(), [0, inner[0, 1]]]
    return clean(lathe(np.array(outline), segments=40))


def bent(rng: Rng) -> Manifold:
    """A bent bar: banana, handle, hook, ring segment, horn."""
    angle = rng.uniform(0.4, 4.5)
    radius = log_uniform(rng, 0.025, 0.09)
    thick = min(log_uniform(rng, 0.005, 0.022), 0.6 * radius)
    s = np.linspace(0, 1, 36)
    t = angle * (s - 0.5)
    path = np.column_stack([radius * np.sin(t), 0 * t, radius * (1 - np.cos(t))])
    girth = 1.0 - rng.uniform(0.0, 0.7) * np.abs(2 * s - rng.uniform(0.6, 1.4)) ** 2
    round_off = np.minimum(1.0, np.sqrt(np.minimum(s, 1 - s) / 0.06 + 0.1))
    half = np.column_stack([girth, girth * rng.uniform(0.5, 1.6)]) * round_off[:, None] * thick
    power = rng.uniform(1.8, 4.0)
    return tube(path, np.maximum(half, 0.0015), side=(0, -1, 0), power=power, segments=20)


def ball(rng: Rng) -> Manifold:
    """An ellipsoid, a part of compounds."""
    return ellipsoid([log_uniform(rng, 0.012, 0.045) for _ in range(3)])


#: What compounds are made of; they never begin with the last one.
_PARTS = (box, cylinder, capsule, bottle, ball, bent)


def compound(rng: Rng) -> Manifold:
    """Two to four parts that run into each other: lamps, toys, pumps, brackets, jugs."""
    body = _PARTS[rng.integers(len(_PARTS) - 1)](rng)
    for _ in range(rng.integers(1, 4)):
        part = _PARTS[rng.integers(len(_PARTS))](rng)
        part = part.rotate((90.0 * rng.integers(0, 4, 3)).tolist())
        if rng.random() < 0.3:
            part = part.rotate(rng.uniform(-60, 60, 3).tolist())
        at = _surface_point(body, rng) - 0.5 * _surface_point(part, rng)
        joined = body + part.translate(at.tolist())
        if len(joined.decompose()) == 1:
            body = joined
    size = np.array(body.bounding_box())
    largest = float((size[3:] - size[:3]).max())
    if largest > 0.22:
        body = body.scale([0.22 / largest] * 3)
    return clean(body)


def mug(rng: Rng) -> Manifold:
    """A hollow vessel with a handle on its side."""
    radius, height = log_uniform(rng, 0.025, 0.048), log_uniform(rng, 0.06, 0.13)
    top = radius * rng.uniform(0.9, 1.15)
    wall = rng.uniform(0.0025, 0.005)
    edge = rng.uniform(0.001, 0.008)
    outside = lathe(profile([(0, 0), (radius, 0, edge), (top, height), (0, height)], arc=3))
    bore = profile([(0, wall), (radius - wall, wall, edge), (top - wall, height + 1e-3)])
    inside = lathe(np.concatenate([bore, [[0, height + 1e-3]]]))
    t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 22)
    reach, span = rng.uniform(0.022, 0.040), height * rng.uniform(0.25, 0.36)
    path = np.column_stack([radius - 0.003 + reach * np.cos(t), 0 * t, span * np.sin(t)])
    path[:, 2] += height * rng.uniform(0.45, 0.55)
    half = np.array([rng.uniform(0.003, 0.005), rng.uniform(0.004, 0.009)])
    handle = tube(path, half, side=(0, -1, 0), power=rng.uniform(2.0, 3.5), segments=14)
    return clean(outside + handle - inside)


def tool(rng: Rng) -> Manifold:
    """A handle and a head: hammer, brush, screwdriver, spatula, ladle, wrench."""
    length = log_uniform(rng, 0.09, 0.20)
    x = np.linspace(0, length, 14)
    swell = 1.0 + 0.2 * np.sin(np.pi * rng.uniform(1, 4) * x / length + rng.uniform(0, 6))
    thick = log_uniform(rng, 0.005, 0.016) * swell
    thick[[0, -1]] *= 0.75
    half = np.column_stack([thick, thick * rng.uniform(0.5, 1.0)])
    centers = np.column_stack([x, 0 * x, 0 * x])
    handle = loft(centers, half, _Y, _Z, power=rng.uniform(2.0, 3.5), segments=20)
    return clean(handle + _head(rng, thick[-1]).translate([length, 0, 0]))


def _head(rng: Rng, thick: float) -> Manifold:
    """What a tool works with, round the end of its handle."""
    kind = rng.integers(4)
    if kind == 0:  # across the handle, like a hammer's
        size = [rng.uniform(0.018, 0.034), rng.uniform(0.06, 0.11), rng.uniform(0.018, 0.034)]
        return rounded_box(size, 0.003, arc=2, cell=0.02)
    if kind == 1:  # a blade along it
        size = [rng.uniform(0.05, 0.09), rng.uniform(0.02, 0.07), rng.uniform(0.003, 0.010)]
        plate = rounded_box(size, 0.3 * size[2], arc=1, cell=0.02)
        return plate.translate([0.45 * size[0], 0, 0])
    if kind == 2:  # a shaft, thinner than the handle
        radius, reach = max(0.0025, 0.4 * thick), rng.uniform(0.04, 0.09)
        return (
            Manifold.cylinder(reach, radius, radius, 20).rotate([0, 90, 0]).translate([-3e-3, 0, 0])
        )
    jaw = ball(rng)  # a lump
    low = np.array(jaw.bounding_box())[0]
    return jaw.translate([0.8 * -low, 0, 0])


def _surface_point(body: Manifold, rng: Rng) -> np.ndarray:
    """One of the vertices of a solid, shape (3,)."""
    vertices = np.asarray(body.to_mesh64().vert_properties)[:, :3]
    return np.asarray(vertices[rng.integers(len(vertices))])


def _squeezed(body: Manifold, rng: Rng) -> Manifold:
    """Every fourth body made oval."""
    return body.scale([1.0, rng.uniform(0.45, 1.0), 1.0]) if rng.random() < 0.25 else body


#: Makers by family; the place of a family seeds its shapes.
FAMILIES: dict[str, Callable[[Rng], Manifold]] = {
    make.__name__: make
    for make in (box, cylinder, capsule, blob, prism, bottle, cup, bowl, bent, compound)
    + (superquadric, mug, tool)
}
#: Families that are never trained on.
HELD_OUT = ("superquadric", "mug", "tool")
TRAINED = tuple(family for family in FAMILIES if family not in HELD_OUT)
#: One shape of the stream in so many is of such a family. Source: guessed.
HELD_OUT_EVERY = 8

#: Densities of solids and lightly filled things [kg/m^3], and masses that a hand can hold [kg].
#: Source: guessed.
_DENSITY, _MASS = (150.0, 900.0), (0.02, 0.6)


def make_shape(family: str, seed: int) -> RigidObject:
    """One shape of a family; the same seed makes the same shape.

    Args:
        family: One of `FAMILIES`.
        seed: Any whole number from 0 on.

    Returns:
        A closed surface of one piece, its origin at the centre of mass.

    Raises:
        MeshError: If there is no such family.
    """
    # Largest side of a shape, least and most [m].
    least, most = 0.02, 0.26
    if family not in FAMILIES:
        raise MeshError(f"family '{family}' is unknown; give one of {', '.join(FAMILIES)}")
    rng = np.random.default_rng([seed, list(FAMILIES).index(family)])
    mesh = _mesh(FAMILIES[family](rng))
    largest = float(mesh.extents.max())
    if not least <= largest <= most:
        mesh.apply_scale(float(np.clip(largest, least, most)) / largest)
    mass = float(np.clip(rng.uniform(*_DENSITY) * mesh.volume, *_MASS))
    color = (*rng.uniform(0.25, 0.9, 3).tolist(), 1.0)
    return RigidObject.of_mesh(f"{family}_{seed}", mesh, mass, color=color)


def shape_of(index: int, seed: int = 0) -> tuple[str, int]:
    """Family and seed of the ``index``-th shape of an endless stream for training.

    The families come in turn; one shape in `HELD_OUT_EVERY` is of a family that is held out.
    """
    held, place = divmod(index, HELD_OUT_EVERY)
    of_held = place == HELD_OUT_EVERY - 1
    among, number = (HELD_OUT, held) if of_held else (TRAINED, index - held)
    return among[number % len(among)], 1_000_003 * seed + number // len(among)


def _mesh(body: Manifold) -> trimesh.Trimesh:
    """The largest piece of a solid as a mesh, its slivers removed."""
    tolerance = 2e-5
    # Faces of a shape, at most. Source: guessed.
    while body.num_tri() > 4000 and tolerance < 1e-3:
        body = body.simplify(tolerance)
        tolerance *= 2.0
    pieces = body.decompose()
    largest = max(pieces, key=lambda piece: piece.volume()) if len(pieces) > 1 else body
    made = largest.to_mesh64()
    return trimesh.Trimesh(
        np.asarray(made.vert_properties)[:, :3],
        np.asarray(made.tri_verts, dtype=np.int64),
        process=False,
    )
