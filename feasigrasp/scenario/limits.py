"""What every key of a scenario may be: one table of ranges, one of words.

A key of the schema that holds a number has a line in `LIMITS`; a test fails for one that has none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.analysis import GetIntegrationSchemes

from feasigrasp.models.control.mode import controller_names, mode_names
from feasigrasp.models.control.planning.predicted_poses import PredictionModel
from feasigrasp.models.grasps.samplers import sampler_names
from feasigrasp.models.objects.carriers import CarrierKind
from feasigrasp.models.objects.tracker_config import TrackerKind
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.shape.completion import Preset
from feasigrasp.plugins import plugins
from feasigrasp.scenario.schema import CLOSED_FORM, EXACT, Execution, Segmentation

_SEED = (0, 2**32 - 1, "")
_TURN = (-3600.0, 3600.0, "deg")
_PLACE = (-10.0, 10.0, "m")

#: Least and greatest value of every number, and its unit; ``*`` is any name. Of a vector, of each
#: entry; of a key that may be left empty, where it is not. Beyond these a value is a slip of the
#: hand (a unit, a sign), or nothing that the cell could be run with.
LIMITS: dict[str, tuple[float, float, str]] = {
    "random_seed": _SEED,
    "simulation_duration": (0.001, 1e5, "s"),
    "cell.table_height": (-1.0, 0.1, "m"),
    "cell.table_clearance": (0.0, 0.2, "m"),
    "cell.boxes.*.size": (0.001, 10.0, "m"),
    "cell.meshes.*.scale": (1e-6, 1e6, ""),
    **{
        f"cell.{kind}.*.{key}": limits
        for kind in ("boxes", "meshes")
        for key, limits in (("position", _PLACE), ("rpy_deg", _TURN))
    },
    "q_start": (*np.rad2deg(IIWA_7.driver.position.max() * np.array([-1.0, 1.0])), "deg"),
    "object.scale": (1e-6, 1e6, ""),
    "object.mass": (0.001, 20.0, "kg"),
    "object.mass_factor": (0.01, 100.0, ""),
    "object.friction": (0.01, 100.0, ""),
    "object.rotation.deg": _TURN,
    "object.rotation.angle_deg": _TURN,
    "object.rotation.axis": (-1e3, 1e3, ""),
    "motion.center": (-2.0, 2.0, "m"),
    "motion.spread": (0.0, 2.0, "m"),
    "motion.size": (0.01, 2.0, "m"),
    "motion.speed": (0.001, 5.0, "m/s"),
    "motion.stop": (0.0, 60.0, "s"),
    "motion.amplitude": (-2.0, 2.0, "m"),
    "motion.harmonic": (-100.0, 100.0, ""),
    "motion.offset_deg": _TURN,
    "motion.rate": (-20.0, 20.0, "rad/s"),
    "motion.start_phase": (-1e3, 1e3, "rad"),
    "motion.spin_axis": (-1e3, 1e3, ""),
    "motion.spin": (-20.0, 20.0, "rad/s"),
    "carrier.hue": (0.0, 360.0, "deg"),
    "distractor.offset": (-2.0, 2.0, "m"),
    "tracker.image_period": (0.005, 1.0, "s"),
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
    "control.speed": (0.01, 1.0, "of the velocity limits"),
    "control.gain": (1e-9, 1000.0, "1/s"),
    "control.n_solutions": (1, 10_000, ""),
    "execution.position_error": (0.0, 0.1, "m"),
    "execution.angle_error": (0.0, 1.0, "rad"),
    "grasp.standoff": (0.0, 0.3, "m"),
    "grasp.position_tolerance": (1e-4, 0.1, "m"),
    "grasp.angle_tolerance": (0.001, 3.15, "rad"),
    "grasp.dwell": (0.0, 60.0, "s"),
    "grasp.patience": (0.5, np.inf, "s"),
    "grasp.closing_speed": (0.001, 1.0, "m/s"),
    "grasp.closing_time": (0.01, 60.0, "s"),
    "grasp.squeeze_time": (0.01, 60.0, "s"),
    "grasp.min_width": (0.0, 0.2, "m"),
    "grasp.lift": (-1.0, 1.0, "m"),
    "grasp.lift_time": (0.01, 60.0, "s"),
    "grasp.shake": (-0.5, 0.5, "m"),
    "grasp.shake_frequency": (0.01, 20.0, "Hz"),
    "grasp.shake_time": (0.0, 60.0, "s"),
    "grasp.hold_time": (0.0, 600.0, "s"),
    "camera_noise.*.correlation": (0.0, 20.0, "px"),
    "camera_noise.*.motion_blur": (0.0, 20.0, "px"),
    "camera_noise.*.dropped": (0.0, 1.0, ""),
    "camera_noise.*.hand_eye_position": (0.0, 0.1, "m"),
    "camera_noise.*.hand_eye_angle_deg": (0.0, 30.0, "deg"),
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

#: Words that a key may be.
CHOICES: dict[str, Sequence[str]] = {
    "carrier.kind": tuple(CarrierKind),
    "tracker.kind": tuple(TrackerKind),
    "control.controller": tuple(controller_names()),
    "control.mode": tuple(mode_names()),
    "control.source": (CLOSED_FORM, *plugins("ik_sources")),
    "control.prediction": tuple(PredictionModel),
    "perception.segmentation": tuple(Segmentation),
    "perception.execution": tuple(Execution),
    "perception.preset": tuple(Preset),
    "perception.sampler": tuple(sampler_names()),
    "reachability.method": (EXACT, *plugins("judges")),
    "simulator_config.integration_scheme": GetIntegrationSchemes(),
    "plant_config.contact_model": ("point", "hydroelastic", "hydroelastic_with_fallback"),
    "plant_config.discrete_contact_approximation": ("tamsi", "sap", "similar", "lagged"),
    "plant_config.contact_surface_representation": ("triangle", "polygon"),
}
