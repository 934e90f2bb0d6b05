"""Values that a scenario may have: one table of ranges, one of words, and what must fit together.

A key of the schema that holds a number has a line in `LIMITS`; a test fails for one that has none.
"""

from __future__ import annotations

import dataclasses as dc
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydrake.systems.analysis import GetIntegrationSchemes

from feasigrasp.errors import CameraError, ScenarioError
from feasigrasp.models.choices import nearest
from feasigrasp.models.clouds.depth_noise import DepthNoise
from feasigrasp.models.control.joint.sources import Source
from feasigrasp.models.control.mode import ControlMode, ControlSpace, Law, Targets
from feasigrasp.models.grasps.samplers import SamplerName
from feasigrasp.models.reach.judge import JudgeMethod
from feasigrasp.models.reach.reachable_space import SpaceName
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.shape.completion import Preset
from feasigrasp.scenario.faults import check_faults
from feasigrasp.scenario.keys import general, members
from feasigrasp.scenario.presets import PRESETS
from feasigrasp.scenario.schema import Scenario

_SEED = (0, 2**32 - 1, "")
_TURN = (-3600.0, 3600.0, "deg")
_PLACE = (-10.0, 10.0, "m")

#: Least and greatest value of every number, and its unit; ``*`` is any name. Of a vector, of each
#: entry; of a key that may be left empty, where it is not. Beyond these a value is a slip of the
#: hand (a unit, a sign), or nothing that the cell could be run with.
LIMITS: dict[str, tuple[float, float, str]] = {
    "random_seed": _SEED,
    "simulation_duration": (0.001, 1e5, "s"),
    "q_start": (*np.rad2deg(IIWA_7.driver.position.max() * np.array([-1.0, 1.0])), "deg"),
    "object.scale": (1e-6, 1e6, ""),
    "object.mass": (0.001, 20.0, "kg"),
    "object.friction": (0.01, 10.0, ""),
    "object.rotation.deg": _TURN,
    "object.rotation.angle_deg": _TURN,
    "object.rotation.axis": (-1e3, 1e3, ""),
    "motion.center": (-2.0, 2.0, "m"),
    "motion.amplitude": (-2.0, 2.0, "m"),
    "motion.harmonic": (-100.0, 100.0, ""),
    "motion.offset_deg": _TURN,
    "motion.rate": (-20.0, 20.0, "rad/s"),
    "motion.start_phase": (-1e3, 1e3, "rad"),
    "motion.spin_axis": (-1e3, 1e3, ""),
    "motion.spin": (-20.0, 20.0, "rad/s"),
    "tracker.period": (1e-4, 1.0, "s"),
    "tracker.latency": (0.0, 2.0, "s"),
    "tracker.position_noise": (0.0, 0.1, "m"),
    "tracker.rotation_noise": (0.0, 1.0, "rad"),
    "tracker.dropout": (0.0, 1.0, ""),
    "tracker.silence": (0.01, 60.0, "s"),
    "tracker.jerk": (1e-4, 1e4, ""),
    "tracker.angular_jerk": (1e-4, 1e4, ""),
    "tracker.seed": _SEED,
    "perception.period": (0.01, 60.0, "s"),
    "perception.latency": (0.0, 10.0, "s"),
    "perception.max_points": (8, 4096, ""),
    "perception.length_scale": (0.001, 10.0, "m"),
    "perception.voxel_size": (5e-4, 0.05, "m"),
    "perception.views": (0, 10_000, ""),
    "perception.n_candidates": (1, 100_000, ""),
    "perception.n_grasps": (1, 10_000, ""),
    "scene.period": (0.01, 60.0, "s"),
    "scene.resolution": (0.001, 0.1, "m"),
    "scene.margin": (0.0, 0.2, "m"),
    "reachability.period": (0.001, 10.0, "s"),
    "reachability.horizon": (0.0, 30.0, "s"),
    "control.period": (5e-4, 0.05, "s"),
    "control.gain": (1e-9, 1000.0, "1/s"),
    "control.damping": (0.0, 1.0, ""),
    "control.length_scale": (0.0, 10.0, "rad"),
    "control.n_solutions": (1, 10_000, ""),
    "grasp.position_tolerance": (1e-4, 0.1, "m"),
    "grasp.angle_tolerance": (0.001, 3.15, "rad"),
    "grasp.dwell": (0.0, 60.0, "s"),
    "grasp.closing_speed": (0.001, 1.0, "m/s"),
    "grasp.squeeze_time": (0.01, 60.0, "s"),
    "grasp.min_width": (0.0, 0.2, "m"),
    "grasp.lift": (-1.0, 1.0, "m"),
    "grasp.lift_time": (0.01, 60.0, "s"),
    "grasp.shake": (-0.5, 0.5, "m"),
    "grasp.shake_frequency": (0.01, 20.0, "Hz"),
    "grasp.shake_time": (0.0, 60.0, "s"),
    "grasp.hold_time": (0.0, 600.0, "s"),
    "camera_noise.*.baseline": (0.001, 1.0, "m"),
    "camera_noise.*.subpixel": (0.0, 10.0, "px"),
    "camera_noise.*.disparity_step": (0.0, 10.0, "px"),
    "camera_noise.*.depth_step": (0.0, 0.1, "m"),
    "camera_noise.*.edge_disparity": (0.01, 1000.0, "px"),
    "camera_noise.*.flying": (0.0, 1.0, ""),
    "camera_noise.*.edge_missing": (0.0, 1.0, ""),
    "camera_noise.*.grazing_start_deg": (0.0, 180.0, "deg"),
    "camera_noise.*.grazing_end_deg": (0.0, 180.0, "deg"),
    "simulator_config.max_step_size": (1e-5, 1.0, "s"),
    "simulator_config.accuracy": (1e-10, 0.1, ""),
    "simulator_config.start_time": (0.0, 0.0, "s"),
    "simulator_config.target_realtime_rate": (0.0, 100.0, ""),
    "plant_config.time_step": (1e-5, 0.02, "s"),
    "plant_config.penetration_allowance": (1e-6, 0.1, "m"),
    "plant_config.stiction_tolerance": (1e-7, 0.1, "m/s"),
    "plant_config.sap_near_rigid_threshold": (0.0, 10.0, ""),
    "cameras.*.width": (16, 4096, "px"),
    "cameras.*.height": (16, 4096, "px"),
    "cameras.*.focal.x": (1.0, 1e5, "px or deg"),
    "cameras.*.focal.y": (1.0, 1e5, "px or deg"),
    "cameras.*.center_x": (0.0, 4096.0, "px"),
    "cameras.*.center_y": (0.0, 4096.0, "px"),
    "cameras.*.clipping_near": (0.001, 10.0, "m"),
    "cameras.*.clipping_far": (0.01, 1e4, "m"),
    "cameras.*.z_near": (0.001, 10.0, "m"),
    "cameras.*.z_far": (0.01, 100.0, "m"),
    "cameras.*.background.rgba": (0.0, 1.0, ""),
    "cameras.*.fps": (0.1, 1000.0, "Hz"),
    "cameras.*.capture_offset": (0.0, 10.0, "s"),
    "cameras.*.output_delay": (0.0, 10.0, "s"),
    **{
        f"cameras.*.{frame}.{key}": limits
        for frame in ("X_PB", "X_BC", "X_BD")
        for key, limits in (
            ("translation", _PLACE),
            ("rotation.deg", _TURN),
            ("rotation.angle_deg", _TURN),
            ("rotation.axis", (-1e3, 1e3, "")),
        )
    },
}

