"""Closed triangle meshes: reading, repair, decimation, cache on disk, writing.

Everything that makes a mesh file from somewhere into the surface of one solid body, and every
reason why it cannot be one, is in this file.
"""

import hashlib
import json
import os
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from manifold3d import Error, Manifold, Mesh64
from numpy.typing import NDArray
from tqdm import tqdm

from feasigrasp.errors import FeasigraspError, MeshError, needed_by
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arrays import Array, Indices
from feasigrasp.outputs import replacing

#: Files from this size on are kept [bytes]; 1 MB is about 20 000 faces. Source: reasoned.
LARGE = 4_000_000
#: Another number when what is made of a mesh changes. Source: layout.
_VERSION = 2
#: Faces beyond this number slow contact down without changing a grasp. Source: guessed.
MAX_FACES = 4000
_UNITED, _TURNED = "united bodies that touch or overlap", "normals turned outward"

#: A mesh, and a sentence for everything that had to be repaired or was reduced.
Solid = tuple[trimesh.Trimesh, tuple[str, ...]]


def read_reduced(path: Path, scale: float) -> Solid:
    """As `read_solid`, with `MAX_FACES` faces at most; kept on disk if the file is `LARGE`.

    It is kept in ``$XDG_CACHE_HOME/feasigrasp``, by default ``~/.cache/feasigrasp``, if that can be
    written to; a file there that is broken is made anew.
    """
    if not path.is_file() or path.stat().st_size < LARGE:
        return _reduced(path, scale)
    with path.open("rb") as content:
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    key = hashlib.sha256(f"{digest} {scale!r} {MAX_FACES} {_VERSION}".encode()).hexdigest()
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    file = home / "feasigrasp" / f"{key[:32]}.npz"
    try:
        stored = read_arrays(file)
        mesh = trimesh.Trimesh(stored["vertices"], stored["faces"], process=False)
        return mesh, tuple(json.loads(str(stored["notes"])))
    except (FeasigraspError, KeyError, ValueError):
        mesh, notes = _reduced(path, scale)
    try:
        with replacing(file) as target:
            text = np.array(json.dumps(notes))
            np.savez(target, vertices=mesh.vertices, faces=mesh.faces, notes=text)
    except FeasigraspError:
        pass  # it is only quicker with it
    return mesh, notes


def _reduced(path: Path, scale: float) -> Solid:
    solid, repairs = read_solid(path, scale)
    mesh, reduction = decimate(solid, MAX_FACES)
    return mesh, repairs + reduction


def read_solid(path: Path, scale: float = 1.0) -> Solid:
    """Reads the surface of one solid body from a mesh file.

    Vertices are merged by position (normals and texture seams are dropped), the winding is made
    consistent and outward, and the result is checked. A closed surface inside another one is the
    wall of a cavity if it is wound against it, and else a solid core, which is dropped; bodies that
    touch or overlap are united; what floats apart and has less than 1 % of the volume is dropped.
    Not checked: whether one body's surface cuts through itself.

    Args:
        path: Any mesh file that trimesh reads.
        scale: Factor from the units of the file to metres.

    Returns:
        The mesh in its own frame M [m], and a sentence for everything that had to be repaired.

    Raises:
        MeshError: If the file is missing or unreadable, has no faces, NaN, open edges, no volume,
            several bodies apart, or a size outside 5 mm to 1 m.
    """
    large = path.is_file() and path.stat().st_size >= LARGE
    with tqdm(total=3, desc=f"reading {path.name}", unit="step", disable=not large) as bar:
        mesh = read_surface(path, scale)
        bar.update()
        _check_extent(mesh, path, scale)
        bar.update()
        mesh, notes = _one_solid(mesh, path)
        bar.update()
    return mesh, notes


