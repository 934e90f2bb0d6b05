"""Plugins: entry points of the groups ``feasigrasp.<kind>``.

A package adds a controller by two lines of its ``pyproject.toml``::

    [project.entry-points."feasigrasp.controllers"]
    mine = "my_package.controller:make_controller"

Kinds, each with what an entry point of it is:

- ``commands``: a function that returns `feasigrasp.cli.Commands`.
- ``controllers``: a function ``(scenario, reachability, safety) -> GraspController``.
- ``drivers``: a function ``(lcm_url) -> feasigrasp.systems.hardware.bridge.Driver``.
- ``fields``: a function ``(cloud, length_scale=, noise_variance=, max_points=) ->
  feasigrasp.models.shape.gpdf.Gpdf``; ``noise_variance`` may be None.
- ``judges``: a function ``(scenario, reachability) -> LeafSystem``, a system with the ports of
  `feasigrasp.systems.reachability_filter.ReachabilityFilter`.
- ``modes``: an object as `feasigrasp.scenario.modes.Mode`.
- ``samplers``: a function ``(gripper, n_candidates=, n_grasps=, least_score=, seed=)``.

Their settings are ``control.options`` and ``reachability.options`` of the scenario.
"""

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
