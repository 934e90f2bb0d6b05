"""Another hand in a cell: its model in place of the packaged one, and its camera where it sits."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from pydrake.common.schema import Transform
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    FlattenModelDirectives,
    ModelDirective,
    ModelDirectives,
    PackageMap,
)

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.grippers import PACKAGED, load_gripper
from feasigrasp.models.robot.hand_model import camera_pose, hand_files
from feasigrasp.resources import model_path
from feasigrasp.scenario.schema import Scenario


def cell_directives(scenario: Scenario) -> list[ModelDirective]:
    """The directives of a scenario's cell, with the hand that ``gripper`` names.

    The packaged hand is the one that the directives have. For any other the file of the model
    ``gripper`` is one made of its description (`hand_urdf`), and the weld of
    ``camera::camera_body`` is where the description has the camera.
    """
    if scenario.gripper == PACKAGED:
        return scenario.directives
    gripper, packages = load_gripper(scenario.gripper), PackageMap()
    packages.AddPackageXml(str(model_path("package.xml")))
    given = ModelDirectives(directives=scenario.directives)
    directives: list[ModelDirective] = FlattenModelDirectives(given, packages).directives
    for each in directives:
        if each.add_model is not None and each.add_model.name == "gripper":
            each.add_model.file = hand_urdf(gripper).as_uri()
        if each.add_weld is not None and each.add_weld.child == "camera::camera_body":
            each.add_weld.X_PC = Transform(RigidTransform(camera_pose(gripper)))
    return directives


def hand_urdf(gripper: ParallelGripper) -> Path:
    """A URDF file of a hand, made of its description; it lasts as long as the process."""
    return Path(_written(tuple(hand_files(gripper).items())).name) / "gripper.urdf"


@cache
def _written(files: tuple[tuple[str, str], ...]) -> tempfile.TemporaryDirectory[str]:
    folder = tempfile.TemporaryDirectory(prefix="feasigrasp-hand-")
    for name, text in files:
        (Path(folder.name) / name).write_text(text)
    return folder