def decimate(mesh: trimesh.Trimesh, max_faces: int) -> Solid:
    """Reduces a closed mesh by quadric edge collapse, if it has more than ``max_faces`` faces.

    Returns:
        A closed mesh, and what was done. If the collapse tears the surface, splits it or changes
        its volume by more than 2 %, the original comes back, and the note says so.
    """
    if len(mesh.faces) <= max_faces:
        return mesh, ()
    with needed_by(f"reducing a mesh of {len(mesh.faces)} faces to {max_faces}"):
        import open3d as o3d  # a slow import that most objects never need

    # Faces from which on decimation takes long enough to be announced.
    if len(mesh.faces) >= 200_000:
        text = f"decimating {len(mesh.faces)} faces to {max_faces}, a minute per million"
        tqdm.write(text, file=sys.stderr)
    fine = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(mesh.vertices)),
        o3d.utility.Vector3iVector(np.array(mesh.faces)),
    )
    coarse = fine.simplify_quadric_decimation(max_faces)
    result = _clean(np.asarray(coarse.vertices), np.asarray(coarse.triangles))
    was = f"{len(mesh.faces)} faces"
    if not result.is_watertight or not result.is_winding_consistent:
        return mesh, (f"kept all {was}: decimation to {max_faces} tears the surface",)
    if result.body_count != mesh.body_count or abs(result.volume / mesh.volume - 1) > 0.02:
        return mesh, (f"kept all {was}: decimation to {max_faces} changes the shape",)
    return result, (f"decimated from {was} to {len(result.faces)}",)


def decimate_within(mesh: trimesh.Trimesh, tolerance: float) -> trimesh.Trimesh:
    """A closed mesh with fewer faces whose surface stays within a tolerance [m], by edge collapse.

    It is the given mesh where manifold3d does not take that for the surface of a solid.
    """
    fine = _manifold(mesh)
    if fine.status() != Error.NoError:
        return mesh
    # Tolerance that manifold3d is given, as a share of the one that is kept: what several collapses
    # in a row move adds up, to 0.73 times the tolerance on the built-in objects with this share.
    return _trimesh(fine.simplify(0.5 * tolerance))


def obj_text(mesh: trimesh.Trimesh) -> str:
    """An OBJ with vertex normals, which Drake's RenderEngineVtk needs to draw it.

    Vertices stay shared, so the file is as watertight as the mesh; a vertex on a crease sharper
    than 40 degrees carries one normal per side (``f v//n``).
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    normals, corners = _crease_normals(vertices, faces)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices + 0.0]
    lines += [f"vn {x:.3f} {y:.3f} {z:.3f}" for x, y, z in normals]
    lines += [
        "f " + " ".join(f"{v + 1}//{n + 1}" for v, n in zip(face, corner, strict=True))
        for face, corner in zip(faces, corners, strict=True)
    ]
    return "\n".join(lines) + "\n"


def _clean(vertices: Array, faces: NDArray[Any]) -> trimesh.Trimesh:
    """Merges vertices by position and drops faces that collapse to an edge by that."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    f = mesh.faces
    mesh.update_faces((f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0]))
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def read_surface(path: Path, scale: float) -> trimesh.Trimesh:
    """Reads the surface of a mesh file, open or closed, of one body or several; see `read_solid`.

    Raises:
        MeshError: If the file is missing or unreadable, or has no faces or NaN.
    """
    if not path.is_file():
        what = "a folder" if path.is_dir() else "no such file"
        raise MeshError(f"{path}: {what}; give the path of a mesh (obj, ply, stl, off, glb).")
    try:
        raw: Any = trimesh.load_mesh(path, process=False)
        vertices, faces = np.array(raw.vertices, dtype=float), np.array(raw.faces)
    except Exception as error:  # trimesh's readers raise whatever they stumble over
        raise MeshError(
            f"{path}: not readable as a triangle mesh ({type(error).__name__}: {error}); "
            "install what it needs, or export it as OBJ, PLY or STL."
        ) from error
    if not len(faces):
        raise MeshError(f"{path}: no faces, at most points; give a surface mesh.")
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices)).any(axis=1).sum())
        raise MeshError(f"{path}: {bad} vertices are NaN or infinite; export the mesh again.")
    mesh = _clean(vertices, faces)
    if not len(mesh.faces):
        raise MeshError(f"{path}: all {len(faces)} faces have no area; give a solid in its units.")
    mesh.apply_scale(scale)
    return mesh


