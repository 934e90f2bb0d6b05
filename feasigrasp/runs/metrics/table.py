"""The metrics of a run: unit, range, standard term, definition, and how many runs are summed up.

Record, JSON schema, console, summaries of studies and ``docs/api.md`` read this table.
"""

import math
from dataclasses import dataclass
from enum import StrEnum


class Subject(StrEnum):
    """Subject of metrics, in the order of the console."""

    GRASP = "grasp"
    APPROACH = "approach"
    OBJECT = "object before release"
    ARM = "arm"
    TIME = "computing time"


class Over(StrEnum):
    """Aggregation of many runs into one summary row."""

    MEAN = "mean over objects"
    SHARE = "share of runs, over objects"
    MAX = "largest of all runs"
    MIN = "smallest of all runs"
    MEDIAN = "median over runs"


@dataclass(frozen=True)
class Figure:
    """A row of a summary.

    Attributes:
        name: Row name without the command, e.g. ``held_percent``.
        over: How it is computed from the runs.
        term: Standard term.
        unit: Unit.
        above: For a share, the value that a run has to exceed; true counts as 1.
        digits: Digits behind the point in tables; by default those of the unit.
    """

    name: str
    over: Over
    term: str
    unit: str = "%"
    above: float = 0.5
    digits: int | None = None

    @property
    def head(self) -> str:
        """Standard term with unit."""
        return self.term if self.unit in UNITLESS else f"{self.term} [{self.unit}]"

    @property
    def decimals(self) -> int:
        """Digits behind the point."""
        return _DIGITS.get(self.unit, 1) if self.digits is None else self.digits

    def text(self, value: float) -> str:
        """A value with these digits."""
        digits = self.decimals
        return f"{round(value, digits) + 0.0:.{digits}f}"  # no -0


@dataclass(frozen=True)
class Metric:
    """A metric of a run.

    Attributes:
        subject: What it is about.
        unit: Unit; ``bool`` for true or false, ``text`` for a word.
        term: Standard term.
        meaning: Definition.
        lower: Smallest possible value.
        upper: Largest possible value.
        digits: Digits behind the point in tables; by default those of the unit.
        averaged: Whether summaries have a row of its mean.
        main: Whether stored results keep that row; the others serve the inspection of single runs.
        rows: Further rows of summaries.
    """

    subject: Subject
    unit: str
    term: str
    meaning: str
    lower: float = 0.0
    upper: float = math.inf
    digits: int | None = None
    averaged: bool = True
    main: bool = True
    rows: tuple[Figure, ...] = ()


#: Units that are not written.
UNITLESS = ("1", "bool", "text")
#: Digits behind the point in tables.
_DIGITS = {"mm": 0, "ms": 0, "s": 2, "cm": 2, "m^3": 4, "m/s": 3}
_GRASP, _APPROACH, _OBJECT, _ARM, _TIME = Subject


def _percent(subject: Subject, term: str, meaning: str, *, main: bool = True) -> Metric:
    """A share of the samples of a run."""
    return Metric(subject, "%", term, meaning, upper=100.0, digits=2, main=main)


def _peak(term: str, meaning: str, *rows: Figure, main: bool = False) -> Metric:
    """A largest value in percent of its limit."""
    return Metric(_ARM, "%", term, meaning, digits=0, main=main, rows=rows)


def _time(row: str, over: Over, term: str, meaning: str) -> Metric:
    """A quantile of computing times."""
    figure = Figure(row, over, term, "ms", digits=0)
    return Metric(_TIME, "ms", term, meaning, averaged=False, rows=(figure,))


