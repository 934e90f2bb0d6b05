"""Checks of scenario values: each by its field, and conditions between keys."""

import dataclasses as dc
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from feasigrasp.errors import CameraError, GraspError, ScenarioError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.choices import ControlSpace, Span, metadata_of, nearest, parse_word
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.sensors.camera_errors import HandEyeError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.plugins import plugins
from feasigrasp.scenario.cameras import check_cameras
from feasigrasp.scenario.faults import check_faults
from feasigrasp.scenario.keys import SPANS, WORDS, general, members
from feasigrasp.scenario.modes import added_mode
from feasigrasp.scenario.parts import Part, check_parts
from feasigrasp.scenario.sampling import camera_errors
from feasigrasp.scenario.schema import EXACT, ControlConfig, Scenario, Segmentation

#: What the entries of ``camera_noise`` may be.
_NOISE = metadata_of(DepthNoise) | metadata_of(HandEyeError)


def check_scenario(scenario: Scenario) -> None:
    """Checks the values of a scenario beyond their types.

    Raises:
        ScenarioError: A value that nothing can run with; the message names key, value and mend.
    """
    _check_choices(scenario)
    _check_camera_noise(scenario)
    for path, index, value, span in numbers(scenario):
        # Each fault has a table of its own; a part checks its own options.
        if path[0] not in ("faults", "parts"):
            _check_number(path, index, value, span)
    _check_robot(scenario)
    _check_cell(scenario)
    check_parts(scenario.parts)
    check_segmentation(scenario, own=Part.SEGMENTATION in scenario.parts)
    check_faults(scenario.faults)
    _check_steps(scenario)
    _check_vectors(scenario)
    check_cameras(scenario)
    _check_distractor_bodies(scenario)
    _check_law(scenario)
    _check_standoff(scenario)
    phase = getattr(scenario.motion, "start_phase", 0.0)
    ranges = {"motion.start_phase": phase, "object.friction": scenario.object.friction}
    for name, drawn in ranges.items():
        if not isinstance(drawn, float | int) and drawn.min > drawn.max:
            raise ScenarioError(f"{name} has min {drawn.min} above max {drawn.max}; swap them")


def check_types_too(scenario: Scenario) -> None:
    """Checks a scenario of which values may have been set since it was read, types as well."""
    for section in (scenario, *vars(scenario).values()):
        if dc.is_dataclass(section):
            check_fields(section, ScenarioError)
    check_scenario(scenario)


def _check_robot(scenario: Scenario) -> None:
    control, method = scenario.control, scenario.reachability.method
    general = control.safe and control.controller in [*ControlSpace] and method == EXACT
    if load_arm(scenario.arm) is not IIWA_7 and not general:
        raise ScenarioError(
            f"arm is {scenario.arm}, but this mode, controller or method is made for the iiwa 7; "
            "give control: {mode: safe, controller: task} and reachability: {method: ik}"
        )
    try:
        load_gripper(scenario.gripper)
    except GraspError as error:
        raise ScenarioError(str(error)) from error


def _check_cell(scenario: Scenario) -> None:
    """Obstacles have names that are free, and a file if they are meshes."""
    names = [*scenario.cell.boxes, *scenario.cell.meshes]
    for name in names:
        if not (isinstance(name, str) and re.fullmatch(r"[A-Za-z]\w*", name)):
            raise ScenarioError(f"cell has the obstacle {name!r}; give letters, digits and _")
        taken = ("iiwa", "gripper", "camera", "table", "object", "world")  # models of the cell
        if name in taken or names.count(name) > 1:
            raise ScenarioError(f"cell has the obstacle {name!r}; that name is taken, give another")
    for name, mesh in scenario.cell.meshes.items():
        if not mesh.file:
            raise ScenarioError(f"cell.meshes.{name}.file is empty; give the mesh's file")


def _check_steps(scenario: Scenario) -> None:
    """Between two steps of the physics nothing moves, so that ticks between them see old states.

    With 2 ms and ticks every 5 ms every second one would be 1 ms late, and a velocity that is taken
    from poses alternate by a tenth.
    """
    if getattr(scenario.simulator_config, "publish_every_time_step", False):
        raise ScenarioError("simulator_config.publish_every_time_step doubles samples; omit it")
    period, step = scenario.control.period, scenario.plant_config.time_step
    steps = max(1, math.ceil(period / step - 1e-6))
    if abs(steps * step - period) > 1e-6 * period:
        raise ScenarioError(
            f"plant_config.time_step: {step:g} s does not divide control.period, {period:g} s; "
            f"give {period / steps:.9g}"
        )


