"""Numbers in the pages are those of the code: every statement is written anew from its values."""

import ast
import importlib
import inspect
import re
from typing import get_args

import numpy as np
import pytest
import yaml

import feasigrasp as fg
from feasigrasp.models.control.horizon.distance import (
    MAX_LENGTH_SCALE,
    MIN_LENGTH_SCALE,
    SPACING_RATIO,
)
from feasigrasp.models.control.horizon.law import HorizonOptions
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.control.status import StatusCode
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.grasps.sequence import GraspSequenceConfig
from feasigrasp.models.objects.rigid_object import builtin_objects
from feasigrasp.models.objects.spring_drive import SPRINGS
from feasigrasp.models.objects.tracking import TrackerConfig
from feasigrasp.models.reach.interception import InterceptionOptions
from feasigrasp.models.robot import IIWA_7, ParallelGripper
from feasigrasp.models.shape.gpdf_kernels import newton_step
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.reference_robot import SLICES
from feasigrasp.scenario.faults import AnyFault
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.control_loop import AHEAD, SET_AFTER
from feasigrasp.systems.monitoring.status_monitor import LASTS
from feasigrasp_lab.paper.grasp_mixture import LENGTH_PER_RADIAN
from feasigrasp_lab.protocols.changes import SPEEDS, SPINS, motion_capture
from feasigrasp_lab.runs.plan import FIRST_TEST_SEED, TEST_OBJECTS
from feasigrasp_lab.studies.static import PROTOCOLS
from feasigrasp_lab.training.data.grasp_labels import GRASPABLE
from feasigrasp_lab.training.data.household_shapes import FAMILIES, HELD_OUT
from tests.conftest import REPOSITORY
from tools.constants import assigned, constants

_MODULES = {(c.module.rpartition(".")[2], c.name): c.module for c in constants()}


def value(name):
    """A constant by the last part of its module and its name, wherever the module lies."""
    module, _, constant = name.partition(".")
    return getattr(importlib.import_module(_MODULES[module, constant]), constant)


