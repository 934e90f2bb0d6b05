"""``feasigrasp evaluate followable``: measure the tracking feasibility of moving hand poses.

What of the curve of success over speed is the arm: whoever grasps an object while it moves has a
hand that keeps up with it while the fingers close. Objects move as in ``evaluate dynamic --study
speed``; hands are at the object's middle in random orientations, fixed to it, and the arm keeps its
branch and its arm angle.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from tqdm import tqdm

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.closed_form import closed_form
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.runs.results.arguments import add_common_arguments, factor, positive
from feasigrasp.runs.results.rows import Row, report_rows
from feasigrasp.runs.results.statistics import mean
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.protocols.speed import AT_SPEEDS, MOTIONS, curve_point


def is_trackable(
    X_WF: Array, dt: float, shares: tuple[float, float] = (1.0, 1.0), arm_angles: int = 16
) -> Mask:
    """Whether some configuration follows moving flange poses inside the arm's limits.

    The arm keeps its branch and its arm angle, one of so many; it may collide with itself or the
    table. Velocities and accelerations are central differences.

    Args:
        X_WF: Flange poses at k instants, shape (..., k, 4, 4), k > 2 [m]; limits are kept at all
            but the first and the last.
        dt: Time between instants [s].
        shares: Of the velocity and of the acceleration limits that are used.
        arm_angles: How many arm angles are tried.

    Returns:
        Shape (...).
    """
    poses = np.ascontiguousarray(X_WF, dtype=float)
    found = np.zeros(poses.shape[:-3], dtype=bool)
    fastest = np.multiply(shares[0], IIWA_7.velocity_limits)
    sharpest = np.multiply(shares[1], IIWA_7.acceleration_limits)
    for psi in np.linspace(-np.pi, np.pi, arm_angles, endpoint=False):
        q = closed_form(poses, psi)  # (..., k, 8, 7), NaN out of reach
        before, now, after = q[..., :-2, :, :], q[..., 1:-1, :, :], q[..., 2:, :, :]
        kept = np.abs(now) <= IIWA_7.position_limits
        kept &= np.abs(after - before) <= 2.0 * dt * fastest
        kept &= np.abs(after - 2.0 * now + before) <= dt**2 * sharpest
        found |= kept.all(axis=(-3, -1)).any(axis=-1)
    return found


#: Shares of the velocity and of the acceleration limits, by the end of a row's preset: those of the
#: arm, and what our safety problem uses of them.
_SHARES = {
    "": (1.0, 1.0),
    "/safe": (SafetyOptions.velocity_scale, SafetyOptions.acceleration_scale),
}
#: Instants in the time for which a hand keeps up.
_INSTANTS = 13


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/followable", objects="builtin")
    parser.add_argument(
        "--hands", type=positive, default=100, help="Number of orientations of the hand."
    )
    parser.add_argument(
        "--moments", type=positive, default=100, help="Number of start times within a run."
    )
    help_ = "Time that the arm keeps up, in seconds: 0.1 to settle, the rest to close the fingers."
    parser.add_argument("--time", type=factor, default=0.6, help=help_)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.quick:
        args.hands, args.moments = min(args.hands, 30), min(args.moments, 20)
    R_OG = se3.random_pose(np.random.default_rng(args.seed), args.hands)[:, :3, :3]
    X_OF = se3.make_pose(R_OG, np.zeros(3)) @ np.linalg.inv(ParallelGripper().X_FG)
    dt, rows = args.time / (_INSTANTS - 1), list[Row]()
    for preset, scenario in tqdm(list(_points()), desc="speeds"):
        X_WO = _windows(scenario, dt, args.moments)
        X_WF = X_WO[:, None] @ X_OF[:, None]  # moments x hands x instants
        for end, shares in _SHARES.items():
            found = is_trackable(X_WF, dt, shares)
            share = mean(found.mean(axis=0), 0.0, 1.0)  # with an interval over hands
            rows.append(Row.of("followable.percent", f"{preset}{end}", share, "%", 100.0))
    report_rows(args, "evaluate followable", rows, time=args.time)
    return 0


def _points() -> Iterator[tuple[str, Scenario]]:
    """The points of the curves, and the scenario of each."""
    for name in MOTIONS.values():
        for suffix, change in AT_SPEEDS.items():
            scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), name)
            change(scenario)
            yield str(curve_point(f"{name}{suffix}")), scenario


def _windows(scenario: Scenario, dt: float, moments: int) -> Array:
    """Poses of the object from moments of the run on, shape (moments, instants + 2, 4, 4).

    One instant more at either end is for differences.
    """
    motion = make_motion(scenario)
    starts = np.linspace(0.0, scenario.simulation_duration, moments, endpoint=False) + dt
    steps = dt * np.arange(-1, _INSTANTS + 1)
    return np.array([[motion.pose(start + step) for step in steps] for start in starts])
