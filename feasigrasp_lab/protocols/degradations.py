"""Degradations of sensors and objects beyond the ideal case."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from feasigrasp.models.faults.images import MaskDilated, MaskEroded, MaskShifted
from feasigrasp.models.objects.tracker_config import TrackerKind
from feasigrasp.scenario.schema import Scenario, Segmentation

#: Changes a scenario, whose seed is set by then.
Change = Callable[[Scenario], None]


def unchanged(scenario: Scenario) -> None:
    """Leaves a scenario as its file has it."""


def both(first: Change, second: Change) -> Change:
    """One change after the other."""

    def change(scenario: Scenario) -> None:
        first(scenario)
        second(scenario)

    return change


#: Speed of the object [m/s]. Source: definition.
SPEED = 0.1


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


def _camera_noise(scenario: Scenario) -> None:
    scenario.camera_noise = {scenario.perception.camera: {}}


def _hand_eye(scenario: Scenario) -> None:
    """The camera stands 5 mm and 1 degree off its calibrated pose, and has its noise as well."""
    errors = {"hand_eye_position": 0.005, "hand_eye_angle_deg": 1.0}
    scenario.camera_noise = {scenario.perception.camera: errors}


def _latency(seconds: float) -> Change:
    def change(scenario: Scenario) -> None:
        scenario.perception.latency = seconds

    return change


def _friction(friction: float) -> Change:
    def change(scenario: Scenario) -> None:
        scenario.object.friction = friction

    return change


def _mass(factor: float) -> Change:
    def change(scenario: Scenario) -> None:
        scenario.object.mass_factor = factor

    return change


def _masks(scenario: Scenario) -> None:
    """Masks that miss the rim, have too much of it, or lie beside the object, in turn."""
    # Pixels by which masks are wrong: a rim missed, a rim too much, or all of it beside the object.
    pixels = 3
    scenario.faults += [
        MaskEroded(duration=1.0, every=3.0, pixels=pixels),
        MaskDilated(start=1.0, duration=1.0, every=3.0, pixels=pixels),
        MaskShifted(start=2.0, duration=1.0, every=3.0, columns=pixels, rows=pixels),
    ]


def _all(scenario: Scenario) -> None:
    """Everything at once; what has a range is drawn from it by the run's seed and object."""
    # Ranges that are drawn from where everything comes together: time from a view to its grasps
    # [s], friction, and mass as a multiple of the object's.
    latency, friction, mass = (0.0, 1.0), (0.3, 0.8), (0.5, 2.0)
    which = zlib.crc32(Path(scenario.object.model).stem.encode())
    rng = np.random.default_rng([scenario.random_seed, which, 2])
    _hand_eye(scenario)
    motion_capture(scenario)
    _masks(scenario)
    scenario.perception.latency = rng.uniform(*latency)
    scenario.object.friction = rng.uniform(*friction)
    scenario.object.mass_factor = float(np.exp(rng.uniform(*np.log(mass))))


#: By name, every degradation, on top of perfect sensors; the first is none.
DEGRADATIONS: dict[str, Change] = {
    name: both(perfect_sensors, change)
    for name, change in {
        "none": unchanged,
        "camera-noise": _camera_noise,
        "hand-eye": _hand_eye,
        "pose-noise": motion_capture,
        "latency-0.3": _latency(0.3),
        "latency-1": _latency(1.0),
        "masks": _masks,
        "friction-0.3": _friction(0.3),
        "friction-0.8": _friction(0.8),
        "mass-0.5": _mass(0.5),
        "mass-2": _mass(2.0),
        "all": _all,
    }.items()
}
