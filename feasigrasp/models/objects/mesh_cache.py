"""Disk cache of processed meshes."""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from feasigrasp.errors import FeasigraspError
from feasigrasp.inputs import read_arrays
from feasigrasp.outputs import replacing

#: Files from this size on are kept [bytes]; 1 MB is about 20 000 faces. Source: reasoned.
LARGE = 4_000_000
#: Another number when what is made of a mesh changes. Source: layout.
_VERSION = 2

Solid = tuple[trimesh.Trimesh, tuple[str, ...]]


def kept(path: Path, settings: str, make: Callable[[], Solid]) -> Solid:
    """A mesh and its notes, as ``make`` made them of the same file and settings before.

    Kept in ``$XDG_CACHE_HOME/feasigrasp``, by default ``~/.cache/feasigrasp``, if that can be
    written to; a file there that is broken is made anew, and what is made of a small mesh file is
    not kept.
    """
    if not path.is_file() or path.stat().st_size < LARGE:
        return make()
    with path.open("rb") as content:
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    key = hashlib.sha256(f"{digest} {settings} {_VERSION}".encode()).hexdigest()
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    file = home / "feasigrasp" / f"{key[:32]}.npz"
    try:
        stored = read_arrays(file)
        mesh = trimesh.Trimesh(stored["vertices"], stored["faces"], process=False)
        return mesh, tuple(json.loads(str(stored["notes"])))
    except (FeasigraspError, KeyError, ValueError):
        mesh, notes = make()
    try:
        with replacing(file) as target:
            text = np.array(json.dumps(notes))
            np.savez(target, vertices=mesh.vertices, faces=mesh.faces, notes=text)
    except FeasigraspError:
        pass  # it is only quicker with it
    return mesh, notes