def numbers(
    value: Any, path: tuple[str, ...] = (), span: Span | None = None
) -> Iterator[tuple[tuple[str, ...], str, float, Span | None]]:
    """Every number of a scenario: the names that lead to it, its index in a vector, value and span.

    The span is None where none is stated. Words, switches and what is left empty are passed over.
    """
    if isinstance(value, bool | np.bool_):
        return
    if isinstance(value, int | float | np.number):
        yield path, "", float(value), span or SPANS.get(general(path))
    elif isinstance(value, np.ndarray | list | tuple):
        for i, entry in enumerate(np.ravel(value) if isinstance(value, np.ndarray) else value):
            for names, index, number, of in numbers(entry, path, span):
                yield names, f"[{i}]{index}", number, of
    elif isinstance(value, dict):
        stated = _NOISE if path[:1] == ("camera_noise",) else {}
        for name, entry in value.items():
            yield from numbers(entry, (*path, name), stated.get(name, {}).get("span"))
    else:
        stated = metadata_of(type(value))
        for name in members(type(value)):
            of = stated.get(name, {}).get("span", span)
            yield from numbers(getattr(value, name), (*path, name), of)


def _check_number(path: tuple[str, ...], index: str, value: float, span: Span | None) -> None:
    shown = ".".join(map(str, path)) + index
    low, high, unit = span or Span()
    text = f" {low:.10g} {unit}" if low == high else f" from {low:.10g} to {high:.10g} {unit}"
    text = text.rstrip() if np.isfinite(high) else ""
    if not np.isfinite(value):
        raise ScenarioError(f"{shown} is {value}; give a finite number{text}")
    if not low <= value <= high:
        raise ScenarioError(f"{shown} is {value:.10g}; it must be{text}")


def words(scenario: Scenario) -> dict[str, Sequence[str]]:
    """The words that each key of a section may be, by ``section.name``."""
    return WORDS | {
        f"{section}.{name}": stated["words"]
        for section, value in vars(scenario).items()
        for name, stated in metadata_of(type(value)).items()
        if "words" in stated
    }


def _check_choices(scenario: Scenario) -> None:
    for key, allowed in words(scenario).items():
        section, name = key.split(".")
        parse_word(allowed, getattr(getattr(scenario, section), name), key, ScenarioError)


def check_segmentation(scenario: Scenario, *, own: bool) -> None:
    """Raises a ScenarioError if a custom segmentation has no place in the diagram."""
    if own and scenario.perception.segmentation != Segmentation.DEPTH:
        raise ScenarioError(
            "parts.segmentation is not used while perception.segmentation is labels; give "
            "perception: {segmentation: depth}, whose place it takes"
        )


def _check_distractor_bodies(scenario: Scenario) -> None:
    """Color gate and distractor: the gate needs depth segmentation, the distractor a distance."""
    hue, distractor = scenario.carrier.hue, scenario.distractor
    if hue is not None and scenario.perception.segmentation != Segmentation.DEPTH:
        raise ScenarioError(
            f"carrier.hue is {hue:g}, but the label image already labels the carrier; give "
            "perception: {segmentation: depth}, or leave it out"
        )
    if distractor.model and distractor.moving and not np.any(distractor.offset):
        raise ScenarioError(
            "distractor.offset is zero, so that it would be in the object; give how far it is off"
        )


def _check_law(scenario: Scenario) -> None:
    """Only ``safe`` mode plans and is slowed down; settings are for parts that packages add."""
    config, reach = scenario.control, scenario.reachability
    if not config.density and config.controller not in [*ControlSpace]:
        raise ScenarioError(
            f"control.density is False, but controller {config.controller} has no density of "
            f"grasps; give control.controller: {' or '.join(ControlSpace)}"
        )
    if (mode := added_mode(config.mode)) is not None:
        if config.speed != 1.0:
            raise ScenarioError(
                f"control.speed is {config.speed:g}, but mode {config.mode} enforces no limit; "
                "give control.mode: safe, or control.speed: 1"
            )
        for name in ("density", "score", "prediction"):
            if (value := getattr(config, name)) != getattr(ControlConfig(), name):
                raise ScenarioError(
                    f"control.{name} is {value}, but only safe mode plans; give control.mode: safe"
                )
        mode.check(scenario)
        return
    if config.options and config.controller in [*ControlSpace]:
        raise ScenarioError(
            f"control.options has {', '.join(map(str, config.options))}, but controller "
            f"{config.controller} takes none in safe mode; give control.mode: "
            f"{' or '.join(plugins('modes'))}"
        )
    if reach.options and reach.method == EXACT:
        raise ScenarioError(
            f"reachability.options has {', '.join(map(str, reach.options))}, but "
            f"method {EXACT} takes none; give reachability.method: {' or '.join(plugins('judges'))}"
        )


