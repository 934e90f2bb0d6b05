"""Procedural household shapes from a seed.

Every family draws its sizes and proportions, in metres and in the range of things that stand in a
kitchen or lie on a bench: 2 to 25 cm, some of them too large for the hand everywhere. Some families
are never trained on (`HELD_OUT`), so that they show whether a network has learnt shapes or
grasps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from manifold3d import Manifold

from feasigrasp.errors import MeshError
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp_lab.training.data import household_families as families

Maker = Callable[[np.random.Generator], Manifold]

TRAINED = (
    *("box", "cylinder", "capsule", "blob", "prism", "bottle", "cup", "bowl", "bent"),
    "compound",
)
#: Families that are never trained on.
HELD_OUT = ("superquadric", "mug", "tool")
#: One shape of the stream in so many is of such a family. Source: guessed.
HELD_OUT_EVERY = 8
FAMILIES: dict[str, Maker] = {name: getattr(families, name) for name in (*TRAINED, *HELD_OUT)}

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
