"""Decomposition of a mesh into closed bodies and cavities, and their union.

A *shell* is a connected closed surface. One inside another is the wall of a cavity; the others are
bodies, and an object is one of them.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array, Indices, Mask

#: Bodies with less than this share of the largest one's volume are crumbs of a scan.
_CRUMB = 0.01
#: Of a mesh in more sheets than these no wall is looked for: it is torn.
_MOST_SHEETS = 10
_UNITED = "united bodies that touch or overlap"


def clean(vertices: Array, faces: NDArray[Any]) -> trimesh.Trimesh:
    """Merges vertices by position and drops faces that collapse to an edge by that."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    f = mesh.faces
    mesh.update_faces((f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0]))
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def unite(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """Makes one body of those that touch or overlap, by Manifold's booleans.

    Returns:
        The given mesh, with nothing said, if there is nothing to unite or a shell is open.
    """
    label = shell_of_faces(mesh)
    shells = [part(mesh, label == i) for i in range(label.max() + 1)]
    if len(shells) < 2:
        return mesh, ()
    if not all(shell.is_watertight for shell in shells):
        return _without_wall(mesh, label)
    for shell in shells:
        trimesh.repair.fix_winding(shell)
        if signed_volume(shell) < 0:
            shell.invert()
    cavity = [
        bool(sum(encloses(other, shell) for other in shells if other is not shell) % 2)
        for shell in shells
    ]
    bodies = [shell for shell, inner in zip(shells, cavity, strict=True) if not inner]
    pairs = list(combinations(bodies, 2))
    if any(encloses(a, b) or encloses(b, a) for a, b in pairs):
        return mesh, ()  # one lies in a cavity of another
    if not any(_meet(a, b) for a, b in pairs):
        return mesh, ()
    united = trimesh.boolean.union(bodies, engine="manifold")
    hollows = [shell for shell, inner in zip(shells, cavity, strict=True) if inner]
    if hollows:
        united = trimesh.boolean.difference([united, *hollows], engine="manifold")
    result = clean(np.asarray(united.vertices), np.asarray(united.faces))
    left = result.body_count - len(hollows)
    if left >= len(bodies):  # their boxes meet, they do not
        return mesh, ()
    return result, (_UNITED,)


def _without_wall(mesh: trimesh.Trimesh, label: Indices) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """Drops the wall between two bodies that share a face, whose rims have been merged by then.

    It is one sheet, or one of either body; of what is closed without them, the wall is that whose
    loss leaves the most volume.
    """
    sheets = range(min(label.max() + 1, _MOST_SHEETS))
    closed = []
    for wall in (*combinations(sheets, 1), *combinations(sheets, 2)):
        rest = part(mesh, ~np.isin(label, wall))
        if len(rest.faces) and rest.is_watertight:
            trimesh.repair.fix_winding(rest)
            closed.append((abs(signed_volume(rest)), wall, rest))
    return (max(closed)[2], (_UNITED,)) if closed else (mesh, ())


def _meet(a: trimesh.Trimesh, b: trimesh.Trimesh) -> bool:
    """Whether the boxes around two bodies have a point in common."""
    return bool((a.bounds[0] <= b.bounds[1]).all() and (b.bounds[0] <= a.bounds[1]).all())


def drop_satellites(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """Drops the bodies, and what is inside them, that are crumbs beside the largest one.

    Args:
        mesh: Closed and oriented, see `orient`.
    """
    label = shell_of_faces(mesh)
    shells = [part(mesh, label == i) for i in range(label.max() + 1)]
    volumes = [signed_volume(shell) for shell in shells]
    least = _CRUMB * max(volumes)
    crumbs = [shell for shell, volume in zip(shells, volumes, strict=True) if 0 < volume < least]
    dropped = [
        shell in crumbs or (volume < 0 and any(encloses(crumb, shell) for crumb in crumbs))
        for shell, volume in zip(shells, volumes, strict=True)
    ]
    if not crumbs:
        return mesh, ()
    kept = part(mesh, ~np.array(dropped)[label])
    lost = 1e6 * sum(signed_volume(crumb) for crumb in crumbs)
    many = "a crumb" if len(crumbs) == 1 else f"{len(crumbs)} crumbs"
    return kept, (f"dropped {many} beside the object, {lost:.2g} cm^3",)


def orient(mesh: trimesh.Trimesh) -> tuple[str, ...]:
    """Makes the winding consistent and outward; a shell inside another one faces its cavity."""
    notes: list[str] = []
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        notes.append("winding made consistent")
    label = shell_of_faces(mesh)
    shells = [part(mesh, label == i) for i in range(label.max() + 1)]
    turned = [
        (signed_volume(shell) < 0)
        != bool(sum(encloses(o, shell) for o in shells if o is not shell) % 2)
        for shell in shells
    ]
    if any(turned):
        faces = mesh.faces.copy()
        flip = np.array(turned)[label]
        faces[flip] = faces[flip][:, ::-1]
        mesh.faces = faces
        notes.append("normals turned outward")
    return tuple(notes)


def shell_of_faces(mesh: trimesh.Trimesh) -> Indices:
    """The connected surface that each face belongs to, counted from 0."""
    label = trimesh.graph.connected_component_labels(mesh.face_adjacency, len(mesh.faces))
    return np.asarray(label, dtype=np.int64)


def part(mesh: trimesh.Trimesh, member: Mask) -> trimesh.Trimesh:
    """Some faces of a mesh, with the vertices that they need."""
    chosen = trimesh.Trimesh(mesh.vertices, mesh.faces[member], process=False)
    chosen.remove_unreferenced_vertices()
    return chosen


def signed_volume(mesh: trimesh.Trimesh) -> float:
    """Volume that a closed surface encloses [m^3]; negative if its normals point inward."""
    a, b, c = (mesh.triangles[:, i] - mesh.bounds[0] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def encloses(outer: trimesh.Trimesh, inner: trimesh.Trimesh) -> bool:
    """Whether one closed surface lies inside another (tested at up to 16 of its vertices)."""
    if (inner.bounds[0] < outer.bounds[0]).any() or (inner.bounds[1] > outer.bounds[1]).any():
        return False
    points = inner.vertices[:: -(-len(inner.vertices) // 16)]
    return all(_winding_number(outer.triangles - point) > 0.5 for point in points)


def _winding_number(triangles: Array) -> float:
    """Absolute winding number of a closed surface about the origin (van Oosterom, Strackee 1983).

    Args:
        triangles: Corners, shape (m, 3, 3).
    """
    a, b, c = (triangles[:, i] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", v, w) for v, w in ((a, b), (b, c), (c, a)))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    solid_angle = 2.0 * np.arctan2(numerator, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(abs(solid_angle.sum())) / (4.0 * np.pi)
