"""Degradations of sensors, calibration and objects, one at a time and all together."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from feasigrasp.models.objects.spring_drive import Compliance
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


def _with(section: str, key: str, value: float | str) -> Change:
    """Another value of one key."""

    def change(scenario: Scenario) -> None:
        setattr(getattr(scenario, section), key, value)

    return change


def _carrier(stiffness: Compliance) -> Change:
    def change(scenario: Scenario) -> None:
        scenario.carrier.stiffness = stiffness.value

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
    "errors-2": _with("sensors", "error_factor", 2.0),
    "smear": _smeared,
    "hand-eye": _hand_eye,
    "carrier-soft": _carrier(Compliance.SOFT),
    "carrier-rigid": _carrier(Compliance.RIGID),
    "friction-0.3": _with("object", "friction", 0.3),
    "friction-0.8": _with("object", "friction", 0.8),
    "mass-0.5": _with("object", "mass_factor", 0.5),
    "mass-2": _with("object", "mass_factor", 2.0),
    "all": _all,
}
