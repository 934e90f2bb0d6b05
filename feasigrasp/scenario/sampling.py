"""Sampling of a scenario: random values drawn from its seed."""

import dataclasses
import math
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.common.schema import Sample, Transform, Uniform
from scipy.spatial.transform import Rotation

from feasigrasp.errors import MeshError, ScenarioError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import parse_word
from feasigrasp.models.faults.object import altered
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.distractor_bodies import (
    CarrierKind,
    DistractorBody,
    make_carrier,
    make_distractor,
)
from feasigrasp.models.objects.mesh import read_surface
from feasigrasp.models.objects.motion import BezierMotion, HarmonicMotion, ObjectMotion, bezier_legs
from feasigrasp.models.objects.rigid_object import RigidObject, load_object
from feasigrasp.models.objects.static_obstacles import StaticObstacle
from feasigrasp.models.sensors.camera_errors import MATERIALS, HandEyeError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.scenario.cell import BoxConfig, MeshConfig
from feasigrasp.scenario.parts import Part, make_named
from feasigrasp.scenario.schema import BezierPath, Scenario


class _Stream(IntEnum):
    """Streams of random numbers of one seed."""

    PLACE = 1
    HAND = 3
    FRICTION = 4


def make_camera_noise(scenario: Scenario) -> dict[str, DepthNoise]:
    """The errors of the scenario's depth cameras, by camera; none for a camera that sees truly."""
    factor = scenario.sensors.error_factor
    return {n: camera_errors(x)[0].scaled(factor) for n, x in scenario.camera_noise.items()}


def make_hand_eye(scenario: Scenario) -> dict[str, HandEyeError]:
    """Hand-eye calibration errors by camera."""
    factor = scenario.sensors.error_factor
    errors = {n: camera_errors(x)[1].scaled(factor) for n, x in scenario.camera_noise.items()}
    return {name: error for name, error in errors.items() if error != HandEyeError()}


def camera_errors(entry: dict[str, float]) -> tuple[DepthNoise, HandEyeError]:
    """An entry of ``camera_noise``, each key for what it is an error of; values are checked."""
    of_pose = {field.name for field in dataclasses.fields(HandEyeError)}
    depth = {key: value for key, value in entry.items() if key not in of_pose}
    pose = {key: value for key, value in entry.items() if key in of_pose}
    return DepthNoise(**depth), HandEyeError(**pose)


def load_scenario_object(scenario: Scenario) -> RigidObject:
    """The object that a scenario names, built-in or from a mesh file."""
    config = scenario.object
    obj = load_object(config.model, scale=config.scale, mass=config.mass)
    factor, where = config.mass_factor, f"material of {config.model} (objects.json)"
    material = parse_word(MATERIALS, config.material or obj.material, where, MeshError)
    mass, inertia = factor * obj.mass, factor * obj.inertia
    return dataclasses.replace(obj, mass=mass, inertia=inertia, material=material)


def make_friction(scenario: Scenario) -> float:
    """Coulomb friction between gripper and object; a range is drawn from the seed."""
    friction = scenario.object.friction
    if isinstance(friction, Uniform):
        rng = np.random.default_rng([scenario.random_seed, _Stream.FRICTION])
        return float(rng.uniform(friction.min, friction.max))
    return float(friction)


def make_static_obstacles(scenario: Scenario) -> list[StaticObstacle]:
    """The boxes and meshes of the cell; a MeshError for a mesh that is flat, or not there."""
    cell = scenario.cell

    def pose(body: BoxConfig | MeshConfig) -> Array:
        R = Rotation.from_euler("xyz", body.rpy_deg, degrees=True).as_matrix()
        return se3.make_pose(R, np.array(body.position, dtype=float))

    boxes = [StaticObstacle.box(name, box.size, pose(box)) for name, box in cell.boxes.items()]
    meshes = [
        StaticObstacle(name, read_surface(Path(mesh.file), mesh.scale), pose(mesh))
        for name, mesh in cell.meshes.items()
    ]
    return boxes + meshes


