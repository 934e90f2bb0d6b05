"""Values that a scenario may not have."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from feasigrasp.errors import CameraError, ScenarioError
from feasigrasp.models.clouds.depth_noise import DepthNoise
from feasigrasp.models.control.joint.sources import Source
from feasigrasp.models.control.mode import ControlMode, ControlSpace
from feasigrasp.models.grasps.samplers import SamplerName
from feasigrasp.models.reach.judge import JudgeMethod
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.shape.completion import Preset
from feasigrasp.scenario.faults import check_faults
from feasigrasp.scenario.schema import Scenario

_CHOICES: dict[str, tuple[str, ...]] = {
    "control.controller": tuple(ControlSpace),
    "control.mode": tuple(ControlMode),
    "control.source": tuple(Source),
    "perception.preset": tuple(Preset),
    "perception.sampler": tuple(SamplerName),
    "reachability.method": tuple(JudgeMethod),
}


def check_scenario(scenario: Scenario) -> None:
    """Checks what the types of a scenario cannot say.

    Raises:
        ScenarioError: A value that nothing can run with; the message names key, value and mend.
    """
    for key, allowed in _CHOICES.items():
        section, name = key.split(".")
        choice = getattr(getattr(scenario, section), name)
        if choice not in allowed:
            raise ScenarioError(f"{key} is {choice!r}; choose one of {', '.join(allowed)}")
    if scenario.perception.camera not in scenario.cameras:
        raise ScenarioError(
            f"perception.camera is {scenario.perception.camera!r}, but cameras has "
            f"{', '.join(scenario.cameras) or 'none'}"
        )
    if not 0 <= scenario.random_seed < 2**32:
        raise ScenarioError(f"random_seed is {scenario.random_seed}; give one of 0 to 2^32 - 1")
    _check_camera_noise(scenario)
    _check_vectors(scenario)
    _check_positive(scenario)
    check_faults(scenario.faults)


def _check_camera_noise(scenario: Scenario) -> None:
    known = [field.name for field in fields(DepthNoise)]
    for name, changes in scenario.camera_noise.items():
        if name not in scenario.cameras:
            raise ScenarioError(
                f"camera_noise names {name!r}, but cameras has "
                f"{', '.join(scenario.cameras) or 'none'}"
            )
        unknown = [key for key in changes if key not in known]
        if unknown:
            raise ScenarioError(
                f"camera_noise.{name} has {', '.join(unknown)}; it may have {', '.join(known)}"
            )
        try:
            DepthNoise(**changes)
        except CameraError as error:
            raise ScenarioError(f"camera_noise.{name}: {error}") from error


def _check_vectors(scenario: Scenario) -> None:
    motion = scenario.motion
    vectors = {
        f"motion.{key}": (getattr(motion, key), 3)
        for key in ("center", "amplitude", "harmonic", "offset_deg", "spin_axis")
    }
    vectors |= {
        "grasp.lift": (scenario.grasp.lift, 3),
        "q_start": (scenario.q_start, IIWA_7.joints),
    }
    for key, (value, size) in vectors.items():
        if len(value) != size:
            what = "x, y and z" if size == 3 else f"one per joint of the iiwa, {size}"
            raise ScenarioError(f"{key} has {len(value)} entries; give {what}")
        if not np.all(np.isfinite(value)):
            raise ScenarioError(f"{key} is {value}; every entry must be a finite number")
    if not np.any(motion.spin_axis):
        raise ScenarioError("motion.spin_axis is zero; give an axis, and spin: 0 for no rotation")
    for key in ("rate", "spin"):
        if not np.isfinite(getattr(motion, key)):
            raise ScenarioError(f"motion.{key} is {getattr(motion, key)}; give a finite number")


def _check_positive(scenario: Scenario) -> None:
    positive = {
        "perception.period": scenario.perception.period,
        "scene.period": scenario.scene.period,
        "scene.resolution": scenario.scene.resolution,
        "reachability.period": scenario.reachability.period,
        "control.period": scenario.control.period,
        "tracker.period": scenario.tracker.period,
        "simulation_duration": scenario.simulation_duration,
        "object.scale": scenario.object.scale,
        "object.friction": scenario.object.friction,
    }
    for key, value in positive.items():
        if not 0.0 < value < np.inf:
            raise ScenarioError(f"{key} is {value}; it must be positive and finite")
