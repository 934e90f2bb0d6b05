"""``feasigrasp arm``: make the file of an arm from its URDF."""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.multibody.parsing import ModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from scipy.optimize import least_squares

from feasigrasp.errors import ControlError
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.arm_file import arm_from
from feasigrasp.models.robot.capsule_kernels import closest_parameters, link_poses_kernel
from feasigrasp.models.robot.capsules import HAND_NAMES, capsule_model, hand_capsules
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability
from feasigrasp.models.robot.urdf_arm import describe_urdf, possible_pairs
from feasigrasp.outputs import replacing
from feasigrasp.resources import model_path
from feasigrasp.systems.station.directives import loading, packaged_cell

#: Rotor inertia of a joint as it feels it [kg m^2]. Source: guessed.
_ROTOR_INERTIA = 0.1
#: Pole of the joints' velocity control [1/s], that of the last three, and that of their position
#: control, all of the iiwa. Source: guessed.
_VELOCITY_POLE, _WRIST_POLE, _POSITION_POLE = 1500.0, 600.0, 0.6
#: Bodies that touch in a larger share of configurations are taken to be built so; those that never
#: come nearer than the second need no check [m]. Source: guessed.
_BUILT_SO, _NEVER_NEAR = 0.2, 0.02
#: Of the hand at home: place on an arm of 0.9 m [m], and approach direction. Source: guessed.
_HOME, _APPROACH, _REACH = np.array([0.22, 0.0, 0.73]), np.array([0.82, 0.0, -0.57]), 0.9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("urdf", type=Path, help="Model of the arm.")
    parser.add_argument("--flange", required=True, help="Link on which the hand is mounted.")
    parser.add_argument("--out", dest="file", type=Path, required=True, help="File to write.")
    parser.add_argument("--name", help="Name of the arm. Default: that of the file.")
    parser.add_argument(
        "--acceleration", type=float, nargs="+", help="Limits [rad/s^2], one per joint."
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    given = describe_urdf(args.urdf, args.flange)
    given = {"name": args.name or args.file.stem, **given}
    warnings = [f"rotor inertias are guessed: {_ROTOR_INERTIA} kg m^2"]
    joints = given["joints"]
    if args.acceleration:
        for joint, limit in zip(joints, args.acceleration, strict=True):
            joint["acceleration"] = limit
    else:
        warnings.append("accelerations are guessed; give --acceleration")
    for joint in joints:
        middle = float(np.clip(0.0, joint["lower"] + 0.1, joint["upper"] - 0.1))
        joint |= {"rotor_inertia": _ROTOR_INERTIA, "kp": 1.0, "kd": 1.0, "home": middle}
    given["flange"] = _flange(given.pop("X_WF"))
    given["pairs"] = []
    for joint, q in zip(joints, _home(arm_from(given)), strict=True):
        joint["home"] = round(float(q), 3)
    given["flange"] = _flange(_turned(arm_from(given)))
    given["pairs"] = [[*pair] for pair in _pairs(arm_from(given))]
    arm = arm_from(given)
    for j, (joint, inertia) in enumerate(zip(joints, _largest_inertias(arm), strict=True)):
        kd = (_WRIST_POLE if j >= arm.joints - 3 else _VELOCITY_POLE) * inertia
        joint["kd"], joint["kp"] = float(f"{kd:.2g}"), float(f"{_POSITION_POLE * kd:.2g}")
    _check(arm, warnings)
    head = f"# Written by feasigrasp arm {args.urdf.name} --flange {args.flange}.\n"
    head += "".join(f"# Beware: {warning}.\n" for warning in warnings)
    text = head + yaml.safe_dump(given, sort_keys=False, default_flow_style=None, width=100)
    with replacing(args.file) as file:
        file.write(text.encode())
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


def _home(arm: Arm) -> Array:
    """The most manipulable configuration found with the hand in front of the arm, shape (n,).

    Where the wrist cannot be so near the first axis, the hand is farther out.
    """
    reach = float(np.abs(np.diff([*arm.points[1:], arm.X_WF[:3, 3]], axis=0)).max(axis=1).sum())
    X_FG, n = ParallelGripper().X_FG, arm.joints
    lower, upper = np.maximum(arm.lower, -np.pi) + 0.2, np.minimum(arm.upper, np.pi) - 0.2
    middle, starts = 0.5 * (lower + upper), np.random.default_rng(0).uniform(size=(40, n))
    for out in (0.0, 0.08, 0.16):
        place = (_HOME + [out, 0.0, 0.5 * out]) * min(1.0, reach / _REACH)

        def error(q: Array, place: Array = place) -> Array:
            X_WG = forward_kinematics(q, X_FG, arm)
            way, turn = X_WG[:3, 3] - place, 0.5 * (X_WG[:3, 2] - _APPROACH)
            return np.concatenate([way, turn, 1e-3 * (q - middle), 1e-2 * q[:1]])

        found = []
        for start in lower + starts * (upper - lower):
            q = least_squares(error, start, bounds=(lower, upper)).x
            room = float(np.min(np.minimum(q - lower, upper - q)))
            if np.abs(error(q)[:6]).max() < 0.03:
                worth = float(manipulability(q, arm)) * min(1.0, room / 0.3) - abs(q[0])
                found.append((worth, q.tolist()))
        if found:
            return np.array(max(found)[1])
    return middle


def _turned(arm: Arm) -> Array:
    """The flange frame (4, 4) at q = 0, turned about its z-axis so that the camera is above."""
    R = forward_kinematics(arm.home, None, arm)[:3, :3]
    down = np.array([0.0, 0.0, -1.0]) - 0.1 * np.array([1.0, 0.0, 0.0])
    angle = float(np.arctan2(R[:, 1] @ down, R[:, 0] @ down))
    quarter = np.pi / 4.0  # mounts have holes at such angles
    c, s = np.cos(round(angle / quarter) * quarter), np.sin(round(angle / quarter) * quarter)
    X_WF = arm.X_WF.copy()
    X_WF[:3, :3] = X_WF[:3, :3] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return X_WF


def _pairs(arm: Arm) -> list[tuple[int, int]]:
    """Pairs of bodies that come close, of 1,000 configurations, and do not touch in most."""
    n = arm.joints
    hand = range(n + 1, n + 1 + len(HAND_NAMES))
    possible = [*possible_pairs(n), *product(range(n - 1), hand)]
    model = capsule_model(None, arm, body_pairs=possible)
    bodies = [capsule.body for capsule in arm.capsules + hand_capsules(None, arm)]
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    Q = arm.random_positions(np.random.default_rng(0), 1000)
    nearest: dict[tuple[int, int], float] = {}
    touches: dict[tuple[int, int], int] = {}
    for q in Q:
        link_poses_kernel(arm.chain, q, R, p)
        ends = np.einsum("cij,cej->cei", R[model.link], model.ends) + p[model.link][:, None]
        points = [tuple(map(tuple, pair)) for pair in ends.tolist()]
        close: dict[tuple[int, int], float] = {}
        for i, j in model.pairs.tolist():
            d = closest_parameters(*points[i], *points[j])[2]
            pair = bodies[i], bodies[j]
            gap = float(np.linalg.norm(d)) - model.radius[i] - model.radius[j]
            close[pair] = min(gap, close.get(pair, np.inf))
        for pair, gap in close.items():
            nearest[pair] = min(gap, nearest.get(pair, np.inf))
            touches[pair] = touches.get(pair, 0) + (gap < 0.0)
    return [
        pair
        for pair in possible
        if nearest.get(pair, np.inf) < _NEVER_NEAR and touches[pair] < _BUILT_SO * len(Q)
    ]


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


def _check(arm: Arm, warnings: list[str]) -> None:
    """Adds what a run with the default options would not accept."""
    try:
        SafetyOptions(arm=arm, acceleration_scale=arm.acceleration_share)
    except ControlError as error:
        warnings.append(str(error))
