"""Checks of the cameras of a scenario: keys of Drake's ``CameraConfig``."""

from typing import Any

from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import nearest, parse_word
from feasigrasp.models.objects.tracking import TrackerKind
from feasigrasp.scenario.schema import Scenario, Segmentation

#: Pairs of numbers, and what the first must be.
_ORDERED = (
    *(("clipping_near", "less than", "clipping_far"), ("z_near", "less than", "z_far")),
    *(("clipping_near", "at most", "z_near"), ("z_far", "at most", "clipping_far")),
)
#: Keys that would do nothing, and how to mend it.
_WITHOUT_EFFECT = {
    "show_rgb": "no window shows images; leave it out, and see them with --replay FILE.html",
    "lcm_bus": "there is one bus for all messages, see docs/hardware.md; leave it out",
}


def check_cameras(scenario: Scenario) -> None:
    """Checks the cameras beyond the ranges of their numbers; as `check_scenario`."""
    looking = scenario.perception.camera
    if looking not in scenario.cameras:
        raise ScenarioError(
            f"perception.camera is {looking!r}, but cameras has "
            f"{', '.join(scenario.cameras) or 'none; give one, or based_on: ReachLinear'}"
            f"{nearest(looking, scenario.cameras)}"
        )
    _check_second_camera(scenario)
    for name, camera in scenario.cameras.items():
        _check_effect(name, camera)
        for low, verb, high in _ORDERED:
            small, great = getattr(camera, low), getattr(camera, high)
            if not (small < great or (small == great and verb == "at most")):
                raise ScenarioError(
                    f"cameras.{name}.{low} is {small}; it must be {verb} {high}, {great} m"
                )
        _check_focal(name, camera.focal)
        renderer = camera.renderer_class
        if not isinstance(renderer, str):
            renderer = type(renderer).__name__.removesuffix("Params")
        if renderer:  # else it is Drake's default; these are those that need no server
            known = ("RenderEngineVtk", "RenderEngineGl")
            parse_word(known, renderer, f"cameras.{name}.renderer_class", ScenarioError)


def _check_effect(name: str, camera: CameraConfig) -> None:
    """Refuses what a camera here does not do."""
    where = f"cameras.{name}"
    if not (camera.rgb or camera.depth or camera.label):
        raise ScenarioError(
            f"{where} has neither rgb nor depth nor label, so that Drake leaves it out, "
            "with its point cloud and pose; give one of them true"
        )
    for key, mend in _WITHOUT_EFFECT.items():
        if getattr(camera, key) != getattr(CameraConfig(), key):
            raise ScenarioError(f"{where}.{key} is {getattr(camera, key)!r}; {mend}")
    if camera.name not in (name, CameraConfig().name):
        raise ScenarioError(
            f"{where}.name is {camera.name!r}; a camera is called as its entry in cameras: rename "
            "that, and leave this out"
        )
    for key, what in (("X_BC", "color"), ("X_BD", "depth")):
        X = RigidTransform(getattr(camera, key).GetDeterministicValue())
        if getattr(camera, key).base_frame or not X.IsExactlyIdentity():
            raise ScenarioError(
                f"{where}.{key} moves the {what} image against the others; leave it out, and give "
                "the pose of the depth image as X_PB"
            )


def _check_second_camera(scenario: Scenario) -> None:
    config, second = scenario.perception, scenario.perception.second_camera
    if not second:
        return
    others = [name for name in scenario.cameras if name != config.camera]
    if second not in others:
        raise ScenarioError(
            f"perception.second_camera is {second!r}, but beside perception.camera cameras has "
            f"{', '.join(others) or 'none'}{nearest(second, others)}"
        )
    by_depth = config.segmentation == Segmentation.DEPTH
    if scenario.tracker.kind != TrackerKind.CAMERA or not by_depth:
        raise ScenarioError(
            f"perception.second_camera is {second!r}, but the object is not tracked in images; "
            "give tracker: {kind: camera} and perception: {segmentation: depth}, or leave it out"
        )
    for key in ("output_delay", "capture_offset"):  # images of both are of one instant
        first, other = (getattr(scenario.cameras[name], key) for name in (config.camera, second))
        if first != other:
            raise ScenarioError(
                f"cameras.{second}.{key} is {other}; give {first}, that of {config.camera}"
            )


def _check_focal(name: str, focal: Any) -> None:
    for axis in ("x", "y"):
        angle = getattr(focal, axis)
        if type(focal).__name__ == "FovDegrees" and angle is not None and angle >= 180.0:
            raise ScenarioError(f"cameras.{name}.focal.{axis} is {angle}; give less than 180 deg")
    if focal.x is None and focal.y is None:
        raise ScenarioError(f"cameras.{name}.focal is empty; give x, y or both")