def _check_standoff(scenario: Scenario) -> None:
    """A hand that waits behind a grasp never closes; only ours that plan know how to."""
    grasp, config = scenario.grasp, scenario.control
    if grasp.standoff == 0.0:
        return
    if grasp.close:
        raise ScenarioError(
            f"grasp.standoff is {grasp.standoff:g} m, but grasp.close is true: the hand would "
            "never be where it closes; give grasp.close: false"
        )
    if not config.safe or config.controller not in (ControlSpace.TASK, ControlSpace.JOINT):
        raise ScenarioError(
            f"grasp.standoff is {grasp.standoff:g} m, which only the controllers task and joint "
            "keep in safe mode; give control.controller: task and control.mode: safe, or 0"
        )


def _check_camera_noise(scenario: Scenario) -> None:
    for name, changes in scenario.camera_noise.items():
        if name not in scenario.cameras:
            raise ScenarioError(
                f"camera_noise names {name!r}, but cameras has "
                f"{', '.join(scenario.cameras) or 'none'}{nearest(name, scenario.cameras)}"
            )
        if unknown := [str(key) for key in changes if key not in _NOISE]:
            raise ScenarioError(
                f"camera_noise.{name} has {', '.join(unknown)}; it may have {', '.join(_NOISE)}"
                f"{nearest(unknown[0], _NOISE)}"
            )
        try:
            camera_errors(changes)
        except CameraError as error:
            raise ScenarioError(f"camera_noise.{name}: {error}") from error


def _check_vectors(scenario: Scenario) -> None:
    cell, motion, arm = scenario.cell, scenario.motion, load_arm(scenario.arm)
    parts: dict[str, Any] = {
        "motion": motion,
        "distractor": scenario.distractor,
        "grasp": scenario.grasp,
    }
    parts |= {f"cell.boxes.{name}": box for name, box in cell.boxes.items()}
    parts |= {f"cell.meshes.{name}": mesh for name, mesh in cell.meshes.items()}
    for part, section in parts.items():
        for key, value in vars(section).items():
            if isinstance(value, list) and len(value) != 3:
                raise ScenarioError(f"{part}.{key} has {len(value)} entries; give x, y and z")
    if (given := len(scenario.q_start)) not in (0, arm.joints):
        what = f"give one per joint of the arm, {arm.joints}"
        raise ScenarioError(f"q_start has {given} entries; {what}")
    if not np.any(motion.spin_axis):
        raise ScenarioError("motion.spin_axis is zero; give an axis, and spin: 0 for no rotation")
    axis = getattr(scenario.object.rotation, "axis", None)
    if isinstance(axis, np.ndarray) and not axis.any():
        raise ScenarioError("object.rotation.axis is zero; give an axis, or angle_deg: 0 along any")
    lower, upper = np.rad2deg(arm.driver.lower), np.rad2deg(arm.driver.upper)
    for i, (angle, low, high) in enumerate(zip(scenario.q_start, lower, upper, strict=False)):
        if not low <= angle <= high:
            raise ScenarioError(
                f"q_start[{i}] is {angle:g}; the driver of the arm takes joint {i + 1} from "
                f"{low:g} to {high:g} deg"
            )
    model = capsule_model(load_gripper(scenario.gripper), arm)
    ends = model.placed(scenario.start)
    along = ends[:, :1] + np.linspace(0.0, 1.0, 17)[:, None] * (ends[:, 1:] - ends[:, :1])
    i, j = model.pairs.T
    apart = np.linalg.norm(along[i][:, :, None] - along[j][:, None], axis=-1).min(axis=(1, 2))
    lowest = np.min(ends[model.movers, :, 2] - model.radius[model.movers, None])
    if np.any(apart < model.radius[i] + model.radius[j]) or lowest < cell.table_height:
        raise ScenarioError(
            "q_start: the arm starts in itself or in the table; give joints that are clear of both"
        )
