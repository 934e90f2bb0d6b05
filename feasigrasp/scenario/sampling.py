"""What a scenario stands for, with everything random drawn from its seed."""

from pydrake.common import RandomGenerator
from pydrake.common.schema import Sample, Transform

from feasigrasp.models.clouds.depth_noise import DepthNoise
from feasigrasp.models.faults.object import ObjectMotion, altered
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.rigid_object import RigidObject, load_object
from feasigrasp.scenario.schema import Scenario


def make_camera_noise(scenario: Scenario) -> dict[str, DepthNoise]:
    """The errors of the scenario's depth cameras, by camera; none for a camera that sees truly."""
    return {name: DepthNoise(**changes) for name, changes in scenario.camera_noise.items()}


def load_scenario_object(scenario: Scenario) -> RigidObject:
    """The object that a scenario names, built-in or from a mesh file."""
    config = scenario.object
    return load_object(config.model, scale=config.scale, mass=config.mass)


def make_motion(scenario: Scenario) -> ObjectMotion:
    """The object's motion, with everything random drawn from the scenario's seed.

    Faults of the object alter it.
    """
    generator = RandomGenerator(scenario.random_seed)
    start_phase = Sample(scenario.motion.start_phase, generator)
    orientation = Transform()
    orientation.rotation = scenario.object.rotation
    R_WO = orientation.Sample(generator).rotation().matrix()
    drawn = {"start_phase": start_phase, "R_WO": R_WO}
    return altered(HarmonicMotion(**vars(scenario.motion) | drawn), scenario.faults)
