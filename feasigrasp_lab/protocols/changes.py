"""What studies change of scenarios: sensors, calibration, objects, speeds, bodies of the cell."""

import math
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp.models.objects.spring_drive import Compliance
from feasigrasp.models.objects.tracking import TrackerKind
from feasigrasp.scenario.cell import BoxConfig
from feasigrasp.scenario.schema import BezierPath, MotionConfig, Scenario, Segmentation

#: Changes a scenario, whose seed is set by then.
Change = Callable[[Scenario], None]


def unchanged(scenario: Scenario) -> None:
    """Leaves a scenario as its file has it."""


def setting(keys: Mapping[str, Any]) -> Change:
    """Sets keys, ``section.name``, of a scenario."""

    def change(scenario: Scenario) -> None:
        for key, value in keys.items():
            section, name = key.split(".")
            setattr(getattr(scenario, section), name, value)

    return change


def both(first: Change, second: Change) -> Change:
    """One change after the other."""

    def change(scenario: Scenario) -> None:
        first(scenario)
        second(scenario)

    return change


def perfect_sensors(scenario: Scenario) -> None:
    """Depth images without error, and grasps the moment their view is taken."""
    scenario.camera_noise = {}
    scenario.perception.latency = 0.0


def motion_capture(scenario: Scenario) -> None:
    """A tracker that errs by 2 mm and 1 degree and is 50 ms late."""
    scenario.tracker.position_noise = 0.002
    scenario.tracker.rotation_noise = math.radians(1.0)
    scenario.tracker.latency = 0.05


def given_truth(scenario: Scenario) -> None:
    """The true pose, and the true pixels of the object in the same noisy images."""
    scenario.tracker.kind = TrackerKind.MOCAP.value
    scenario.perception.segmentation = Segmentation.LABELS.value


def _hand_eye(scenario: Scenario) -> None:
    """The camera stands 5 mm and 1 degree off its calibrated pose."""
    noise = scenario.camera_noise[scenario.perception.camera]
    noise |= {"hand_eye_position": 0.005, "hand_eye_angle_deg": 1.0}


def _smeared(scenario: Scenario) -> None:
    """Disparities are smeared over edges, so far as in a sequence of a RealSense [px]."""
    scenario.camera_noise[scenario.perception.camera] |= {"smear": 3.0}


def _late(seconds: float) -> Change:
    """Images that arrive so long after their exposure [s]."""

    def change(scenario: Scenario) -> None:
        scenario.cameras[scenario.perception.camera].output_delay = seconds

    return change


def _all(scenario: Scenario) -> None:
    """Everything at once; what has a range is drawn from it by the run's seed and object."""
    # Ranges: time from an exposure to its image [s], friction, and mass as a multiple of the
    # object's.
    late, friction, mass = (0.0, 0.12), (0.3, 0.8), (0.5, 2.0)
    which = zlib.crc32(Path(scenario.object.model).stem.encode())
    rng = np.random.default_rng([scenario.random_seed, which, 2])
    _hand_eye(scenario)
    scenario.sensors.error_factor = 2.0
    _late(rng.uniform(*late))(scenario)
    scenario.object.friction = rng.uniform(*friction)
    scenario.object.mass_factor = float(np.exp(rng.uniform(*np.log(mass))))


#: By name, what is worse than in a run by the camera alone, or kinder; the first is nothing.
DEGRADATIONS: dict[str, Change] = {
    "none": unchanged,
    "latency-0": _late(0.0),
    "latency-0.12": _late(0.12),
    "errors-2": setting({"sensors.error_factor": 2.0}),
    "smear": _smeared,
    "hand-eye": _hand_eye,
    "carrier-soft": setting({"carrier.stiffness": Compliance.SOFT.value}),
    "carrier-rigid": setting({"carrier.stiffness": Compliance.RIGID.value}),
    "friction-0.3": setting({"object.friction": 0.3}),
    "friction-0.8": setting({"object.friction": 0.8}),
    "mass-0.5": setting({"object.mass_factor": 0.5}),
    "mass-2": setting({"object.mass_factor": 2.0}),
    "all": _all,
}


#: Bodies beside the path: direction from its middle, and sides [m].
_BODIES = {
    "wall": ((0.0, 1.0, 0.0), (0.5, 0.04, 0.5)),
    "shelf": ((0.0, 1.4, 0.8), (0.6, 0.3, 0.03)),
    "bench": ((0.0, 0.0, -1.0), (0.6, 0.6, 0.04)),
}


def _beside(name: str, distance: float) -> Change:
    def change(scenario: Scenario) -> None:
        way, size = _BODIES[name]
        middle = [c + distance * w for c, w in zip(scenario.motion.center, way, strict=True)]
        scenario.cell.boxes[name] = BoxConfig(size=list(size), position=middle)

    return change


#: What the study ``cell`` runs its scenarios with, by the end of the runs' names: each body at
#: three distances from the middle of the object's path [m].
BODIES = {
    f"-{name}-{distance:g}": _beside(name, distance)
    for name in _BODIES
    for distance in (0.12, 0.18, 0.25)
}


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
