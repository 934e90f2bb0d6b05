"""Checks of the cameras of a scenario: keys of Drake's ``CameraConfig``."""

from typing import Any

from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import nearest
from feasigrasp.models.objects.tracker_config import TrackerKind
from feasigrasp.scenario.schema import Scenario, Segmentation

#: Names of Drake's renderers that need no server; the empty word is its default.
_RENDERERS = ("", "RenderEngineVtk", "RenderEngineGl")
#: Numbers of which the first must be less.
_ORDERED = (("clipping_near", "clipping_far"), ("z_near", "z_far"))
#: Numbers of which the first must not be greater.
_NOT_GREATER = (("clipping_near", "z_near"), ("z_far", "clipping_far"))
#: Keys that would do nothing, and how to mend it.
_WITHOUT_EFFECT = {
    "show_rgb": "no window shows images; leave it out, and see them with --replay FILE.html",
    "lcm_bus": "there is one bus for all messages, see docs/hardware.md; leave it out",
}


def check_cameras(scenario: Scenario) -> None:
    """Checks the cameras beyond the ranges of their numbers.

    Raises:
        ScenarioError: A value that nothing can run with, or a key that would do nothing.
    """
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
        for pairs, verb in ((_ORDERED, "less than"), (_NOT_GREATER, "at most")):
            for low, high in pairs:
                small, great = getattr(camera, low), getattr(camera, high)
                if not (small < great or (small == great and verb == "at most")):
                    raise ScenarioError(
                        f"cameras.{name}.{low} is {small}; it must be {verb} {high}, {great} m"
                    )
        _check_focal(name, camera.focal)
        renderer = camera.renderer_class
        if not isinstance(renderer, str):
            renderer = type(renderer).__name__.removesuffix("Params")
        if renderer not in _RENDERERS:
            raise ScenarioError(
                f"cameras.{name}.renderer_class is {renderer!r}; choose one of "
                f"{', '.join(filter(None, _RENDERERS))}{nearest(renderer, _RENDERERS)}"
            )


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
    config = scenario.perception
    second = config.second_camera
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