def _check_extent(mesh: trimesh.Trimesh, path: Path, scale: float) -> None:
    # Largest side of a body that an arm of this size can have to do with [m].
    min_extent, max_extent = 0.005, 1.0
    extent = float(mesh.extents.max())
    if min_extent <= extent <= max_extent:
        return
    units = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "metres": 1.0}
    fits = [
        f"scale={value} ({unit})"
        for unit, value in units.items()
        if 0.02 <= extent / scale * value <= 0.5
    ]
    mend = " or ".join(fits) or f"scale={scale * 0.1 / extent:.2g} (largest side 0.1 m)"
    raise MeshError(
        f"{path}: the largest side is {extent:.4g} m with scale={scale:g}, outside "
        f"[{min_extent}, {max_extent}] m; the file is probably not in metres. Try {mend}; "
        "a scenario, or a text on top of one, gives it as object: {scale: ...}."
    )


def _check_closed(mesh: trimesh.Trimesh, path: Path) -> None:
    _, faces_per_edge = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    open_edges = int((faces_per_edge == 1).sum())
    crowded = int((faces_per_edge > 2).sum())
    if not open_edges and not crowded:
        return
    raise MeshError(
        f"{path}: not watertight, {open_edges} open edges and {crowded} edges shared by more than "
        f"two faces (of {len(faces_per_edge)}); mass and inside are undefined. Close it, e.g. "
        "MeshLab 'Close Holes' / 'Repair non Manifold Edges', Blender's voxel remesh, or "
        "trimesh.repair.fill_holes."
    )


def _one_solid(mesh: trimesh.Trimesh, path: Path) -> Solid:
    """The solid that closed shells, connected surfaces, enclose, and what had to be repaired.

    Raises:
        MeshError: A shell is open, there are several bodies apart, or there is no volume.
    """
    shells = list(mesh.split(only_watertight=False))
    notes: list[str] = []
    if len(shells) > 1 and not all(shell.is_watertight for shell in shells):
        mesh, notes = _without_wall(mesh)
        shells = [mesh]
    _check_closed(mesh, path)
    if not mesh.is_winding_consistent:
        notes.append("winding made consistent")
        for shell in (mesh, *shells):
            trimesh.repair.fix_winding(shell)
    if len(shells) == 1:  # vertices and faces stay in the order of the file
        volumes = [abs(_volume(mesh))]
        if _volume(mesh) < 0:
            mesh.invert()
            notes.append(_TURNED)
    else:
        mesh, volumes = _joined(shells, notes)
    if len(volumes) > 1:
        listed = ", ".join(f"{v * 1e6:.3g}" for v in sorted(volumes, reverse=True)[:5])
        raise MeshError(
            f"{path}: {len(volumes)} separate bodies ({listed} cm^3) that do not touch; a rigid "
            "object is one closed surface. Export one body per file, or join them."
        )
    if sum(volumes) < 1e-7 * float(mesh.extents.max()) ** 3:
        raise MeshError(f"{path}: encloses no volume; give a solid, not a sheet folded on itself.")
    return mesh, tuple(notes)