def local(name):
    """A number, or some, that a function has a name for: ``module.function.name``."""
    module, function, variable = name.split(".")
    found = []
    for file in (REPOSITORY / "feasigrasp").rglob(f"{module}.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef) and node.name == function:
                assignments = [each for each in ast.walk(node) if isinstance(each, ast.Assign)]
                found += [dict(assigned(each)).get(variable) for each in assignments]
    (expression,) = filter(None, found)
    return eval(ast.unparse(expression), {"np": np})


def degrees(name):
    return np.rad2deg(value(name))


def mm(name):
    return 1e3 * np.asarray(value(name))


def percent(name):
    return 100 * np.asarray(value(name))


def defaults(function):
    """The defaults of a function, by the names of its arguments."""
    module, _, name = function.rpartition(".")
    made = inspect.signature(getattr(importlib.import_module(module), name))
    return {name: each.default for name, each in made.parameters.items()}


def weights(name):
    """How many weights a network has."""
    with np.load(REPOSITORY / "feasigrasp" / "models" / "weights" / f"{name}.npz") as file:
        return sum(file[key].size for key in file.files if file[key].dtype.kind == "f")


HORIZON, PROGRAM, MEETING = HorizonOptions(), ProgramOptions(), InterceptionOptions()
GRASP, SAFE, SCENARIO = (
    GraspSequenceConfig(),
    fg.SafetyOptions(),
    Scenario(),
)
REACH, TRACKER = SCENARIO.reachability, TrackerConfig()
COMPLETE = defaults("feasigrasp.models.shape.completion.complete_shape")
FIT = defaults("feasigrasp.models.shape.gpdf.fit_gpdf")
MIXTURE = defaults("feasigrasp_lab.mixtures.fit.fit_best_mixture")
EM = defaults("feasigrasp_lab.mixtures.fit.fit_riemannian_mixture")
REACHABILITY = defaults("feasigrasp.Reachability")
HAND = ParallelGripper()
SOFT, STIFF, RIGID = (spring[:2] for spring in SPRINGS.values())
JOINT_SPEEDS = np.rad2deg(IIWA_7.velocity_limits)
PAPER, FAST = (
    load_scenario(diagram_path("dynamic.scenarios.yaml"), f"PaperLinear{end}").motion.rate
    for end in ("", "Fast")
)

TRACKED = local("smoothing.register_view.tracked_sigma")

CONTROL = "feasigrasp.models.control"
MOTION = {
    name: load_scenario(diagram_path("dynamic.scenarios.yaml"), name).motion
    for name in ("ReachCircular", "ReachLinear", "ReachSinusoidal", "ReachBezier")
}
HARD, OLD, CAPTURE, ALONE = (
    load_scenario(diagram_path("dynamic.scenarios.yaml"), name)
    for name in ("Static", "Static", "ReachLinearMocap", "ReachLinear")
)
PROTOCOLS["hard"](HARD)
PROTOCOLS["paper"](OLD)
motion_capture(CAPTURE)
CAMERA, NOISE = ALONE.cameras["wrist_camera"], ALONE.camera_noise["wrist_camera"]

#: By page: a statement, and the values that stand in it.
STATEMENTS = {
    "method.md": [
        (
            "margin is {:g} mm plus {:g} standard deviations",
            (mm("modeled_bodies.MARGIN"), value("modeled_bodies.SIGMAS")),
        ),
        ("A wait of at most {:g} s separates bodies", (local("foreground._chosen.patience"),)),
        ("`l = {:g} m`", (COMPLETE["length_scale"],)),
        (
            "s² = {:g} ({:g} in the paper's field)",
            (local("completion.complete_shape.smoothed"), FIT["noise_variance"]),
        ),
        (
            "at `+-h = {:g} mm` along the normals of {:g} % of the points",
            (mm("completion.SURFACE_OFFSET"), 100 * local("completion._seen_nodes.share")),
        ),
        ("step = d / |grad d|, at most {:g} |d|", (newton_step(1.0, 1e-9),)),
        ("over {} neighbors", (local("smoothing.smooth_view.neighbours"),)),
        (
            "as prior ({:g} mm, {:.0f}°)",
            (1e3 * TRACKED[1], np.rad2deg(TRACKED[0])),
        ),
        (
            "unless it removes {:.0f} % of the misfit",
            (100 - 100 * local("smoothing.register_view.left"),),
        ),
        ("a {0} x {0} depth picture", (value("view_image.SIDE"),)),
        ("and {:g} object widths behind", (local("view_image.rim_points.rim_depths")[1],)),
        (
            "more than {:g} mm inside free space are dropped, unless observed within {:g} mm",
            (
                1e3 * local("completion.possible.carved"),
                1e3 * local("completion.possible.observed"),
            ),
        ),
        ("New sides ({:.0f}° from all others)", (degrees("keyframe._OTHER_SIDE"),)),
        ("after more than {:g} s at any orientation", (value("tracker._LONG_GAP"),)),
        (
            "requires {:g} % of the points on the model, after 1 s {:g} %",
            (
                100 * local("registration.is_found.shares")[0],
                100 * local("registration.is_found.shares_at_any_orientation")[0],
            ),
        ),
        ("visible for {:g} s without a fit", (local("tracker.track.given_up"),)),
        ("out of sight for {:g} s, the arm moves", (value("search_pose.SEARCH_AFTER"),)),
        ("After {:g} s the view circles", (value("search_pose._CIRCLES_AFTER"),)),
        ("after {:g} s the arm looks from its home", (value("search_pose._HOME_AFTER"),)),
        ("once others agree for {:g} s", (value("pose_filter._JUMP_FOR"),)),
        ("For {} approach directions", (value("contact_features.DIRECTIONS"),)),
        ("It has {:,} weights.", (weights("grasp_network"),)),
        (
            "The plant steps by {:g} ms",
            (1e3 * SCENARIO.plant_config.time_step,),
        ),
        (
            "with z = {:g}. `carrier.stiffness` sets k, by default {:g} N/m",
            (value("spring_drive.DAMPING_RATIO"), STIFF[0]),
        ),
        (
            "The hand goes on for {:g} s, then lifts",
            (GRASP.handover_time,),
        ),
        ("so {:g} % of the limits are sent", (100 * IIWA_7.acceleration_share,)),
        ("At each of {} surface points", (NetworkSampler.n_points,)),
        ("at steps of at most {:.0f}°", (360 / REACHABILITY["n_arm_angles"],)),
        (
            "covariance floors are `({:g} rad)²` and `({:g} mm)²`",
            (EM["rotation_floor"], 1e3 * EM["translation_floor"]),
        ),
        ("With fewer than {} grasps left", (value("grasp_set.ENOUGH"),)),
        ("more than {:g} mm from the surface", (1e3 * local("filter.filter_grasps.tolerance"),)),
        ("exceeds {:g}; {:g}, then {:g}, while", value("filter.COSINE_STEPS")),
        ("is closer than {:g} mm and half", (mm("hand_clearance.MARGIN"),)),
        ("walls below {:g} mm, free on both sides, are left", (mm("hand_clearance.THIN_WALL"),)),
        (
            "Non-maximum suppression ({:g} mm, {:.0f}°)",
            (
                mm("non_maximum_suppression.SAME_POSITION"),
                degrees("non_maximum_suppression.SAME_ANGLE"),
            ),
        ),
        ("{:.0f} % of the moments is used", (percent("payload.MOMENT_SHARE"),)),
        ("Below {:g} % `perceive` reports", (percent("payload.LEAST_PROBABILITY"),)),
        ("scores {:g} times as much", (value("non_maximum_suppression.HYSTERESIS"),)),
        ("`angle² + (distance / {:g} m)²`", (LENGTH_PER_RADIAN,)),
        ("chooses 1 to {} components", (MIXTURE["max_components"],)),
        ("first of {} instants, {:g} s apart", (MEETING.latest + 1, MEETING.step)),
        (
            "within {:g} % of the velocity and {:g} % of the acceleration limits",
            (100 * MEETING.velocity, 100 * MEETING.acceleration),
        ),
        (
            "{:g} max(0, {:g} s - duration) + {:g} s max(0, a - {:g}) - {:g} s ln score",
            (MEETING.lack, MEETING.enough, MEETING.strain, MEETING.easy, MEETING.score),
        ),
        (
            "The {} grasps of least cost pass; one that passed before is replaced for a gain of "
            "{:g} s",
            (value("feasible_grasps.MOST"), value("feasible_grasps._KEPT")),
        ),
        (
            "over the next {:g} s, {:g} times per second",
            (PROGRAM.times[-1], 1 / PROGRAM.steps[0]),
        ),
        ("joint velocities at {} knots", (len(PROGRAM.steps),)),
        (
            "{:g} |q_k - q_ref,k|² + |v_k - v_ref,k|² ) + h_k {:g} |a_k - a_ref,k|²",
            (PROGRAM.joint / 2, PROGRAM.acceleration / 2),
        ),
        ("selected for a gain of {:g} s", (HORIZON.switch,)),
        (
            "up to {} others within {:g} cm and {:g} rad",
            (HORIZON.neighbours - 1, *value("law._NEIGHBOUR") * [100, 1]),
        ),
        ("with heavy tails (Student's t) and `nu = {:g}`", (PROGRAM.tail,)),
        (
            "|e_p|² / ({:g} m)² + |e_r|² / ({:g} rad)²,   w_m = exp(-{:g} (cost_m".replace(
                "   ", " "
            ),
            (PROGRAM.tail_position, PROGRAM.tail_angle, PROGRAM.worth),
        ),
        (
            "with deviations of {:.1f} mm and {:.3f} rad",
            (
                1e3 * PROGRAM.tail_position / np.sqrt(2 * PROGRAM.tail),
                PROGRAM.tail_angle / np.sqrt(2 * PROGRAM.tail),
            ),
        ),
        ("with `w = ({:g} mrad)^-2`", (1e3 / np.sqrt(PROGRAM.distance),)),
        (
            "clip({:g} x median spacing, {:g}, {:g})",
            (SPACING_RATIO, MIN_LENGTH_SCALE, MAX_LENGTH_SCALE),
        ),
        (
            "after {:g} s within {:g} mm and {:g} rad",
            (GRASP.dwell, 1e3 * GRASP.position_tolerance, GRASP.angle_tolerance),
        ),
        ("they press for {:g} s", (GRASP.squeeze_time,)),
        ("compliant, friction {:g}.", (SCENARIO.object.friction,)),
        ("`Paper*` uses {:g} rad/s, `Paper*Fast` {:g} rad/s", (PAPER, FAST)),
        ("(1 s counts as {:g} rad)", (PROGRAM.speed,)),
    ],
    "safety.md": [
        (
            "{:g} %, {:g} % | `velocity_scale`, `acceleration_scale`",
            (100 * SAFE.velocity_scale, 100 * SAFE.acceleration_scale),
        ),
        ("judged with a position margin of {:g} rad", (REACHABILITY["limit_margin"],)),
        ("{:g} ms after the last request", (1e3 * CommandGuard.DEADLINE,)),
        ("or {:g} rad from the measured", (CommandGuard.MAX_DISTANCE,)),
        ("statuses stop for {:g} s | guard", (CommandGuard.SILENCE,)),
        ("{:g} s after they return", (CommandGuard.START_AFTER,)),
        ("{:g} s where clocks are that close", (CommandGuard.MAX_DRIFT,)),
        ("by more than {:g} s | controller | {:g} s", (AHEAD, SET_AFTER)),
        ("of the {:g} mm clearance", (1e3 * SAFE.clearance,)),
        ("The arm keeps {:g} cm.", (100 * SAFE.obstacle_clearance,)),
        ("| position margin | {:g} rad |", (SAFE.position_margin,)),
        ("| clearance between bodies of the robot | {:g} mm |", (1e3 * SAFE.clearance,)),
        (
            "| to obstacles, and between arm and object | {:g} mm |",
            (1e3 * SAFE.obstacle_clearance,),
        ),
        ("open hand to object surface | {:g} mm and half", (1e3 * SAFE.object_clearance,)),
        ("{:.1f} /s, {:g} /s | `approach_gain`", (SAFE.approach_gain, SAFE.speed_gain)),
        ("to the table | {:g} mm |", (1e3 * SCENARIO.cell.table_clearance,)),
        ("beyond {:g} times the velocity limits", (value("velocity_limits.WILD"),)),
        ("Above {:g} % of a joint's limit it reports", (percent("touch.THRESHOLD"),)),
        (
            "v = {:g} m/s and the contact force F estimated from the torques, during the contact "
            "and {:g} s after",
            (value("touch._SPEED"), value("touch._YIELDS_FOR")),
        ),
        ("up to {:g} cm along the normal", (100 * value("observed_space.BEHIND"),)),
        ("up to {:g} cm.", (100 * value("observed_space.BESIDE"),)),
        ("a grid of {:g} cm", (100 * value("observed_space.SCENE_VOXEL"),)),
        ("earlier views are forgotten once {} later", (value("point_cloud_to_gpdf.OUTVOTING"),)),
        ("accepted after {:g} s of agreeing", (value("pose_filter._JUMP_FOR"),)),
        ("(at most {:g} cm)", (100 * value("approach_corridor._MOST"),)),
    ],
    "concepts.md": [
        ("moving object | {:g} Hz |", (1 / SCENARIO.plant_config.time_step,)),
        ("to its distance field | {:.0f} Hz |", (1 / TRACKER.image_period,)),
        ("by a Kalman filter | {:.0f} Hz |", (1 / TRACKER.period,)),
        (
            "| {:.0f} Hz, of keyframes; {:g} Hz |",
            (1 / TRACKER.image_period, 1 / SCENARIO.perception.period),
        ),
        ("on the predicted path | {:g} Hz |", (1 / REACH.period,)),
        ("stall detection | {:g} Hz |", (1 / REACH.period,)),
        (
            "| {:g} Hz plan, {:g} Hz command |",
            (1 / PROGRAM.steps[0], 1 / SCENARIO.control.period),
        ),
        ("within all limits | {:g} Hz |", (1 / SCENARIO.control.period,)),
        ("from sensor data alone | {:g} Hz |", (1 / value("status_monitor.PERIOD"),)),
        ("simulated truth | {:g} Hz |", (1 / value("metrics.SAMPLE_PERIOD"),)),
        ("blocked for {:g} s", (value("stall._FORGOTTEN"),)),
        ("a time constant of {:g} s", (value("stall._TIME_CONSTANT"),)),
    ],
    "commands.md": [
        (
            "circle, radius {:g} m, one lap in {:g} s",
            (MOTION["ReachCircular"].amplitude[0], 2 * np.pi / MOTION["ReachCircular"].rate),
        ),
        ("line, {:g} m to either side", (MOTION["ReachLinear"].amplitude[1],)),
        (
            "figure of eight, {:.2f} m to either side and {:g} m up and down",
            MOTION["ReachSinusoidal"].amplitude[1:],
        ),
        ("Bezier curves at {:g} m/s", (MOTION["ReachBezier"].speed,)),
    ],
    "index.md": [
        ("Meshes of more than {} faces", (value("mesh.MAX_FACES"),)),
        ("fragments below {:g} % of the volume", (100 * local("mesh._joined.crumb"),)),
    ],
    "hardware.md": [
        ("drake-iiwa-driver | {:g} Hz |", (1 / channels.IIWA_PERIOD,)),
        ("drake-schunk-driver | {:g} Hz |", (1 / channels.WSG_PERIOD,)),
        ("velocity ({:g} %)", (100 * CommandGuard.SPEED,)),
        (
            "deadline {:g} ms, deviation {:g} rad",
            (1e3 * CommandGuard.DEADLINE, CommandGuard.MAX_DISTANCE),
        ),
        ("joint positions | {:.1f}° inside", (np.rad2deg(SAFE.position_margin),)),
        ("is {:g} % of the velocity limits", (percent("run.HARDWARE_SPEED"),)),
        ("{:.0f} to {:.0f} °/s", (JOINT_SPEEDS.min(), JOINT_SPEEDS.max())),
        (
            "{:.1f} to {:.1f} rad/s²",
            (IIWA_7.acceleration_limits.min(), IIWA_7.acceleration_limits.max()),
        ),
        ("does not answer for {:g} s, has lapsed", (value("remote_stage.DEADLINE"),)),
        ("(after {:g} s if the old one hangs)", (value("worker.PATIENCE"),)),
        ("ends after {:g} s with an error", (value("control.WAIT_FOR_GUARD"),)),
    ],
    "own_cell.md": [
        ("images {:g} ms late", (1e3 * CAMERA.output_delay,)),
        ("| `palm_size` | [{:.3f}, {:.3f}, {:.3f}] |", HAND.palm_size),
        ("The {} objects of the package", (len(builtin_objects()),)),
        ("minimum depth {:g} m, stereo baseline {:g} mm", (CAMERA.z_near, 1e3 * NOISE["baseline"])),
        ("| `max_opening` | {:g} |", (HAND.max_opening,)),
        ("| `tool_offset` | {:g} |", (HAND.tool_offset,)),
        ("| `grip_force` | {:g} |", (HAND.grip_force,)),
        ("| `camera_tilt` | {:.3f} |", (HAND.camera_tilt,)),
        (
            "| `finger_thickness`, `finger_width` | {:.3f}, {:.3f} |",
            (HAND.finger_thickness, HAND.finger_width),
        ),
        ("| `tip`, `heel` | {:.3f}, {:.3f} |", (HAND.tip, HAND.heel)),
        (
            "soft: {:g} N/m, {:g} Nm/rad; stiff: {:g}, {:g}; rigid: {:g}, {:g}",
            (*SOFT, *STIFF, *RIGID),
        ),
        ("by release_delay, {:g} s", (SCENARIO.carrier.release_delay,)),
        ("closer than {:g} cm to each other", (100 * value("components.JOINED"),)),
        ("within {:g} m of the hand", (local("foreground.segment.within"),)),
    ],
    "results_schema.md": [
        ("forearm and link 1 in {} slices", (SLICES["iiwa_link_5"],)),
        ("alone, {:g} times per second", (1 / value("status_monitor.PERIOD"),)),
        (
            "`touched`: one; `braking_for_obstacle`: {:g} s",
            (LASTS[StatusCode.BRAKING_FOR_OBSTACLE],),
        ),
        ("for {:g} s, ", (LASTS[StatusCode.OUT_OF_REACH],)),
        ("{:g} % of the grasps", (percent("status.SHARED"),)),
        ("accepted after {:g} s |", (value("pose_filter._JUMP_FOR"),)),
        (
            "more than {:g} mm or {:.0f}° in the hand",
            (mm("status.SLIPPED"), degrees("status.TURNED")),
        ),
        ("`pushed_mm` > {:g} |", (value("cause.PUSHED_AWAY"),)),
        (
            "moved in it by {:g} cm or {:.0f}°",
            (100 * value("handling.HELD_DISTANCE"), degrees("handling.HELD_ANGLE")),
        ),
        ("has not seen the object for {:g} s", (value("search_pose.SEARCH_AFTER"),)),
        ("control tick, {:g} ms", (1e3 * SCENARIO.control.period,)),
        ("velocities over {:g} ms", (mm("motion_limits.WINDOW"),)),
    ],
    "developing.md": [
        (
            "{:g} to {:g} m/s; {:g} to {:g} rad/s",
            (SPEEDS[0], SPEEDS[-1], SPINS[0], SPINS[-1]),
        ),
        ("seeds from {}", (FIRST_TEST_SEED,)),
        (
            "{} families of closed solids, 2 to 26 cm; {} families",
            (len(FAMILIES), len(HELD_OUT)),
        ),
        ("fewer than {} points are not run", (GRASPABLE,)),
        (
            "| `hard` | {:g} | uniform | twice | the same, with a hand error of {:g} mm and {:.0f}"
            "°",
            (
                HARD.object.friction,
                1e3 * HARD.execution.position_error,
                np.rad2deg(HARD.execution.angle_error),
            ),
        ),
        ("| `paper` | {:g} | one | {:g} kg |", (OLD.object.friction, OLD.object.mass)),
        (
            "motion capture with {:g} mm, {:.0f}°, {:g} ms",
            (
                1e3 * CAPTURE.tracker.position_noise,
                np.rad2deg(CAPTURE.tracker.rotation_noise),
                1e3 * CAPTURE.tracker.latency,
            ),
        ),
        ("or {:g} s passed", (SCENARIO.simulation_duration,)),
        ("{} generated shapes of families", (TEST_OBJECTS,)),
    ],
    "limitations.md": [
        ("Tracking begins with {:g} pixels", (value("tracker.FIRST_POINTS"),)),
        ("after {:g} s from the arm's home", (value("search_pose._HOME_AFTER"),)),
    ],
    "README.md": [
        (
            "within {:g} cm and {:.0f}° of its place",
            (
                100 * value("handling.HELD_DISTANCE"),
                degrees("handling.HELD_ANGLE"),
            ),
        ),
        ("holds it for {:g} s", (value("handling.HELD_FOR"),)),
        (
            "friction is {:g}, and grasps arrive {:g} s after",
            (
                SCENARIO.object.friction,
                SCENARIO.perception.latency,
            ),
        ),
    ],
}


@pytest.mark.parametrize("page", STATEMENTS)
def test_the_numbers_of_a_page_are_those_of_the_code(page):
    file = REPOSITORY / page if page == "README.md" else REPOSITORY / "docs" / page
    text = re.sub(r"\s+", " ", file.read_text())
    written = [statement.format(*values) for statement, values in STATEMENTS[page]]
    assert [each for each in written if each not in text] == []


def test_values_of_injected_faults_are_their_defaults():
    """The rows ``| `!Tag` | fault | `key: value` [unit] |`` of the page on faults."""
    text = (REPOSITORY / "docs" / "safety.md").read_text()
    rows = re.findall(r"^\| (`!\w+`.*?) \|.*\| (.*?) \|$", text, flags=re.MULTILINE)
    checked, kinds = 0, {kind.__name__: kind for kind in get_args(AnyFault)}
    for names, values in rows:
        made = [kinds[tag]() for tag in re.findall(r"`!(\w+)`", names)]
        for each in re.findall(r"`(\w+: [^`]+)`", values):
            ((key, default),) = yaml.safe_load(each).items()
            expected = float(default) if isinstance(default, str) else default  # 1e6
            found = [getattr(fault, key) for fault in made if hasattr(fault, key)]
            assert found and all(x == pytest.approx(expected) for x in found), (names, key)
            checked += 1
    assert checked >= 20
