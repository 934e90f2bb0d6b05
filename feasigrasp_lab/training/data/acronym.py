"""Reads grasps of ACRONYM (Eppner et al. 2021) as training examples.

ACRONYM (Eppner, Mousavian, Fox, "ACRONYM: A Large-Scale Grasp Dataset Based on Simulation", 2021)
has one h5 file per object: 2000 poses of the hand, whether the object stayed in it after shaking in
simulation, and which mesh at which scale they belong to. The data set and the ShapeNet meshes are
to be had from their owners, under their terms; nothing of them comes with this package.

A recorded grasp gives its two contacts once their closing line is cast on the mesh. A point
of a surface is labelled from the successful grasps whose contacts are near. Where none is, none is
known: as usual with this data set, such a point counts as no contact.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from feasigrasp.errors import MeshError
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp_lab.training.data.grasp_labels import (
    N_TURNS,
    ContactPairs,
    PointLabels,
    best_labels,
    on_true_surface,
)
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps

#: Opening of the recorded hand [m], and the depths of its pads in its own frame, tip first [m].
OPENING, PAD_DEPTHS = 0.08, np.linspace(0.110, 0.070, 9)
#: A recorded contact speaks for points this near to it [m].
CONTACT_RADIUS = 0.005
#: Contacts whose faces are flatter to the closing line than this cosine are glancing ones.
_LEAST_COSINE = 0.5


@dataclass(frozen=True, eq=False)
class AcronymObject:
    """One object of ACRONYM with its recorded grasps.

    Attributes:
        obj: The object, its origin at the recorded centre of mass.
        X_OG: Grasp frames, between the contacts where the closing line meets the object and
            between the finger tips elsewhere, shape (n, 4, 4).
        width: Distance between the contacts, shape (n,) [m]; NaN where nothing is between the pads.
        cosine: The lesser cosine between closing line and the normals of the two faces, (n,).
        success: Whether the object stayed in the hand, shape (n,).
        truth: The mesh, ready to be asked.
    """

    obj: RigidObject
    X_OG: Array
    width: Array
    cosine: Array
    success: Mask
    truth: TrueGrasps


def read_acronym(path: Path) -> AcronymObject:
    """Reads an h5 file; its mesh is where ACRONYM's examples have it, beside the file's folder.

    Raises:
        MeshError: If h5py is missing, the file is not one of ACRONYM, or its mesh is not there.
    """
    content = _read(path)
    file = path.parent.parent / content["file"]
    if not file.is_file():
        raise MeshError(f"{path}: its mesh {file} is missing")
    raw: Any = trimesh.load(file, force="mesh", process=False)
    vertices = np.asarray(raw.vertices, dtype=float) * content["scale"] - content["com"]
    if not len(raw.faces) or not np.isfinite(vertices).all():
        raise MeshError(f"{file}: no faces, or NaN among its vertices")
    obj = RigidObject(
        name=path.stem,
        vertices=vertices,
        faces=np.asarray(raw.faces),
        mass=content["mass"],
        p_MO=content["com"],
        inertia=content["inertia"],
    )
    truth = TrueGrasps(obj.mesh)
    X_OG, width, cosine = _on_the_object(truth, content["transforms"], content["com"])
    return AcronymObject(obj, X_OG, width, cosine, content["success"], truth)


def acronym_labels(recorded: AcronymObject, points: Array, normals: Array) -> PointLabels:
    """Labels points of a surface from the recorded grasps that succeeded.

    Args:
        recorded: The object.
        points: Shape (n, 3), in its frame O [m].
        normals: Outward unit normals, shape (n, 3).
    """
    used = recorded.success & np.isfinite(recorded.width) & (recorded.cosine > _LEAST_COSINE)
    X, half = recorded.X_OG[used], 0.5 * recorded.width[used, None]
    # Every grasp starts at either contact: from the other one b points the other way.
    contact = np.concatenate([X[:, :3, 3] - half * X[:, :3, 0], X[:, :3, 3] + half * X[:, :3, 0]])
    closing, approach = np.concatenate([X[:, :3, 0], -X[:, :3, 0]]), np.tile(X[:, :3, 2], (2, 1))
    width = np.tile(recorded.width[used], 2)

    rows, at, outward = on_true_surface(recorded.truth, points, normals)
    near = cKDTree(contact).query_ball_point(at[rows], CONTACT_RADIUS) if len(contact) else []
    labelled, best_of, free = [], [], []
    for row, members in zip(rows, near, strict=False):
        facing = [m for m in members if closing[m] @ outward[row] < 0.0]
        if facing:
            best = min(facing, key=lambda m: float(np.linalg.norm(contact[m] - at[row])))
            labelled.append(row)
            best_of.append(best)
            free.append(_turns(closing[best], approach[best], approach[facing]))
    best_rows = np.array(best_of, dtype=np.int64)
    pairs = ContactPairs(
        point=np.array(labelled, dtype=np.int64),
        contact=contact[best_rows],
        closing=closing[best_rows],
        width=width[best_rows],
        across=approach[best_rows],
        free=np.array(free, dtype=bool).reshape(-1, N_TURNS),
    )
    return best_labels(pairs, len(points))


def _turns(b: Array, across: Array, approaches: Array) -> Mask:
    """Turns about b, from ``across`` on, that are nearest to approach directions (k, 3)."""
    u, v = approaches @ across, approaches @ np.cross(b, across)
    turns = np.zeros(N_TURNS, dtype=bool)
    turns[np.round(np.arctan2(v, u) * N_TURNS / (2 * np.pi)).astype(int) % N_TURNS] = True
    return turns


def _on_the_object(truth: TrueGrasps, X_MH: Array, com: Array) -> tuple[Array, Array, Array]:
    """Grasp frames, widths and cosines of hand poses, at the depth where the pads meet best."""
    X_OG = np.array(X_MH)
    X_OG[:, :3, 3] += PAD_DEPTHS[0] * X_MH[:, :3, 2] - com
    width, cosine = np.full(len(X_OG), np.nan), np.full(len(X_OG), -1.0)
    for depth in PAD_DEPTHS:
        poses = np.array(X_MH)
        poses[:, :3, 3] += depth * X_MH[:, :3, 2] - com
        closed = truth.close(poses, OPENING)
        better = np.isfinite(closed.width) & (closed.cosine > cosine)
        width[better], cosine[better] = closed.width[better], closed.cosine[better]
        X_OG[better] = poses[better]
        X_OG[better, :3, 3] = 0.5 * (closed.first[better] + closed.second[better])
    return X_OG, width, cosine


def _read(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError as error:
        raise MeshError(
            "ACRONYM's files need h5py; install feasigrasp[train] (or h5py>=3.8)"
        ) from error
    if not path.is_file():
        raise MeshError(f"{path}: no such file; give an h5 file of ACRONYM")
    try:
        with h5py.File(path, "r") as file:
            success = np.asarray(file["grasps/qualities/flex/object_in_gripper"][()]) > 0
            name = file["object/file"][()]
            content: dict[str, Any] = {
                "transforms": np.asarray(file["grasps/transforms"][()], dtype=float),
                "success": success,
                "file": name.decode() if isinstance(name, bytes) else str(name),
                "scale": float(file["object/scale"][()]),
                "com": np.asarray(file["object/com"][()], dtype=float),
                "mass": float(file["object/mass"][()]),
                "inertia": np.asarray(file["object/inertia"][()], dtype=float),
            }
    except (OSError, KeyError, ValueError) as error:
        raise MeshError(f"{path} is not an h5 file of ACRONYM: {error}") from error
    if content["transforms"].shape != (len(success), 4, 4):
        raise MeshError(
            f"{path}: {content['transforms'].shape} poses and {len(success)} verdicts; one verdict "
            "per pose (4, 4) is needed"
        )
    return content
