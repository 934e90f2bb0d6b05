"""Translational and rotational speeds of the object."""

from __future__ import annotations

import numpy as np

from feasigrasp.scenario.schema import BezierPath, MotionConfig, Scenario
from feasigrasp_lab.protocols.degradations import Change

#: Motions of the speed curve by the word that its rows have for them, with the object's pose given.
MOTIONS = {"circle": "ReachCircularMocap", "line": "ReachLinearMocap", "bezier": "ReachBezierMocap"}
#: The same with the camera alone.
CAMERA_MOTIONS = {f"{word}-camera": name.removesuffix("Mocap") for word, name in MOTIONS.items()}
#: Speeds on the path: constant on the circle, the peak on the line, between two stops on Bezier
#: curves [m/s]. Source: definition.
SPEEDS = (0.05, 0.15, 0.3, 0.45, 0.6)
#: Speeds of the rotation [rad/s], on the circle at `SPIN_AT` [m/s]. Source: definition.
SPINS = (0.0, 0.5, 1.0, 1.5)
SPIN_AT = 0.15
_SPEED, _SPIN = "-at-", "-spin-"


def at_speed(speed: float) -> Change:
    """Lets the object move with that largest speed along its path [m/s]."""

    def change(scenario: Scenario) -> None:
        motion = scenario.motion
        if isinstance(motion, BezierPath):
            motion.speed = speed
        else:
            motion.rate = speed / _path_per_phase(motion)

    return change


def at_spin(spin: float) -> Change:
    """Lets the object turn with that speed [rad/s], and move with `SPIN_AT`."""

    def change(scenario: Scenario) -> None:
        at_speed(SPIN_AT)(scenario)
        scenario.motion.spin = spin

    return change


def _path_per_phase(motion: MotionConfig) -> float:
    """Largest way along the path per phase [m/rad]."""
    s = np.linspace(0.0, 2.0 * np.pi, 2000)[:, None]
    harmonic, offset = np.array(motion.harmonic), np.deg2rad(motion.offset_deg)
    rate = np.array(motion.amplitude) * harmonic * np.cos(harmonic * s + offset)
    return float(np.linalg.norm(rate, axis=1).max())


#: What the studies ``speed`` and ``spin`` run their scenarios with, by the end of the runs' names.
AT_SPEEDS = {f"{_SPEED}{speed:g}": at_speed(speed) for speed in SPEEDS}
AT_SPINS = {f"{_SPIN}{spin:g}": at_spin(spin) for spin in SPINS}


def curve_point(run_name: str) -> str | None:
    """The point of a curve that a run belongs to, ``circle/0.15`` or ``spin/0.5``; None if none."""
    for motion, scenario in (MOTIONS | CAMERA_MOTIONS).items():
        for suffix in AT_SPEEDS:
            if run_name == f"{scenario}{suffix}":
                return f"{motion}/{suffix.removeprefix(_SPEED)}"
    spin = next((suffix for suffix in AT_SPINS if run_name.endswith(suffix)), None)
    return None if spin is None else f"spin/{spin.removeprefix(_SPIN)}"