#: Renderers that Drake knows by their name; the empty word is its default.
_RENDERERS = ("", "RenderEngineVtk", "RenderEngineGl", "RenderEngineGltfClient")
#: Words that a key may be.
CHOICES: dict[str, Sequence[str]] = {
    "control.controller": tuple(ControlSpace),
    "control.mode": tuple(ControlMode),
    "control.law": tuple(Law),
    "control.targets": tuple(Targets),
    "control.source": tuple(Source),
    "perception.preset": tuple(Preset),
    "perception.sampler": tuple(SamplerName),
    "reachability.method": tuple(JudgeMethod),
    "reachability.space": tuple(SpaceName),
    "simulator_config.integration_scheme": GetIntegrationSchemes(),
    "plant_config.contact_model": ("point", "hydroelastic", "hydroelastic_with_fallback"),
    "plant_config.discrete_contact_approximation": ("tamsi", "sap", "similar", "lagged"),
    "plant_config.contact_surface_representation": ("triangle", "polygon"),
}

#: Numbers of which the first must be less.
_ORDERED = (
    ("clipping_near", "clipping_far"),
    ("z_near", "z_far"),
)
#: Numbers of which the first must not be greater.
_NOT_GREATER = (("clipping_near", "z_near"), ("z_far", "clipping_far"))


