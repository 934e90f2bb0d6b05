"""A rigid object to grasp: its surface, mass and inertia, built in or from any mesh file."""

from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
import trimesh

from feasigrasp.errors import InputError, MeshError
from feasigrasp.inputs import read_json
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.choices import nearest
from feasigrasp.models.objects.mesh import Solid, decimate_within, obj_text, read_reduced
from feasigrasp.models.quantities import POINT, ArrayOf, Number, Positive, Share
from feasigrasp.outputs import write_text
from feasigrasp.resources import model_path

#: Used when neither a mass nor a density is known: a hollow household object [kg/m^3]. Source:
#: guessed.
DEFAULT_DENSITY = 300.0
#: Colour of an object without one. Source: layout.
_DEFAULT_COLOR = (0.65, 0.65, 0.68, 1.0)
_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".3mf")


@dataclass(frozen=True, eq=False)
class RigidObject(Frozen):
    """A rigid body with a closed surface and uniform density.

    The object frame O has the axes of the mesh frame M of the file and its origin at the centre
    of mass: ``X_MO = (I, p_MO)``. (YCB meshes, for example, are not centred in their files.)
    Everything downstream of perception lives in O. The arrays are read-only.

    Attributes:
        name: What the object is called.
        vertices: Surface vertices in O, shape (n, 3) [m].
        faces: Vertex indices, counter-clockwise seen from outside, shape (m, 3).
        mass: Mass [kg].
        p_MO: Centre of mass in the (scaled) mesh frame M, shape (3,) [m].
        inertia: Rotational inertia about the centre of mass, in O, shape (3, 3) [kg m^2].
        color: Red, green, blue, alpha in [0, 1].
        material: How its surface looks to a stereo camera: matt, dark, shiny or transparent.
        notes: What the loader had to repair or could not do, one sentence each.
    """

    name: str
    vertices: Annotated[Array, ArrayOf(("n", 3), "m")]
    faces: Annotated[Indices, ArrayOf(("m", 3), dtype=np.int64)]
    mass: Positive
    p_MO: Annotated[Array, POINT]
    inertia: Annotated[Array, ArrayOf((3, 3), "kg m^2")]
    color: tuple[Share, Share, Share, Share] = _DEFAULT_COLOR
    material: str = "matt"
    notes: tuple[str, ...] = ()

    @classmethod
    @checked(MeshError)
    def of_mesh(cls, name: str, mesh: trimesh.Trimesh, mass: Positive, **about: Any) -> Self:
        """A closed mesh [m] of uniform density; ``about`` is its color, material and notes."""
        unit = mesh.mass_properties  # of density 1
        p_MO = np.asarray(unit.center_mass)
        inertia = np.asarray(unit.inertia) * mass / float(unit.volume)
        return cls(name, mesh.vertices - p_MO, mesh.faces, mass, p_MO, inertia, **about)

    def __post_init__(self) -> None:
        """Freezes the arrays; raises MeshError for a wrong one, or faces that name no vertex."""
        check_fields(self, MeshError)
        if self.faces.size and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise MeshError(
                f"RigidObject.faces names vertices outside 0 ... {len(self.vertices) - 1}"
            )
        names = ("vertices", "faces", "p_MO", "inertia")
        self._freeze(**{name: getattr(self, name).copy() for name in names})

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The surface in O as a new trimesh object."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    @property
    def extents(self) -> Array:
        """Sides of the axis-aligned bounding box, shape (3,) [m]."""
        return np.asarray(np.ptp(self.vertices, axis=0))


@dataclass(frozen=True)
class _Entry:
    """What a catalogue says of an object; of a mesh alone, what is usual."""

    name: str
    mesh: str = ""
    mass_kg: Annotated[float, Number(0.001, 20.0)] | None = None
    color: tuple[Share, Share, Share, Share] = _DEFAULT_COLOR
    material: str = RigidObject.material

    @classmethod
    def of(cls, file: Path, entry: dict[str, Any]) -> Self:
        """An entry of a file; keys for people, such as a description, are passed over."""
        names = [field.name for field in fields(cls)]
        try:
            for key in entry.keys() - names:
                if hint := nearest(key, set(names) - entry.keys()):
                    raise MeshError(f"it has no key {key!r}{hint}")
            listed = cls(**{key: entry[key] for key in names if key in entry})
            check_fields(listed, MeshError)
        except MeshError as error:
            raise MeshError(f"{file}: object {entry['name']!r}: {error}") from None
        return listed


def builtin_objects() -> list[str]:
    """Names of the objects that come with the project, sorted."""
    return sorted(_read_catalogue(model_path("objects")))


