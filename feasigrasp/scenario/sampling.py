"""What a scenario stands for, with everything random drawn from its seed."""

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.common.schema import Sample, Transform

from feasigrasp.models.clouds.depth_noise import DepthNoise
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.scenario.schema import Scenario


def make_camera_noise(scenario: Scenario) -> dict[str, DepthNoise]:
    """The errors of the scenario's depth cameras, by camera; none for a camera that sees truly."""
    return {name: DepthNoise(**changes) for name, changes in scenario.camera_noise.items()}


def make_motion(scenario: Scenario) -> HarmonicMotion:
    """The object's motion, with everything random drawn from the scenario's seed."""
    generator = RandomGenerator(scenario.random_seed)
    config = scenario.motion
    start_phase = Sample(config.start_phase, generator)
    orientation = Transform()
    orientation.rotation = scenario.object.rotation
    R_WO = orientation.Sample(generator).rotation().matrix()
    return HarmonicMotion(
        center=np.asarray(config.center, dtype=float),
        amplitude=np.asarray(config.amplitude, dtype=float),
        harmonic=np.asarray(config.harmonic, dtype=float),
        offset_deg=np.asarray(config.offset_deg, dtype=float),
        rate=config.rate,
        start_phase=start_phase,
        spin_axis=np.asarray(config.spin_axis, dtype=float),
        spin=config.spin,
        R_WO=R_WO,
    )