def check_scenario(scenario: Scenario) -> None:
    """Checks what the types of a scenario cannot say.

    Raises:
        ScenarioError: A value that nothing can run with; the message names key, value and mend.
    """
    _check_choices(scenario)
    _check_camera_noise(scenario)
    for path, index, value in numbers(scenario):
        if path[0] != "faults":  # each has a table of its own
            _check_number(path, index, value)
    check_faults(scenario.faults)
    _check_vectors(scenario)
    _check_cameras(scenario)
    _check_law(scenario)
    phase = scenario.motion.start_phase
    if not isinstance(phase, float | int) and phase.min > phase.max:
        raise ScenarioError(
            f"motion.start_phase has min {phase.min} above max {phase.max}; swap them"
        )


def numbers(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str, float]]:
    """Every number of a scenario: the names that lead to it, its index in a vector, its value.

    Words, switches and what is left empty are passed over.
    """
    if isinstance(value, bool | np.bool_):
        return
    if isinstance(value, int | float | np.number):
        yield path, "", float(value)
    elif isinstance(value, np.ndarray | list | tuple):
        for i, entry in enumerate(np.ravel(value) if isinstance(value, np.ndarray) else value):
            for names, index, number in numbers(entry, path):
                yield names, f"[{i}]{index}", number
    elif isinstance(value, dict):
        for name, entry in value.items():
            yield from numbers(entry, (*path, name))
    else:
        for name in members(type(value)):
            yield from numbers(getattr(value, name), (*path, name))


def _check_number(path: tuple[str, ...], index: str, value: float) -> None:
    shown = ".".join(path) + index
    low, high, unit = LIMITS.get(general(path), (-np.inf, np.inf, ""))
    if not np.isfinite(value):
        raise ScenarioError(f"{shown} is {value}; give a finite number{_range(low, high, unit)}")
    if not low <= value <= high:
        raise ScenarioError(f"{shown} is {value:.10g}; it must be{_range(low, high, unit)}")


def _range(low: float, high: float, unit: str) -> str:
    if not np.isfinite(high):
        return ""
    text = f"{low:.10g}" if low == high else f"from {low:.10g} to {high:.10g}"
    return f" {text} {unit}".rstrip()


def _check_choices(scenario: Scenario) -> None:
    for key, allowed in CHOICES.items():
        section, name = key.split(".")
        choice = getattr(getattr(scenario, section), name)
        if choice not in allowed:
            raise ScenarioError(
                f"{key} is {choice!r}; choose one of {', '.join(allowed)}{nearest(choice, allowed)}"
            )


