"""Where the paths of a scenario start: at the scenario's file."""

from __future__ import annotations

import copy
from pathlib import Path

from feasigrasp.errors import MeshError, ScenarioError
from feasigrasp.models.objects.rigid_object import builtin_objects, object_file
from feasigrasp.models.robot.grippers import GRIPPERS
from feasigrasp.scenario.schema import Scenario


def with_paths_from(folder: Path, scenario: Scenario) -> Scenario:
    """The scenario with absolute paths, those of the given one starting at a folder.

    Those are the models and directives of ``directives``, and ``file`` of ``cell.meshes``; and
    ``gripper``, ``object.model`` and ``distractor.model`` where the folder has such a file. A name
    of ours, a URI such as ``package://...``, and an absolute path stay what they are.

    Raises:
        ScenarioError: The directives, or the meshes of the cell, name a file that there is not.
    """
    scenario, folder = copy.deepcopy(scenario), folder.resolve()
    for i, directive in enumerate(scenario.directives):
        for key in ("add_model", "add_directives"):
            part = getattr(directive, key)
            if part is not None and part.file and "://" not in part.file:
                file = _existing(folder, part.file, f"directives[{i}].{key}.file")
                part.file = f"file://{file}"
    for name, mesh in scenario.cell.meshes.items():
        if mesh.file:
            mesh.file = str(_existing(folder, mesh.file, f"cell.meshes.{name}.file"))
    if scenario.gripper not in GRIPPERS and (folder / scenario.gripper).is_file():
        scenario.gripper = str(folder / scenario.gripper)
    for body in (scenario.object, scenario.distractor):
        body.model = _object(folder, body.model)
    return scenario


def _existing(folder: Path, file: str, key: str) -> Path:
    path = folder / file
    if not path.is_file():
        raise ScenarioError(f"{key} is {file!r}, but there is no file {path}; correct the path")
    return path


def _object(folder: Path, model: str) -> str:
    """The path of an object if the folder has it, as a mesh or in the catalogue of a folder."""
    if not model or model in builtin_objects():
        return model
    try:
        found = (folder / model).is_file() or (
            "/" in model and object_file(folder / model).is_file()
        )
    except (MeshError, OSError):
        found = False
    return str(folder / model) if found else model
