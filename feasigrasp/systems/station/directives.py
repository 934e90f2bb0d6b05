"""The directives of a scenario's cell: its own, with another hand, table height and obstacles."""

import itertools
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from pydrake.common.schema import Transform
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    AddDirectives,
    AddModel,
    AddWeld,
    FlattenModelDirectives,
    ModelDirective,
    ModelDirectives,
    PackageMap,
)

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import nearest
from feasigrasp.models.objects.static_obstacles import StaticObstacle
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.arm_model import arm_urdf
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.gripper_file import PACKAGED, load_gripper
from feasigrasp.models.robot.hand_model import camera_pose, hand_files
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import model_path
from feasigrasp.scenario.sampling import make_static_obstacles
from feasigrasp.scenario.schema import Scenario


def cell_directives(scenario: Scenario) -> list[ModelDirective]:
    """The directives of a scenario's cell, with its hand, table height and obstacles.

    The packaged hand is the one that the directives have. For any other the file of the model
    ``gripper`` is one made of its description (`hand_urdf`), and the weld of
    ``camera::camera_body`` is where the description has the camera. Each obstacle is a model of
    its own name, welded to the world.

    Raises:
        MeshError: A mesh of the cell cannot be read.
        ScenarioError: The directives have the table at another height than `CellConfig`.
    """
    height, other_hand = scenario.cell.table_height, scenario.gripper != PACKAGED
    arm, flat = load_arm(scenario.arm), _flat(scenario)
    changed = other_hand or height != 0.0 or arm is not IIWA_7
    directives: list[ModelDirective] = flat if changed else scenario.directives
    for each in directives if other_hand else ():
        gripper = load_gripper(scenario.gripper)
        if each.add_model is not None and each.add_model.name == "gripper":
            each.add_model.file = hand_urdf(gripper).as_uri()
        if each.add_weld is not None and each.add_weld.child == "camera::camera_body":
            each.add_weld.X_PC = Transform(RigidTransform(camera_pose(gripper)))
    for each in flat:
        weld = each.add_weld
        if weld is not None and weld.parent == "world" and weld.child.startswith("table::"):
            X_WT = RigidTransform((weld.X_PC or Transform()).GetDeterministicValue())
            x, y, z = X_WT.translation()
            if z not in (0.0, height):
                raise ScenarioError(
                    f"directives weld the table at z = {z:g} m, but cell.table_height is "
                    f"{height:g}; give cell: {{table_height: {z:g}}}"
                )
            if height != 0.0:
                X_WT.set_translation([x, y, height])
                weld.X_PC = Transform(X_WT)
    obstacles = [_obstacle(each) for each in make_static_obstacles(scenario)]
    return [*directives, *itertools.chain(*obstacles)] if obstacles else directives


def modeled_bodies(scenario: Scenario) -> list[str]:
    """Models of a scenario's directives that the controller is given, beside robot and table.

    Raises:
        ScenarioError: `CellConfig.unmodeled` has another name.
    """
    known = (load_arm(scenario.arm).name, "gripper", "camera", "table")
    names = [each.add_model.name for each in _flat(scenario) if each.add_model is not None]
    names = [name for name in names if name not in known]
    for name in scenario.cell.unmodeled:
        if name not in names:
            raise ScenarioError(
                f"cell.unmodeled: the directives have no model {name!r}{nearest(name, names)}"
            )
    return [name for name in names if name not in scenario.cell.unmodeled]


@contextmanager
def loading() -> Iterator[None]:
    """Gives Drake's error about directives our words.

    Raises:
        ScenarioError: Drake cannot load them.
    """
    try:
        yield
    except RuntimeError as error:
        raise ScenarioError(
            "the directives of the cell cannot be loaded; if they name package://drake_models, "
            "Drake must find or download it, else use package://feasigrasp/iiwa/cell.dmd.yaml. "
            f"Drake says: {error}"
        ) from error


def _flat(scenario: Scenario) -> list[ModelDirective]:
    """All directives, with the model of the scenario's arm in the place of the iiwa."""
    return _with_arm(scenario.directives, load_arm(scenario.arm))


def packaged_cell(arm: Arm) -> list[ModelDirective]:
    """The directives of the packaged cell with another arm."""
    file = AddDirectives(file="package://feasigrasp/iiwa/cell.dmd.yaml")
    return _with_arm([ModelDirective(add_directives=file)], arm)


def _with_arm(given: list[ModelDirective], arm: Arm) -> list[ModelDirective]:
    packages = PackageMap()
    packages.AddPackageXml(str(model_path("package.xml")))
    with loading():
        flat = FlattenModelDirectives(ModelDirectives(directives=given), packages)
    directives = list(flat.directives)
    if arm is IIWA_7:
        return directives
    file = _folder({f"{arm.name}.urdf": arm_urdf(arm)}) / f"{arm.name}.urdf"
    ours, theirs = f"{arm.name}::{arm.name}_", f"{IIWA_7.name}::{IIWA_7.name}_"
    for each in directives:
        if each.add_model is not None and each.add_model.name == IIWA_7.name:
            each.add_model = AddModel(name=arm.name, file=file.as_uri())
        if each.add_weld is not None:
            each.add_weld.parent = each.add_weld.parent.replace(theirs, ours)
            each.add_weld.child = each.add_weld.child.replace(theirs, ours)
    return directives


def _obstacle(obstacle: StaticObstacle) -> list[ModelDirective]:
    """What adds an obstacle to a cell."""
    file = _folder(obstacle.files()) / "obstacle.urdf"
    child, X_WB = f"{obstacle.name}::{obstacle.name}", RigidTransform(obstacle.X_WB)
    return [
        ModelDirective(add_model=AddModel(name=obstacle.name, file=file.as_uri())),
        ModelDirective(add_weld=AddWeld(parent="world", child=child, X_PC=Transform(X_WB))),
    ]


def hand_urdf(gripper: Gripper) -> Path:
    """A URDF file of a hand, from its description; it lasts as long as the process."""
    return _folder(hand_files(gripper)) / "gripper.urdf"


def _folder(files: dict[str, str]) -> Path:
    """A folder with files of these names; it lasts as long as the process."""
    return Path(_written(tuple(files.items())).name)


@cache
def _written(files: tuple[tuple[str, str], ...]) -> tempfile.TemporaryDirectory[str]:
    folder = tempfile.TemporaryDirectory(prefix="feasigrasp-cell-")
    for name, text in files:
        (Path(folder.name) / name).write_text(text)
    return folder
