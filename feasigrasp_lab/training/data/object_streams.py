"""Streams of training objects: procedural shapes or mesh files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from feasigrasp.errors import InputError, MeshError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.objects.rigid_object import (
    DEFAULT_DENSITY,
    RigidObject,
    find_objects,
    load_object,
)
from feasigrasp_lab.training.data.household_shapes import (
    HELD_OUT,
    make_shape,
    shape_of,
)

#: One object of our own stream in so many is of a family that is held out.
HELD_OUT_EVERY = 8


@dataclass(frozen=True, eq=False)
class StreamedObject:
    """One object of a stream.

    Attributes:
        obj: The object.
        family: What it is.
        seed: Its seed, or its number in a finite stream.
    """

    obj: RigidObject
    family: str
    seed: int


@dataclass(frozen=True)
class ObjectStream:
    """A numbered stream of objects; picklable, so that processes can share it.

    Attributes:
        kind: ``shape`` (household shapes, endless) or ``mesh``.
        path: For ``mesh``, a folder of closed meshes [m] or one npz file with ``vertices``,
            ``faces``, ``vertex_offsets`` and ``face_offsets``.
        seed: Of the shapes.
    """

    kind: str = "shape"
    path: Path | None = None
    seed: int = 0

    def __len__(self) -> int:
        """Number of objects; of an endless stream the largest number there is."""
        return 2**31 - 1 if self.path is None else len(_entries(self.path))

    def __getitem__(self, index: int) -> StreamedObject:
        """The ``index``-th object.

        Raises:
            IndexError: Past the end of a finite stream.
            MeshError: It cannot be read.
        """
        if self.path is None:
            return _shape(index, self.seed)
        entry = _entries(self.path)[index]
        obj = _from_npz(entry, index) if entry.suffix == ".npz" else load_object(entry)
        return StreamedObject(obj, "mesh", index)


def _shape(index: int, seed: int) -> StreamedObject:
    held, place = divmod(index, HELD_OUT_EVERY)
    of_held = place == HELD_OUT_EVERY - 1
    family, number = shape_of(*((held, seed, HELD_OUT) if of_held else (index - held, seed)))
    return StreamedObject(make_shape(family, number), family, number)


@cache
def _entries(path: Path) -> list[Path]:
    """The files of a finite stream, in order; one with several objects is there for each."""
    if path.suffix == ".npz":
        return [path] * (len(_npz(path)["vertex_offsets"]) - 1)
    return list(find_objects(path).values())


@cache
def _npz(path: Path) -> dict[str, np.ndarray]:
    try:
        content = read_arrays(path)
        names = ("vertices", "faces", "vertex_offsets", "face_offsets")
        return {name: content[name] for name in names}
    except (InputError, KeyError) as error:
        raise MeshError(
            f"{path}: {error}; give an npz file with vertices, faces and their offsets"
        ) from error


def _from_npz(path: Path, index: int) -> RigidObject:
    content = _npz(path)
    v0, v1 = content["vertex_offsets"][index : index + 2]
    f0, f1 = content["face_offsets"][index : index + 2]
    faces = content["faces"][f0:f1].astype(np.int64)
    mesh = trimesh.Trimesh(content["vertices"][v0:v1].astype(float), faces)
    mesh.fix_normals()
    return RigidObject.of_mesh(f"mesh_{index}", mesh, DEFAULT_DENSITY * float(mesh.volume))
