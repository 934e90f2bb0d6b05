"""``feasigrasp evaluate prediction``: compare the predicted motion of objects with the true."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.pose_filter import (
    Noise,
    empty_state,
    measure_kernel,
    pose_kernel,
    twist_kernel,
)
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.resources import diagram_path
from feasigrasp.results.arguments import add_common_arguments, names, positive
from feasigrasp.results.rows import Row, report_rows, write_csv
from feasigrasp.results.statistics import mean
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion

SCENARIOS = "PaperCircular,PaperLinear,PaperSinusoidal,ReachCircular,ReachLinear,ReachSinusoidal"
#: Time between measurements, and over which the difference is taken that is the peer [s].
PERIOD, WINDOW = 0.005, 0.02
#: How far ahead poses are predicted [s].
AHEAD = (0.5, 1.0, 2.0, 4.0)
#: Nothing is compared before this: the predictor wants to see some path [s].
_START = 6.0


@dataclass(frozen=True)
class Measurement:
    """How poses are measured: standard deviations [m], [rad], and age when they arrive [s]."""

    position: float
    rotation: float
    latency: float


MEASUREMENTS = {
    "perfect": Measurement(0.0, 0.0, 0.0),
    "noisy": Measurement(0.002, float(np.deg2rad(1.0)), 0.05),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/prediction", objects="duck")
    parser.add_argument(
        "--scenarios", type=names, default=names(SCENARIOS), help=f"default: {SCENARIOS}"
    )
    parser.add_argument("--seeds", type=positive, default=5, help="repeats, with seeds that count")


def motion_errors(
    motion: HarmonicMotion, measurement: Measurement, seed: int, duration: float
) -> dict[str, float]:
    """Root mean square errors of the filter, of a difference, and of the predictions.

    Args:
        motion: The true motion.
        measurement: How it is measured, 200 times a second.
        seed: Seed of the noise.
        duration: How long [s].
    """
    rng = np.random.default_rng(seed)
    noise = Noise(measurement.position, measurement.rotation)
    state, window = empty_state(), round(WINDOW / PERIOD)
    measured: list[Array] = []
    errors: dict[str, list[float]] = {}

    def add(name: str, value: float) -> None:
        errors.setdefault(name, []).append(value)

    for k in range(round(duration / PERIOD)):
        t = k * PERIOD
        X, z = motion.pose(t).copy(), rng.standard_normal(6)
        X[:3, :3] = se3.so3_exp(measurement.rotation * z[:3]) @ X[:3, :3]
        X[:3, 3] += measurement.position * z[3:]
        measured = [*measured[-window:], X]
        measure_kernel(state, t, X, noise)
        if t < _START or k % 10:
            continue
        now = t + measurement.latency
        V_true, X_now, V_now = motion.velocity(now), np.empty((4, 4)), np.empty(6)
        pose_kernel(state, now, X_now)
        twist_kernel(state, now, V_now)
        old, new = measured[0], measured[-1]
        V_difference = (
            np.concatenate([se3.so3_log(new[:3, :3] @ old[:3, :3].T), new[:3, 3] - old[:3, 3]])
            / WINDOW
        )
        pose = se3.extrapolate(new, V_difference, measurement.latency)
        for preset, X_found, V in (
            ("filter", X_now, V_now),
            ("difference over 20 ms", pose, V_difference),
        ):
            position, angle = _apart(X_found, motion.pose(now))
            add(f"position_mm/{preset}", 1e3 * position)
            add(f"angle_deg/{preset}", np.rad2deg(angle))
            add(f"velocity_mm_s/{preset}", 1e3 * float(np.linalg.norm((V - V_true)[3:])))
            turning = float(np.linalg.norm((V - V_true)[:3]))
            add(f"angular_velocity_deg_s/{preset}", np.rad2deg(turning))
        estimate = MotionEstimate(state.copy(), now)
        for s, predicted in zip(AHEAD, estimate.predict(AHEAD), strict=True):
            position, angle = _apart(predicted, motion.pose(now + s))
            add(f"ahead_{s:g}s_cm/predictor", 100.0 * position)
            add(f"ahead_{s:g}s_deg/predictor", np.rad2deg(angle))
            straight = se3.extrapolate(motion.pose(now), V_true, s)
            position, _ = _apart(straight, motion.pose(now + s))
            add(f"ahead_{s:g}s_cm/true twist held", 100.0 * position)
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
        errors = motion_errors(make_motion(scenario), MEASUREMENTS[kind], seed, duration)
        for key, value in errors.items():
            figure, method = key.split("/")
            preset = f"{name}/{kind}/{method}"
            yield {"figure": figure, "preset": preset, "seed": seed, "value": value}


_UNITS = {"mm": "mm", "deg": "deg", "cm": "cm", "mm_s": "mm/s", "deg_s": "deg/s"}


def _unit(figure: str) -> str:
    ending = "_".join(figure.split("_")[-2:])
    return _UNITS[ending] if ending in _UNITS else _UNITS[figure.split("_")[-1]]


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    raw = list(_measure(args))
    write_csv(args.out / "errors.csv", raw)
    groups: dict[tuple[str, str], list[float]] = {}
    for item in raw:
        groups.setdefault((item["figure"], item["preset"]), []).append(item["value"])
    rows = [
        Row.of(f"prediction.{figure}", preset, mean(values, 0.0), _unit(figure))
        for (figure, preset), values in groups.items()
    ]
    report_rows(args, "evaluate prediction", rows)
    return 0