def make_hand_error(scenario: Scenario) -> Array:
    """True pose of the hand in its nominal frame, with the errors of execution.

    Returns:
        Shape (4, 4) [m]; directions are drawn from the seed, sizes are those of the scenario.
    """
    config = scenario.execution
    axes = np.random.default_rng([scenario.random_seed, _Stream.HAND]).normal(size=(2, 3))
    along, about = axes / np.linalg.norm(axes, axis=1)[:, None]
    return se3.make_pose(se3.so3_exp(config.angle_error * about), config.position_error * along)


@checked(ScenarioError)
def make_motion(scenario: Scenario) -> ObjectMotion:
    """The object's motion, with everything random drawn from the scenario's seed.

    One of one's own is made of it; faults of the object alter it.

    Raises:
        ScenarioError: The part that the scenario names cannot be made, or is no motion.
    """
    config, seed = scenario.motion, scenario.random_seed
    generator = RandomGenerator(seed)
    phase = 0.0 if isinstance(config, BezierPath) else Sample(config.start_phase, generator)
    orientation = Transform()
    orientation.rotation = scenario.object.rotation
    R_WO = orientation.Sample(generator).rotation().matrix()
    values = vars(config) | {"center": _center(scenario)}
    motion: ObjectMotion
    if isinstance(config, BezierPath):
        rng = np.random.default_rng([seed, _Stream.PLACE])
        legs = bezier_legs(rng, values.pop("center"), np.array(values.pop("size")))
        motion = BezierMotion(legs, **values, R_WO=R_WO)
    else:
        del values["spread"]
        motion = HarmonicMotion(**values | {"start_phase": phase, "R_WO": R_WO})
    if own := scenario.parts.get(Part.MOTION):
        motion = _checked(make_named(Part.MOTION, own, motion), own.name)
    return altered(motion, scenario.faults)


def _center(scenario: Scenario) -> Array:
    """Centre of the object's path, as it is drawn [m]."""
    rng = np.random.default_rng([scenario.random_seed, _Stream.PLACE])
    spread = getattr(scenario.motion, "spread", np.zeros(3))
    return np.array(scenario.motion.center) + rng.uniform(-1.0, 1.0, 3) * spread


def _checked(motion: Any, name: str) -> ObjectMotion:
    """A motion of one's own, if its state is one."""
    where = f"parts.{Part.MOTION}: {name}"
    if not isinstance(motion, ObjectMotion):
        raise ScenarioError(f"{where} makes a {type(motion).__name__}; derive from ObjectMotion")
    state = motion.state(0.0)
    shapes = [np.shape(each) for each in state]
    if shapes != [(4, 4), (6,), (3,)] or not all(np.isfinite(each).all() for each in state):
        raise ScenarioError(
            f"{where}: its state at 0 s has the shapes {shapes}, or is not finite; give X_WO "
            "(4, 4), V_WO (6,) [angular; linear] and the acceleration (3,)"
        )
    return motion


def make_distractor_bodies(
    scenario: Scenario, obj: RigidObject, motion: ObjectMotion
) -> list[DistractorBody]:
    """Carrier and distractor of a scenario."""
    bodies: list[DistractorBody] = []
    kind, distractor = CarrierKind(scenario.carrier.kind), scenario.distractor
    if kind is not CarrierKind.NONE:
        bodies.append(make_carrier(kind, obj, motion, scenario.carrier.hue))
    if distractor.model:
        other = load_object(distractor.model)
        middle = np.zeros(3) if distractor.moving else _center(scenario)
        offset = middle + distractor.offset
        bodies.append(make_distractor(other, motion, offset, distractor.moving))
    return bodies


def largest_speed(scenario: Scenario) -> float:
    """The object's largest speed along its path, over a lap or over the run if there is none."""
    motion, end = make_motion(scenario), lap(scenario)
    times = np.linspace(0.0, end if math.isfinite(end) else scenario.simulation_duration, 2000)
    return max(float(np.linalg.norm(motion.velocity(t)[3:])) for t in times)


def lap(scenario: Scenario) -> float:
    """Period of the object's path [s]; infinite without one."""
    rate = 0.0 if isinstance(scenario.motion, BezierPath) else scenario.motion.rate
    return 2.0 * math.pi / abs(rate) if rate else math.inf
