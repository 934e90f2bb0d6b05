"""``feasigrasp arm``: make the file of an arm from its URDF."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.multibody.parsing import ModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant

from feasigrasp.errors import ArgumentError, ControlError
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.arm_file import arm_from
from feasigrasp.models.robot.urdf_arm import camera_above, chosen_home, close_pairs, describe_urdf
from feasigrasp.outputs import write_text
from feasigrasp.resources import model_path
from feasigrasp.systems.station.directives import loading, packaged_cell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("urdf", type=Path, help="URDF of the arm.")
    parser.add_argument("--flange", required=True, help="Link that the hand is mounted on.")
    parser.add_argument(
        "--out", dest="file", type=Path, required=True, help="Write the arm to this file."
    )
    parser.add_argument("--name", help="Name of the arm. Default: that of the file to write.")
    parser.add_argument(
        "--acceleration", type=float, nargs="+", help="Limits of acceleration [rad/s^2]."
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.file.resolve() == args.urdf.resolve():
        raise ArgumentError(f"--out {args.file} is the URDF itself; name another file")
    name = args.name or args.file.stem
    given = {"name": name, **describe_urdf(args.urdf, args.flange)}
    rotor_inertia = 0.1  # of a joint as it feels it [kg m^2]; guessed
    warnings = [f"rotor inertias are guessed: {rotor_inertia} kg m^2"]
    joints = given["joints"]
    if args.acceleration:
        if (n := len(args.acceleration)) != len(joints):
            raise ArgumentError(f"--acceleration has {n} values, the arm {len(joints)} joints")
        for joint, limit in zip(joints, args.acceleration, strict=True):
            joint["acceleration"] = limit
    else:
        warnings.append("accelerations are guessed; give --acceleration")
    for joint in joints:
        middle = float(np.clip(0.0, joint["lower"] + 0.1, joint["upper"] - 0.1))
        joint |= {"rotor_inertia": rotor_inertia, "kp": 1.0, "kd": 1.0, "home": middle}
    given["flange"] = _flange(given.pop("X_WF"))
    given["pairs"] = []
    for joint, q in zip(joints, chosen_home(arm_from(given)), strict=True):
        joint["home"] = round(float(q), 3)
    given["flange"] = _flange(camera_above(arm_from(given)))
    given["pairs"] = [[*pair] for pair in close_pairs(arm_from(given))]
    arm = arm_from(given)
    for j, (joint, inertia) in enumerate(zip(joints, _largest_inertias(arm), strict=True)):
        # Poles of velocity and of position control [1/s] as the iiwa is given them; guessed.
        kd = (600.0 if j >= arm.joints - 3 else 1500.0) * inertia
        joint["kd"], joint["kp"] = float(f"{kd:.2g}"), float(f"{0.6 * kd:.2g}")
    try:
        SafetyOptions(arm=arm, acceleration_scale=arm.acceleration_share)
    except ControlError as error:  # a run with the default options would not accept the arm
        warnings.append(str(error))
    if not Reachability(arm=arm, limit_margin=0.0).admissible(arm.home[None]).all():
        warnings.append("no home with the hand in front of the arm was found; give home")
    head = f"# Written by feasigrasp arm {args.urdf.name} --flange {args.flange}.\n"
    head += "".join(f"# Beware: {warning}.\n" for warning in warnings)
    text = head + yaml.safe_dump(given, sort_keys=False, default_flow_style=None, width=100)
    write_text(args.file, text)
    print(f"{args.file}: {arm.joints} joints, {given['family']}, {len(arm.pairs)} pairs")
    print("\n".join(f"beware: {warning}" for warning in warnings))
    return 0


def _flange(X_WF: Array) -> dict[str, Any]:
    """The flange frame as a file has it."""
    R = X_WF[:3, :3]
    return {
        "point": [round(float(v), 6) + 0.0 for v in X_WF[:3, 3]],
        "axes": [[round(float(v), 9) + 0.0 for v in row] for row in R.T],
    }


def _largest_inertias(arm: Arm) -> Array:
    """Largest inertias that the joints feel, with the hand, of 200 configurations [kg m^2]."""
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    with loading():
        ProcessModelDirectives(ModelDirectives(directives=packaged_cell(arm)), plant, parser)
    plant.Finalize()
    context, instance = plant.CreateDefaultContext(), plant.GetModelInstanceByName(arm.name)
    largest = np.zeros(arm.joints)
    first = plant.GetJointByName(arm.joint_names[0], instance).velocity_start()
    for q in arm.random_positions(np.random.default_rng(0), 200):
        plant.SetPositions(context, instance, q)
        M = np.diag(plant.CalcMassMatrix(context))
        largest = np.maximum(largest, M[first : first + arm.joints])
    return largest
