"""Named parts that installed packages add: entry points of the groups ``feasigrasp.<kind>``.

A package adds a controller by two lines of its ``pyproject.toml``::

    [project.entry-points."feasigrasp.controllers"]
    mine = "my_package.controller:make_controller"

Kinds: ``controllers``, functions ``(scenario, reachability, safety) -> GraspController``;
``samplers``, classes ``(gripper, n_grasps=, least_score=, seed=)``; ``commands``, functions that
return `feasigrasp.cli.Commands`.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from feasigrasp.errors import needed_by


@cache
def plugins(kind: str) -> dict[str, EntryPoint]:
    """Entry points of a kind by name, in alphabetical order; nothing of them is imported."""
    found = entry_points(group=f"feasigrasp.{kind}")
    return {entry.name: entry for entry in sorted(found, key=lambda entry: entry.name)}


def load_plugin(kind: str, name: str) -> Any:
    """Imports what an entry point names.

    Raises:
        KeyError: There is none of that kind and name.
        MissingPackageError: It needs a package that is not installed.
    """
    with needed_by(f"the {kind.removesuffix('s')} {name!r}"):
        return plugins(kind)[name].load()
