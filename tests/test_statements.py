"""Numbers in the pages are those of the code: every statement is written anew from its values."""

import importlib
import inspect
import re

import numpy as np
import pytest

import feasigrasp as fg
from feasigrasp.models.control.joint.field import MAX_LENGTH_SCALE, MIN_LENGTH_SCALE, SPACING_RATIO
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.control.planning.cost_weights import CostWeights
from feasigrasp.models.control.task.choice import ChoiceOptions
from feasigrasp.models.grasps.sequence import GraspSequenceConfig
from feasigrasp.models.objects.spring_drive import SPRINGS
from feasigrasp.models.objects.tracker_config import TrackerConfig
from feasigrasp.models.robot import IIWA_7, ParallelGripper
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.runs.plan import TEST_OBJECTS
from tests.conftest import REPOSITORY
from tools.constants import constants

_MODULES = {(c.module.rpartition(".")[2], c.name): c.module for c in constants()}


def value(name):
    """A constant by the last part of its module and its name, wherever the module lies."""
    module, _, constant = name.partition(".")
    return getattr(importlib.import_module(_MODULES[module, constant]), constant)


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


ALL, SOON, JOINT = CostWeights(), CostWeights.to_grasp_soon(), CostWeights.for_joint_field()
CHOICE, GRASP, SAFE, SCENARIO = ChoiceOptions(), GraspSequenceConfig(), fg.SafetyOptions(), Scenario()
REACH, TRACKER = SCENARIO.reachability, TrackerConfig()
COMPLETE = defaults("feasigrasp.models.shape.completion.complete_shape")
FIT = defaults("feasigrasp.models.shape.gpdf_fit.fit_gpdf")
JUDGED = defaults("feasigrasp.models.reach.predicted_reachability.judge_grasps")
MIXTURE = defaults("feasigrasp.models.mixtures.fit.fit_best_mixture")
HAND = ParallelGripper()
SOFT, STIFF, RIGID = (spring[:2] for spring in SPRINGS.values())
SPEEDS = np.rad2deg(IIWA_7.velocity_limits)
PAPER, FAST = (
    load_scenario(diagram_path("dynamic.scenarios.yaml"), f"PaperLinear{end}").motion.rate
    for end in ("", "Fast")
)