def _check_cameras(scenario: Scenario) -> None:
    looking = scenario.perception.camera
    if looking not in scenario.cameras:
        raise ScenarioError(
            f"perception.camera is {looking!r}, but cameras has "
            f"{', '.join(scenario.cameras) or 'none'}{nearest(looking, scenario.cameras)}"
        )
    for image in ("depth", "label"):
        if not getattr(scenario.cameras[looking], image):
            raise ScenarioError(
                f"cameras.{looking}.{image} is false, but perception.camera needs it; make it true"
            )
    for name, camera in scenario.cameras.items():
        for pairs, verb in ((_ORDERED, "less than"), (_NOT_GREATER, "at most")):
            for low, high in pairs:
                small, great = getattr(camera, low), getattr(camera, high)
                if not (small < great or (small == great and verb == "at most")):
                    raise ScenarioError(
                        f"cameras.{name}.{low} is {small}; it must be {verb} {high}, {great} m"
                    )
        _check_focal(name, camera.focal)
        renderer = camera.renderer_class
        if isinstance(renderer, str) and renderer not in _RENDERERS:
            raise ScenarioError(
                f"cameras.{name}.renderer_class is {renderer!r}; choose one of "
                f"{', '.join(filter(None, _RENDERERS))}{nearest(renderer, _RENDERERS)}"
            )


def _check_focal(name: str, focal: Any) -> None:
    for axis in ("x", "y"):
        angle = getattr(focal, axis)
        if type(focal).__name__ == "FovDegrees" and angle is not None and angle >= 180.0:
            raise ScenarioError(f"cameras.{name}.focal.{axis} is {angle}; give less than 180 deg")
    if focal.x is None and focal.y is None:
        raise ScenarioError(f"cameras.{name}.focal is empty; give x, y or both")


def _check_law(scenario: Scenario) -> None:
    """What is drawn anew has a source; in task space the law of ``safe`` mode is what it is."""
    config = scenario.control
    if config.resample and config.source == Source.CLOSED_FORM:
        raise ScenarioError(
            "control.resample is true, but closed_form draws nothing; give control.source: flow or "
            "dls"
        )
    if not config.safe or config.controller == ControlSpace.JOINT:
        return
    for name in ("law", "damping", "feed_forward", "targets"):
        value, ours = getattr(config, name), PRESETS[f"control.{name}"][0]
        if value != ours:
            raise ScenarioError(
                f"control.{name} is {value} in task space, where safe mode has {ours}; give "
                "control.mode: corrected or paper"
            )


def _check_camera_noise(scenario: Scenario) -> None:
    known = [field.name for field in dc.fields(DepthNoise)]
    for name, changes in scenario.camera_noise.items():
        if name not in scenario.cameras:
            raise ScenarioError(
                f"camera_noise names {name!r}, but cameras has "
                f"{', '.join(scenario.cameras) or 'none'}{nearest(name, scenario.cameras)}"
            )
        unknown = [key for key in changes if key not in known]
        if unknown:
            raise ScenarioError(
                f"camera_noise.{name} has {', '.join(unknown)}; it may have {', '.join(known)}"
                f"{nearest(unknown[0], known)}"
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
        "grasp.shake": (scenario.grasp.shake, 3),
        "q_start": (scenario.q_start, IIWA_7.joints),
    }
    for key, (value, size) in vectors.items():
        if len(value) != size:
            what = "x, y and z" if size == 3 else f"one per joint of the iiwa, {size}"
            raise ScenarioError(f"{key} has {len(value)} entries; give {what}")
    if not np.any(motion.spin_axis):
        raise ScenarioError("motion.spin_axis is zero; give an axis, and spin: 0 for no rotation")
    axis = getattr(scenario.object.rotation, "axis", None)
    if isinstance(axis, np.ndarray) and not axis.any():
        raise ScenarioError("object.rotation.axis is zero; give an axis, or angle_deg: 0 along any")
    limits = np.rad2deg(IIWA_7.driver.position)
    for i, (angle, limit) in enumerate(zip(scenario.q_start, limits, strict=True)):
        if abs(angle) > limit:
            raise ScenarioError(
                f"q_start[{i}] is {angle:g}; the driver of the arm takes joint {i + 1} from "
                f"-{limit:g} to {limit:g} deg"
            )
