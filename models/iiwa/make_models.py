"""Writes the URDFs, meshes and directives of the robot cell beside this file.

Run ``python models/iiwa/make_models.py`` after a change in feasigrasp/models/robot/iiwa.py,
gripper.py or capsules.py, or in the generator; the output is the same on every run.
"""

import argparse
from pathlib import Path

from generator.arm import arm_urdf
from generator.camera import camera_urdf
from generator.cell import cell_directives
from generator.gltf import gltf
from generator.hand_shapes import camera_parts, finger_parts, gripper_parts
from generator.housings import link_parts
from generator.table import table_parts, table_urdf

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.hand_model import SIDES, gripper_urdf, pad_size, pad_vtk
from feasigrasp.models.robot.iiwa import IIWA_7


def cell_files() -> dict[str, str]:
    """Text of every generated file by its path in the folder of the cell."""
    gripper = ParallelGripper()
    meshes = {f"link_{i}": link_parts(i, step) for i, step in enumerate(IIWA_7.link_steps)}
    meshes["gripper_body"] = gripper_parts(gripper)
    for side, sign in SIDES:
        meshes[f"{side}_finger"] = finger_parts(gripper, sign, pad_size(gripper))
    meshes["camera"] = camera_parts()
    meshes["table"] = table_parts()
    return {
        "iiwa7.urdf": arm_urdf(),
        "gripper.urdf": gripper_urdf(gripper),
        "d435.urdf": camera_urdf(),
        "table.urdf": table_urdf(),
        "cell.dmd.yaml": cell_directives(gripper),
        "cell_drake_models.dmd.yaml": cell_directives(gripper, drake_arm=True),
        "meshes/pad.vtk": pad_vtk(gripper),
        **{f"meshes/{name}.gltf": gltf(parts) for name, parts in meshes.items()},
    }


def main() -> None:
    """Command line: the folder to write to, by default the one of this file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parent)
    output = parser.parse_args().output
    for name, text in cell_files().items():
        path = output / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