#: By page: a statement, and the values that stand in it.
STATEMENTS = {
    "method.md": [
        (
            "margin is {:g} mm plus {:g} standard deviations",
            (mm("modeled_bodies.MARGIN"), value("modeled_bodies.SIGMAS")),
        ),
        ("A wait of at most {:g} s separates bodies", (value("foreground.PATIENCE"),)),
        ("`l = {:g} m`", (COMPLETE["length_scale"],)),
        (
            "s² = {:g} ({:g} in the paper's field)",
            (value("completion.SMOOTHED_NOISE"), FIT["noise_variance"]),
        ),
        (
            "at `+-h = {:g} mm` along the normals of {:g} % of the points",
            (mm("completion.SURFACE_OFFSET"), percent("completion.BESIDE_SHARE")),
        ),
        ("step = d / max(|grad d|, {:g})", (value("gpdf_kernels.SLOPE_FLOOR"),)),
        ("over {} neighbors", (value("smoothing.NEIGHBOURS"),)),
        (
            "as prior ({:g} mm, {:.0f}°)",
            (mm("smoothing.TRACKING_SIGMA")[1], np.rad2deg(value("smoothing.TRACKING_SIGMA")[0])),
        ),
        (
            "unless it removes {:.0f} % of the misfit",
            (100 - percent("smoothing._MISFIT_LEFT"),),
        ),
        ("a {0} x {0} depth picture", (value("view_image.SIDE"),)),
        ("and {:g} object widths behind", (value("view_image.RIM_DEPTHS")[1],)),
        (
            "more than {:g} mm inside free space are dropped, unless observed within {:g} mm",
            (mm("completion._CARVED"), mm("completion._OBSERVED")),
        ),
        ("New sides ({:.0f}° from all others)", (degrees("keyframe._OTHER_SIDE"),)),
        ("after more than {:g} s at any orientation", (value("tracker._LONG_GAP"),)),
        (
            "requires {:g} % of the points on the model, after 1 s {:g} %",
            (
                percent("registration._FOUND")[0],
                percent("registration._FOUND_AT_ANY_ORIENTATION")[0],
            ),
        ),
        ("visible for {:g} s without a fit", (value("tracker._GIVEN_UP"),)),
        ("out of sight for {:g} s, the arm moves", (value("search_pose.SEARCH_AFTER"),)),
        ("After {:g} s the view circles", (value("search_pose._CIRCLES_AFTER"),)),
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
        ("With fewer than {} grasps left", (value("non_maximum_suppression.ENOUGH"),)),
        ("more than {:g} mm from the surface", (mm("filter.CONTACT_TOLERANCE"),)),
        ("exceeds {:g}; {:g}, then {:g}, while", value("filter.COSINE_STEPS")),
        ("is closer than {:g} mm and half", (mm("hand_clearance.MARGIN"),)),
        ("walls thinner than {:g} mm are left", (mm("hand_clearance.THIN_WALL"),)),
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
        ("`angle² + (distance / {:g} m)²`", (value("target.LENGTH_PER_RADIAN"),)),
        ("chooses 1 to {} components", (MIXTURE["max_components"],)),
        ("the {} best scores pass, none below {:g} of the best", (JUDGED["n_best"], JUDGED["score_share"])),
        (
            "with a pre-grasp pose {:g} cm behind them",
            (100 * value("predicted_reachability.WAY_IN"),),
        ),
        ("| distance | 1 per s at {:g} m |", (ALL.lost,)),
        ("| score | {:g} per s |", (ALL.score,)),
        ("| density | {:g} per s |", (ALL.density,)),
        (
            "| manipulability | {:g} per s | a singular arm, zero from {:g} m³ |",
            (ALL.manipulability_cost, ALL.manipulability),
        ),
        (
            "| joint limits | {:g} per s | a joint at its limit, zero from {:g} rad |",
            (ALL.limit_cost, ALL.limit_zone),
        ),
        (
            "| terminal cost | {:g} s | a candidate that expires now; zero at {:g} s, or {:g} s if",
            (ALL.end, ALL.expiry_horizon, SOON.expiry_horizon),
        ),
        ("| collision | {:g} s |", (ALL.collision,)),
        ("| no pre-grasp pose | {:g} s |", (SOON.no_corridor,)),
        ("| joint motion | {:g} per s |", (ALL.motion,)),
        (
            "| waiting at a grasp | {:g} per s, {:g} if the hand closes |",
            (ALL.waiting, SOON.waiting),
        ),
        ("Transitions respect {:g} % of the velocity limits", (100 * ALL.follow_share,)),
        ("straight in joint space, at {:g} %", (100 * ALL.speed_share,)),
        (
            "is {:g} s for a hand that closes, {:g} s for one that follows",
            (SOON.times[-1], ALL.times[-1]),
        ),
        ("at its own swivel angle, for {:g} s", (JOINT.times[-1],)),
        (
            "(offset/{:g} m - ln score_i + {:g} (ln p_max - ln p(X_i)) + posture)",
            (ALL.lost, ALL.density),
        ),
        (
            "it changes for a gain of {:g} s, and not within {:g} s",
            (CHOICE.commitment, CHOICE.hysteresis),
        ),
        ("exp((cost_* - cost_i) / {:g} s)", (CHOICE.temperature,)),
        ("s = {:g} |error of the hand|", (value("target.SHARPNESS"),)),
        ("faster than {:g} m/s, the arm moves", (value("safe_law._QUICK"),)),
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
        ("(1 s counts as {:g} rad)", (SolutionOptions().radians_per_second,)),
    ],
    "safety.md": [
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
        ("up to {:g} cm (wider", (100 * value("observed_space.BESIDE"),)),
        ("a grid of {:g} cm", (100 * value("observed_space.SCENE_VOXEL"),)),
        ("earlier views are forgotten once {} later", (value("point_cloud_to_gpdf.OUTVOTING"),)),
        ("accepted after {:g} s of agreeing", (value("pose_filter._JUMP_FOR"),)),
        ("(at most {:g} cm)", (100 * value("clearance_schedule._MOST"),)),
    ],
    "concepts.md": [
        ("moving object | {:g} Hz |", (1 / SCENARIO.plant_config.time_step,)),
        ("to its distance field | {:.0f} Hz |", (1 / TRACKER.image_period,)),
        ("by a Kalman filter | {:.0f} Hz |", (1 / TRACKER.period,)),
        (
            "| {:.0f} Hz, of keyframes; {:g} Hz |",
            (1 / TRACKER.image_period, 1 / SCENARIO.perception.period),
        ),
        ("and over the horizon | {:g} Hz |", (1 / REACH.period,)),
        ("and next-best view | {:g} Hz |", (1 / REACH.period,)),
        (
            "| {:g} Hz plan, {:g} Hz command |",
            (1 / REACH.period, 1 / SCENARIO.control.period),
        ),
        ("within all limits | {:g} Hz |", (1 / SCENARIO.control.period,)),
        ("from sensor data alone | {:g} Hz |", (1 / value("status_monitor.PERIOD"),)),
        ("simulated truth | {:g} Hz |", (1 / value("metrics.SAMPLE_PERIOD"),)),
        ("No reachable grasp for {:g} s", (value("next_best_view.WAITS"),)),
        ("blocked for {:g} s", (value("next_best_view._FORGOTTEN"),)),
        ("a factor of e in {:g} s", (value("next_best_view._RELAXES"),)),
    ],
    "hardware.md": [
        ("is {:g} % of the velocity limits", (percent("run.HARDWARE_SPEED"),)),
        ("{:.0f} to {:.0f} °/s", (SPEEDS.min(), SPEEDS.max())),
        (
            "{:.1f} to {:.1f} rad/s²",
            (IIWA_7.acceleration_limits.min(), IIWA_7.acceleration_limits.max()),
        ),
        ("does not answer for {:g} s, has lapsed", (value("remote_stage.DEADLINE"),)),
        ("(after {:g} s if the old one hangs)", (value("worker.PATIENCE"),)),
        ("ends after {:g} s with an error", (value("control.WAIT_FOR_GUARD"),)),
    ],
    "own_cell.md": [
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
        ("within {:g} m of the hand", (value("foreground.WITHIN"),)),
    ],
    "results_schema.md": [
        (
            "more than {:g} mm or {:.0f}° in the hand",
            (mm("status.SLIPPED"), degrees("status.TURNED")),
        ),
        ("`pushed_mm` > {:g} |", (value("cause.PUSHED_AWAY"),)),
        (
            "{:g} cm or {:.0f}° off in the last {:g} s",
            (
                100 * value("handling.HELD_DISTANCE"),
                degrees("handling.HELD_ANGLE"),
                value("handling.HELD_FOR"),
            ),
        ),
        ("has not seen the object for {:g} s", (value("search_pose.SEARCH_AFTER"),)),
        ("control tick, {:g} ms", (1e3 * SCENARIO.control.period,)),
        ("velocities over {:g} ms", (mm("motion_limits.WINDOW"),)),
    ],
    "developing.md": [
        ("or {:g} s passed", (SCENARIO.simulation_duration,)),
        ("{} generated shapes of families", (TEST_OBJECTS,)),
    ],
    "limitations.md": [("After a gap of more than {:g} s", (value("tracker._LONG_GAP"),))],
    "README.md": [
        ("within {:g} cm and {:.0f}° of its place", (
            100 * value("handling.HELD_DISTANCE"), degrees("handling.HELD_ANGLE"),
        )),
        ("holds it for {:g} s", (value("handling.HELD_FOR"),)),
        ("friction is {:g}, and grasps arrive {:g} s after", (
            SCENARIO.object.friction, SCENARIO.perception.latency,
        )),
    ],
}  # fmt: skip


@pytest.mark.parametrize("page", STATEMENTS)
def test_the_numbers_of_a_page_are_those_of_the_code(page):
    file = REPOSITORY / page if page == "README.md" else REPOSITORY / "docs" / page
    text = re.sub(r"\s+", " ", file.read_text())
    written = [statement.format(*values) for statement, values in STATEMENTS[page]]
    assert [each for each in written if each not in text] == []