def _joined(shells: list[trimesh.Trimesh], notes: list[str]) -> tuple[trimesh.Trimesh, list[float]]:
    """What closed shells enclose, and the volumes of its bodies [m^3]; adds to the notes.

    By volume, largest first, a shell inside the others is the wall of a cavity, or the surface of a
    solid core if it is wound like the largest; one that meets them is united with them, and a crumb
    apart is dropped.
    """
    # Bodies with less than this share of the largest one's volume are crumbs of a scan; a shell of
    # which more than this share is in another body is inside it.
    crumb, inside = 0.01, 0.999
    whole, crumbs, lost, cores = Manifold(), Manifold(), [], 0
    bodies: list[float] = []
    shells = sorted(shells, key=lambda shell: -abs(_volume(shell)))
    turned = inside_out = _volume(shells[0]) < 0
    for shell in shells:
        inward, volume = _volume(shell) < 0, abs(_volume(shell))
        if inward:
            shell.invert()
        solid = _manifold(shell)
        within, in_crumb = ((other ^ solid).volume() > inside * volume for other in (whole, crumbs))
        hollow = within and inward != inside_out
        if within and not hollow:
            cores += 1
            continue
        turned |= inward and not (hollow or in_crumb)
        joined = whole - solid if hollow else whole + solid
        found = [part.volume() for part in joined.decompose() if part.volume() > 0.0]
        apart = len(found) > len(bodies)
        if in_crumb or (apart and bodies and volume < crumb * abs(_volume(shells[0]))):
            crumbs += solid
            lost += [] if in_crumb else [volume]
            continue
        if not (apart or hollow or _UNITED in notes):
            notes.append(_UNITED)
        whole, bodies = joined, found
    if turned:
        notes.append(_TURNED)
    if cores:
        many = "a solid core" if cores == 1 else f"{cores} solid cores"
        notes.append(f"dropped {many} inside the object; the wall of a cavity is wound against it")
    if lost:
        many = "a crumb" if len(lost) == 1 else f"{len(lost)} crumbs"
        notes.append(f"dropped {many} beside the object, {1e6 * sum(lost):.2g} cm^3")
    return _trimesh(whole), bodies


def _without_wall(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, list[str]]:
    """Drops the wall between two bodies that share a face, whose rims have been merged by then.

    It is one sheet, or one of either body; of what is closed without them, the wall is that whose
    loss leaves the most volume.
    """
    label = trimesh.graph.connected_component_labels(mesh.face_adjacency, len(mesh.faces))
    # Of a mesh in more sheets than ten no wall is looked for among the others: it is torn; guessed.
    sheets, closed = range(min(label.max() + 1, 10)), []
    for wall in (*combinations(sheets, 1), *combinations(sheets, 2)):
        rest = trimesh.Trimesh(mesh.vertices, mesh.faces[~np.isin(label, wall)], process=False)
        rest.remove_unreferenced_vertices()
        if len(rest.faces) and rest.is_watertight:
            trimesh.repair.fix_winding(rest)
            closed.append((abs(_volume(rest)), wall, rest))
    return (max(closed)[2], [_UNITED]) if closed else (mesh, [])


def _volume(mesh: trimesh.Trimesh) -> float:
    """Volume that a closed surface encloses [m^3]; negative if its normals point inward."""
    a, b, c = (mesh.triangles[:, i] - mesh.bounds[0] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def _manifold(mesh: trimesh.Trimesh) -> Manifold:
    return Manifold(Mesh64(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.uint64)))


def _trimesh(solid: Manifold) -> trimesh.Trimesh:
    """The mesh of a solid; copies, since views of its arrays would keep manifold3d's mesh alive."""
    mesh = solid.to_mesh64()
    vertices, faces = mesh.vert_properties[:, :3].copy(), mesh.tri_verts.astype(np.int64)
    return trimesh.Trimesh(vertices, faces, process=False)


def _crease_normals(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Normals (k, 3), and the index of the normal of every corner of every face (m, 3).

    Angle-weighted vertex normals, shared only by the corners on one side of a crease.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    # Edges sharper than this stay sharp in the shading [rad].
    smooth = mesh.face_adjacency_angles < np.radians(40.0)
    # A node per corner; corners of two smoothly joined faces at a common vertex are one.
    pairs = np.repeat(mesh.face_adjacency[smooth], 2, axis=0)
    common = mesh.face_adjacency_edges[smooth].reshape(-1, 1, 1)
    links = 3 * pairs + np.argmax(faces[pairs] == common, axis=2)
    label = trimesh.graph.connected_component_labels(links, faces.size)
    weighted = (mesh.face_normals[:, None] * mesh.face_angles[..., None]).reshape(-1, 3)
    normals = np.zeros((label.max() + 1, 3))
    np.add.at(normals, label, weighted)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-300
    rounded, index = np.unique(np.round(normals, 3) + 0.0, axis=0, return_inverse=True)
    return rounded, index.reshape(-1)[label].reshape(faces.shape)