@checked(MeshError)
def load_object(
    name_or_path: str | Path,
    *,
    scale: Positive = 1.0,
    density: Positive | None = None,
    mass: Positive | None = None,
) -> RigidObject:
    """Loads a built-in object or any closed mesh file.

    The mass is, in this order: ``mass``; ``density`` times volume; the mass that a catalogue
    beside the file gives (times ``scale`` cubed); 300 kg/m^3 times volume. A catalogue is a JSON
    file in the mesh's folder or its parent with ``{"objects": [{"name", "mesh", "mass_kg"}]}``, as
    in ``models/objects`` and in the YCB layout; its masses belong to meshes in metres. Meshes of
    more than 4000 faces are decimated; what is made of a file of 4 MB or more is kept on disk (see
    `read_reduced`) and made with a progress bar.

    Args:
        name_or_path: One of `builtin_objects()`, a mesh file, or ``folder/name`` for an entry of
            a folder's catalogue.
        scale: Factor from the units of the file to metres (0.001 for a file in millimetres).
        density: Density [kg/m^3].
        mass: Mass [kg].

    Returns:
        The object; what was repaired on the way is in its ``notes``.

    Raises:
        MeshError: If there is no such object, or its mesh is not one closed solid of a graspable
            order of size, or mass or density is not positive.
    """
    path, entry = _resolve(name_or_path)
    if mass is not None and density is not None:
        raise MeshError(f"{path}: both mass={mass} and density={density} given; give one of them.")
    state = path.stat() if path.is_file() else None
    mesh, notes = _read_once(path, scale, state and (state.st_mtime_ns, state.st_size))
    if mass is None and density is None and entry.mass_kg is not None:
        mass = float(entry.mass_kg) * scale**3
    return RigidObject.of_mesh(
        entry.name,
        mesh,
        mass if mass is not None else (density or DEFAULT_DENSITY) * float(mesh.volume),
        color=tuple(entry.color),
        material=entry.material,
        notes=notes,
    )


@lru_cache(maxsize=64)
def _read_once(path: Path, scale: float, state: tuple[int, int] | None) -> Solid:
    """The solid of a file that stays as it is; every diagram asks for its object several times."""
    return read_reduced(path, scale)


def find_objects(directory: str | Path) -> dict[str, Path]:
    """Names and mesh files of the objects of a folder, in the order of their names.

    It has a catalogue (the YCB layout, see `load_object`) or mesh files.

    Raises:
        MeshError: If the folder is missing or holds no meshes.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise MeshError(f"{directory}: no such folder; give a folder of meshes.")
    entries = _read_catalogue(directory)
    if entries:
        return {name: directory / entry.mesh for name, entry in sorted(entries.items())}
    paths = sorted(p for p in directory.iterdir() if p.suffix.lower() in _SUFFIXES)
    if not paths:
        raise MeshError(
            f"{directory}: no mesh files ({', '.join(_SUFFIXES)}) and no catalogue in it; "
            "give a folder of meshes."
        )
    return {path.stem: path for path in paths}


def write_mesh(obj: RigidObject, path: str | Path, *, tolerance: float | None = None) -> None:
    """Writes the surface in frame O (origin at the centre of mass) as OBJ with vertex normals.

    With a tolerance [m] it has fewer faces, as far as the surface stays that near.
    """
    vertices = np.asarray(obj.vertices, dtype=float).tobytes()
    write_text(path, _obj_text(vertices, np.asarray(obj.faces, dtype=int).tobytes(), tolerance))


@lru_cache(maxsize=32)
def _obj_text(vertices: bytes, faces: bytes, tolerance: float | None) -> str:
    """Kept, since one diagram has its object twice, and a process may make many diagrams."""
    mesh = trimesh.Trimesh(
        np.frombuffer(vertices).reshape(-1, 3),
        np.frombuffer(faces, dtype=int).reshape(-1, 3),
        process=False,
    )
    return obj_text(mesh if tolerance is None else decimate_within(mesh, tolerance))


def object_file(name_or_path: str | Path) -> Path:
    """The mesh file of an object as `load_object` takes it; raises MeshError without one."""
    return _resolve(name_or_path)[0]


def _resolve(name_or_path: str | Path) -> tuple[Path, _Entry]:
    """The mesh file, and what a catalogue says about it (possibly nothing)."""
    name, path = str(name_or_path), Path(name_or_path)
    built_in = _read_catalogue(model_path("objects"))
    if name in built_in:
        return model_path("objects", built_in[name].mesh), built_in[name]
    if path.suffix.lower() in _SUFFIXES or path.is_file():
        for folder in (path.parent, path.parent.parent):
            for entry in _read_catalogue(folder).values():
                if (folder / entry.mesh).resolve() == path.resolve():
                    return path, entry
        return path, _Entry(path.stem)
    listed = _read_catalogue(path.parent) if path.parent != Path() else {}
    if path.name in listed:
        return path.parent / listed[path.name].mesh, listed[path.name]
    what = "a folder" if path.is_dir() else "neither a built-in object nor a mesh file"
    raise MeshError(
        f"'{name}' is {what}. Built in: {', '.join(sorted(built_in))}. Or give the path of a mesh "
        f"({', '.join(_SUFFIXES)}), or FOLDER/NAME with a NAME of FOLDER/objects.json."
    )


def _read_catalogue(folder: Path) -> dict[str, _Entry]:
    """Entries by name of the first JSON file of a folder that lists meshes; none if none does."""
    for file in sorted(folder.glob("*.json")):
        wrong = 'give {"objects": [{"name": "mine", "mesh": "mine.obj", "mass_kg": 0.3}]}'
        try:
            content = read_json(file)
        except InputError as error:
            content, wrong = None, str(error)
        listed = content.get("objects") if isinstance(content, dict) else None
        keys = {"name", "mesh"}
        if isinstance(listed, list) and all(isinstance(e, dict) and keys <= set(e) for e in listed):
            names = [str(entry["name"]) for entry in listed]
            if twice := [name for name in names if names.count(name) > 1]:
                raise MeshError(f"{file} lists two objects named '{twice[0]}'; rename one")
            return {name: _Entry.of(file, e) for name, e in zip(names, listed, strict=True)}
        if file.name == "objects.json":  # no other file that happens to lie there
            raise MeshError(f"{file} lists no objects: {wrong}")
    return {}
