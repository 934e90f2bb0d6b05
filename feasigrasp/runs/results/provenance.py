"""Provenance of a result: versions, revision, machine."""

import hashlib
import importlib.util
import os
import platform
import subprocess
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from feasigrasp.errors import MeshError
from feasigrasp.models.objects.rigid_object import builtin_objects, object_file
from feasigrasp.scenario.schema import Scenario


def own_files(scenario: Scenario) -> dict[str, str]:
    """SHA-256 of every file that a run depends on and that is not the package's.

    Returns:
        By what it is for: ``object`` and ``distractor`` (their meshes), ``arm``, ``gripper``,
        ``directives[0]`` and ``cell.meshes.NAME``, ``parts.sampler`` and so on (what the file
        names or imports is not looked at). One that is not there is left out.
    """
    files = {"object": _mesh(scenario.object.model), "gripper": Path(scenario.gripper)}
    files |= {"distractor": _mesh(scenario.distractor.model), "arm": Path(scenario.arm)}
    for i, directive in enumerate(scenario.directives):
        if named := directive.add_model or directive.add_directives:
            files[f"directives[{i}]"] = Path(named.file.removeprefix("file://"))
    for name, mesh in scenario.cell.meshes.items():
        files[f"cell.meshes.{name}"] = Path(mesh.file)
    for key, part in scenario.parts.items():
        files[f"parts.{key}"] = _module(part.name.partition(":")[0])
    states = {key: file.stat() for key, file in files.items() if file.is_file()}
    return {key: _digest(files[key], s.st_mtime_ns, s.st_size) for key, s in states.items()}


def _mesh(model: str) -> Path:
    with suppress(MeshError):
        return Path() if model in builtin_objects() else object_file(model)
    return Path()


def _module(name: str) -> Path:
    with suppress(ImportError, ValueError):
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.origin:
            return Path(spec.origin)
    return Path()


@cache
def _digest(file: Path, *_state: int) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide a result."""
    found = {"python": platform.python_version()}
    for package in ("feasigrasp", "drake", "numpy", "scipy", "numba", "torch"):
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


@cache
def git_revision() -> str | None:
    """Revision of the checkout that the package runs from, ``-dirty`` if changed; None outside.

    It is the one of the first call: the code that runs does not change with the files.
    """
    root = Path(__file__).resolve().parents[3]
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    # An installed package may lie below somebody else's repository: that one says nothing.
    return described.stdout.strip() if (root / ".git").exists() else None


def machine() -> dict[str, Any]:
    """The processor count and name of the system."""
    return {"cpus": os.cpu_count(), "system": platform.platform()}
