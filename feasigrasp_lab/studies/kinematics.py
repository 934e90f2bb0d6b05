"""``feasigrasp evaluate kinematics``: compare the arm's kinematics with Drake's.

Forward kinematics, Jacobian and self-collision are compared with Drake's plant and scene graph,
inverse kinematics with forward kinematics.
"""

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.ik.self_motion import arm_angle, closed_form
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp_lab.arm import in_collision
from feasigrasp_lab.peers import DrakeArm
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.rows import Row, report_rows, write_csv


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/evaluate_kinematics", objects="builtin")


def folded_configurations(n: int, rng: np.random.Generator) -> Array:
    """Configurations bent back towards the base, of which a quarter is in collision, (n, 7)."""
    Q = IIWA_7.random_positions(rng, n)
    side = np.sign(Q[:, :1])
    Q[:, [2, 4]] *= 0.2
    Q[:, [1, 3, 5]] = side * np.abs(Q[:, [1, 3, 5]]) * (1, -1, 1)
    Q[:, [1, 3]] = (Q[:, [1, 3]] + np.sign(Q[:, [1, 3]]) * IIWA_7.upper[1]) / 2
    return Q


def forward_rows(n: int, seed: int, folder: Path) -> list[Row]:
    """Largest differences from Drake's plant over ``n`` random configurations."""
    Q = IIWA_7.random_positions(np.random.default_rng([seed, 0]), n)
    X, J = pose_and_jacobian(Q)
    X_drake, J_drake = DrakeArm().pose_and_jacobian(Q)
    position = np.linalg.norm((X - X_drake)[:, :3, 3], axis=1)
    rotation = np.abs(X - X_drake)[:, :3, :3].max(axis=(1, 2))
    jacobian = np.abs(J - J_drake).max(axis=(1, 2))
    _write(folder / "forward.csv", "position_m,rotation,jacobian", position, rotation, jacobian)
    return [
        Row.plain("kinematics.fk_error_max", "default", position.max(), "m", n),
        Row.plain("kinematics.fk_rotation_error_max", "default", rotation.max(), "1", n),
        Row.plain("kinematics.jacobian_error_max", "default", jacobian.max(), "1", n),
    ]


def inverse_rows(n: int, seed: int, folder: Path) -> list[Row]:
    """Closed form: residual of all its solutions, and configurations found again."""
    rng = np.random.default_rng([seed, 1])
    Q = IIWA_7.random_positions(rng, n)
    X_WF = forward_kinematics(Q)
    psis = rng.uniform(-np.pi, np.pi, n)
    position, rotation, away = np.empty(n), np.empty(n), np.empty(n)
    for k in tqdm(range(n), desc="inverse kinematics", leave=False):
        solutions = closed_form(X_WF[k], psis[k])
        missed = forward_kinematics(solutions) - X_WF[k]
        position[k] = np.sqrt((np.square(missed)[..., :3, 3]).sum(axis=-1)).max()
        # The angle of a small rotation is its Frobenius norm over the root of 2.
        rotation[k] = np.sqrt((np.square(missed)[..., :3, :3]).sum(axis=(-1, -2)) / 2).max()
        own = closed_form(X_WF[k], arm_angle(Q[k]))
        away[k] = np.abs(own - Q[k]).max(axis=1).min()
    # Without solutions they are NaN.
    position, rotation, away = (np.nan_to_num(x, nan=np.inf) for x in (position, rotation, away))
    _write(folder / "inverse.csv", "position_m,rotation_rad,away_rad", position, rotation, away)
    residual = max(position.max(), rotation.max())
    # A configuration counts as found again within this [rad].
    return [
        Row.plain("kinematics.ik_residual_max", "default", residual, "m|rad", n),
        Row.percent("kinematics.ik_recovered_percent", "default", away <= 1e-6),
    ]


def collision_rows(n: int, seed: int) -> list[Row]:
    """Verdicts that differ from Drake's, of ``n`` uniform and as many `folded_configurations`."""
    rng = np.random.default_rng([seed, 2])
    drake, rows = DrakeArm(), []
    for preset, Q in (
        ("default", IIWA_7.random_positions(rng, n)),
        ("folded", folded_configurations(n, rng)),
    ):
        ours = in_collision(Q)
        differ = Q[ours != drake.has_collisions(Q)]
        # Configurations closer to contact are not judged: the two programs round differently [m].
        near, deep = (in_collision(differ, margin=margin) for margin in (1e-9, -1e-9))
        touching = int((near & ~deep).sum())
        rows += [
            Row.plain("kinematics.collision_mismatches", preset, len(differ) - touching, "1", n),
            Row.plain("kinematics.collision_at_contact", preset, touching, "1", n),
            Row.plain("kinematics.collision_hits", preset, int(ours.sum()), "1", n),
        ]
    return rows


def _write(filename: Path, header: str, *columns: Array) -> None:
    write_csv(filename, np.column_stack(columns).tolist(), header.split(","), ".9g")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    n = 10_000 if args.quick else 100_000
    rows = [
        *forward_rows(10_000, args.seed, args.out),
        *inverse_rows(n, args.seed, args.out),
        *collision_rows(n, args.seed),
    ]
    report_rows(args, "evaluate kinematics", rows)
    return 0