#: Every metric of a run, in the order of the record.
# fmt: off
METRICS: dict[str, Metric] = {
    "grasp_held": Metric(_GRASP, "bool", "grasp success",
        "lift, shake and hold are complete, the object has risen by half of the lift, and is over "
        "the last 2 s within 1 cm and 15° of its pose in the hand at release; null if the gripper "
        "stays open", averaged=False,
        rows=(Figure("held_percent", Over.SHARE, "grasp success"),)),
    "held_after_s": Metric(_GRASP, "s", "time to release",
        "of runs with grasp success"),
    "closing_speed_m_s": Metric(_GRASP, "m/s", "object speed at closing",
        "when the fingers last begin to close"),
    "cause": Metric(_GRASP, "text", "cause of failure",
        "first [cause](results_schema.md#cause) that applies; null with success", averaged=False),
    "slip_mm": Metric(_GRASP, "mm", "in-hand displacement",
        "largest since release", digits=1),
    "turn_deg": Metric(_GRASP, "deg", "in-hand rotation",
        "largest, likewise", upper=180.0),
    "lift_cm": Metric(_GRASP, "cm", "lift height",
        "height at the end above that at release",
        lower=-math.inf, main=False),
    **{f"object_end_{axis}_m": Metric(_GRASP, "m", f"final object position, {axis}",
        "in W", -math.inf, averaged=False) for axis in "xyz"},
    "gripper_object_distance_cm_mean": Metric(_APPROACH, "cm", "gripper-object distance",
        "mean of `\\|p_HO\\|`; not zero for a grasp off the center of mass"),
    "gripper_object_distance_cm_median": Metric(_APPROACH, "cm", "median of that distance",
        "likewise", main=False),
    "grasp_position_error_mm_median": Metric(_APPROACH, "mm", "position error to the nearest grasp",
        "median over the approach; nearest by position [m] + 0.1 angle [rad]", digits=1),
    "grasp_angle_error_deg_median": Metric(_APPROACH, "deg", "angle error to that grasp",
        "likewise", upper=180.0),
    "tracked_position_error_mm_median": Metric(_APPROACH, "mm", "tracked position error",
        "median distance of the tracked from the true position, in the approach", digits=1),
    "tracked_percent": Metric(_APPROACH, "%", "time at a grasp",
        "share of approach samples after 2 s, within 15 mm and 8° of the nearest grasp",
        upper=100.0),
    "settling_time_s": Metric(_APPROACH, "s", "settling time",
        "first time from which that holds for 0.5 s, or until the fingers close"),
    "grasp_switches": Metric(_APPROACH, "1", "grasp switches",
        "times the hand settles at a grasp more than 3 cm or 30° from the last"),
    "no_grasp_percent": _percent(_APPROACH, "time without a grasp",
        "share of samples", main=False),
    "grasp_age_s_mean": Metric(_APPROACH, "s", "grasp age",
        "mean time since the newest view behind the controller's grasps, in the approach"),
    "grasp_age_s_max": Metric(_APPROACH, "s", "largest grasp age", "likewise", main=False),
    "view_faults": Metric(_APPROACH, "1", "dropped views",
        "unusable views; a view without an object pose counts", main=False),
    "pushed_mm": Metric(_OBJECT, "mm", "object displacement before closing",
        "largest distance from the undisturbed motion in the approach, after 0.3 s, since the "
        "object starts at rest", digits=1,
        rows=(Figure("pushed_percent", Over.SHARE, "displaced > 5 mm before closing", above=5.0),
              Figure("pushed_mm_max", Over.MAX, "largest displacement before closing", "mm"),
              Figure("push_mm_max", Over.MAX, "largest push", "mm"))),
    "pushed_deg": Metric(_OBJECT, "deg", "object rotation before closing",
        "largest angle, likewise", upper=180.0, main=False),
    "contact_force_peak_n": Metric(_OBJECT, "N", "peak contact force before closing",
        "largest summed contact force of the robot on the object, over all plant steps",
        rows=(Figure("contact_before_closing_percent", Over.SHARE, "premature contact",
                     above=0.0),)),
    "contact_impulse_n_s": Metric(_OBJECT, "N s", "contact impulse before closing",
        "time integral of that force", digits=2),
    "contact_time_percent": _percent(_OBJECT, "time in contact before closing",
        "share of these steps with contact", main=False),
    "displaced_mm": Metric(_OBJECT, "mm", "object displacement during closing",
        "largest distance from the undisturbed motion, from the start of closing to release",
        digits=1,
        rows=(Figure("displaced_mm_max", Over.MAX, "largest displacement during closing", "mm"),)),
    "turned_deg": Metric(_OBJECT, "deg", "object rotation during closing",
        "largest angle, likewise", upper=180.0),
    "friction": Metric(_OBJECT, "1", "friction",
        "Coulomb friction of pad and object in the plant", digits=2),
    "self_collision_percent": _percent(_ARM, "self-collision",
        "share of samples with penetrating bodies that are no neighbors"),
    "joint_limit_violation_percent": _percent(_ARM, "joint limit violation",
        "share of samples with a joint beyond its position limit"),
    "velocity_limit_violation_percent": _percent(_ARM, "velocity limit violation",
        "share of ticks with a velocity sent, or of plant steps with a true one, beyond its limit"),
    "acceleration_limit_violation_percent": _percent(_ARM, "acceleration limit violation",
        "share of ticks with a sent joint acceleration beyond its limit"),
    "true_acceleration_violation_percent": _percent(_ARM, "true acceleration limit violation",
        "share of time with a true joint acceleration, the mean over 20 ms, beyond its limit"),
    "torque_limit_violation_percent": _percent(_ARM, "torque limit violation",
        "share of plant steps with a joint torque at or beyond its limit"),
    "manipulability_mean": Metric(_ARM, "m^3", "manipulability",
        "mean of `sqrt(det(J Jᵀ))` of the flange Jacobian [rad; m] (Yoshikawa)"),
    "self_distance_min_mm": Metric(_ARM, "mm", "self-distance",
        "smallest distance of these bodies, but of forearm and flange; null above 50 mm",
        lower=-math.inf,
        rows=(Figure("self_distance_min_mm.least", Over.MIN, "smallest of all runs", "mm"),)),
    "limit_margin_min_deg": Metric(_ARM, "deg", "joint limit margin",
        "smallest distance of a joint to its limit", lower=-math.inf, main=False),
    "obstacle_distance_min_mm": Metric(_ARM, "mm", "obstacle distance",
        "smallest distance of the robot, without base, to everything fixed; negative in "
        "penetration", lower=-math.inf,
        rows=(Figure("obstacle_distance_min_mm.least", Over.MIN, "smallest of all runs", "mm"),)),
    "velocity_peak_percent": _peak("peak velocity", "largest true joint velocity"),
    "acceleration_peak_percent": _peak("peak acceleration sent", "largest joint acceleration sent"),
    "true_acceleration_peak_percent": _peak("peak true acceleration",
        "largest true joint acceleration, the mean over 20 ms", main=True),
    "torque_peak_percent": _peak("peak torque",
        "largest joint torque, over all plant steps",
        Figure("torque_peak_percent.worst", Over.MAX, "largest torque", digits=0)),
    "control_ms_p99": _time("control_ms.p99", Over.MEDIAN, "control time, p99",
        "99th percentile of the wall time of the command"),
    "control_ms_worst": _time("control_ms.worst", Over.MAX, "largest control time", "likewise"),
    "control_cpu_ms_worst": _time("control_cpu_ms.worst", Over.MAX, "largest control CPU time",
        "in processor time of the thread, compilation included"),
    "planning_ms_median": _time("planning_ms.median", Over.MEDIAN, "planning time, median",
        "median wall time of the plans"),
    "planning_ms_p99": _time("planning_ms.p99", Over.MEDIAN, "planning time, p99", "likewise"),
    "planning_ms_worst": _time("planning_ms.worst", Over.MAX, "largest planning time", "likewise"),
    "planning_cpu_ms_worst": _time("planning_cpu_ms.worst", Over.MAX, "largest planning CPU time",
        "in processor time"),
}
# fmt: on
