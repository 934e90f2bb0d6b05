"""``feasigrasp evaluate prediction``: compare the predicted with the true motion of objects."""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from operator import itemgetter
from typing import Any

import numpy as np
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.motion import ObjectMotion
from feasigrasp.models.objects.pose_filter import (
    Noise,
    empty_state,
    measure_kernel,
    pose_kernel,
    twist_kernel,
)
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.resources import diagram_path
from feasigrasp.runs.results.arguments import add_common_arguments, names, positive
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp.runs.results.statistics import grouped, mean
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion

SCENARIOS = "PaperCircular,PaperLinear,PaperSinusoidal,ReachCircular,ReachLinear,ReachSinusoidal"
#: Time between measurements, and over which the difference is taken that is the peer [s].
PERIOD, WINDOW = 0.005, 0.02
#: How far ahead poses are predicted [s].
HORIZON = (0.5, 1.0, 2.0, 4.0)
#: Nothing is compared before this: the predictor wants to see some path [s].
_START = 6.0


#: How poses are measured: noise [m], [rad], and age when they arrive [s].
MEASUREMENTS = {
    "perfect": (Noise(0.0, 0.0), 0.0),
    "noisy": (Noise(0.002, float(np.deg2rad(1.0))), 0.05),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/prediction", objects="duck")
    parser.add_argument(
        "--scenarios", type=names, default=names(SCENARIOS), help="Scenarios, separated by commas."
    )
    parser.add_argument(
        "--seeds", type=positive, default=5, help="Number of repeats, with consecutive seeds."
    )


def motion_errors(
    motion: ObjectMotion, noise: Noise, latency: float, seed: int, duration: float
) -> dict[str, float]:
    """Root mean square errors of the filter, of a difference, and of the predictions.

    Args:
        motion: The true motion, which is measured 200 times a second.
        noise: Of the measurements.
        latency: Age of the measurements when they arrive [s].
        seed: Seed of the noise.
        duration: How long [s].
    """
    rng = np.random.default_rng(seed)
    state, window = empty_state(), round(WINDOW / PERIOD)
    measured: list[Array] = []
    errors: defaultdict[str, list[float]] = defaultdict(list)
    for k in range(round(duration / PERIOD)):
        t = k * PERIOD
        X, z = motion.pose(t).copy(), rng.standard_normal(6)
        X[:3, :3] = se3.so3_exp(noise.rotation * z[:3]) @ X[:3, :3]
        X[:3, 3] += noise.position * z[3:]
        measured = [*measured[-window:], X]
        measure_kernel(state, t, X, noise)
        if t < _START or k % 10:
            continue
        now = t + latency
        V_true, X_now, V_now = motion.velocity(now), np.empty((4, 4)), np.empty(6)
        pose_kernel(state, now, X_now)
        twist_kernel(state, now, V_now)
        old, new = measured[0], measured[-1]
        V_difference = (
            np.concatenate([se3.so3_log(new[:3, :3] @ old[:3, :3].T), new[:3, 3] - old[:3, 3]])
            / WINDOW
        )
        pose = se3.extrapolate(new, V_difference, latency)
        for preset, X_found, V in (
            ("filter", X_now, V_now),
            ("difference over 20 ms", pose, V_difference),
        ):
            position, angle = _apart(X_found, motion.pose(now))
            turning, moving = np.linalg.norm((V - V_true).reshape(2, 3), axis=1)
            errors[f"position_mm/{preset}"].append(1e3 * position)
            errors[f"angle_deg/{preset}"].append(np.rad2deg(angle))
            errors[f"velocity_mm_s/{preset}"].append(1e3 * moving)
            errors[f"angular_velocity_deg_s/{preset}"].append(np.rad2deg(turning))
        estimate = MotionEstimate(state.copy(), now)
        by_path = np.linalg.norm(estimate.velocity(V_now[3:]) - V_true[3:])
        errors["velocity_mm_s/path"].append(1e3 * float(by_path))
        for s, predicted in zip(HORIZON, estimate.predict(HORIZON), strict=True):
            position, angle = _apart(predicted, motion.pose(now + s))
            errors[f"ahead_{s:g}s_cm/predictor"].append(100.0 * position)
            errors[f"ahead_{s:g}s_deg/predictor"].append(np.rad2deg(angle))
            straight = se3.extrapolate(motion.pose(now), V_true, s)
            position, _ = _apart(straight, motion.pose(now + s))
            errors[f"ahead_{s:g}s_cm/true twist held"].append(100.0 * position)
    return {name: float(np.sqrt(np.mean(np.square(x)))) for name, x in errors.items()}


def _apart(X: Array, X_true: Array) -> tuple[float, float]:
    angle = se3.rotation_angle(X[:3, :3] @ X_true[:3, :3].T)
    return float(np.linalg.norm(X[:3, 3] - X_true[:3, 3])), float(angle)


def _measure(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    seeds = range(args.seed, args.seed + (1 if args.quick else args.seeds))
    filename = diagram_path("dynamic.scenarios.yaml")
    runs = [(s, m, seed) for s in args.scenarios for m in MEASUREMENTS for seed in seeds]
    for name, kind, seed in tqdm(runs, unit="run", desc="prediction"):
        scenario = load_scenario(filename, name, f"{{random_seed: {seed}}}")
        duration = 10.0 if args.quick else 21.0
        errors = motion_errors(make_motion(scenario), *MEASUREMENTS[kind], seed, duration)
        for key, value in errors.items():
            figure, method = key.split("/")
            preset = f"{name}/{kind}/{method}"
            yield {"figure": figure, "preset": preset, "seed": seed, "value": value}


def _unit(figure: str) -> str:
    """The unit that the name of a figure ends in."""
    *_, before, last = figure.split("_")
    return f"{before}/s" if last == "s" else last


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    raw = list(_measure(args))
    write_csv(args.out / "errors.csv", raw)
    rows = []
    for (figure, preset), group in grouped(raw, itemgetter("figure", "preset")).items():
        average = mean([run["value"] for run in group], 0.0)
        rows.append(Row.of(f"prediction.{figure}", preset, average, _unit(figure)))
    report_rows(args, "evaluate prediction", rows)
    return 0
