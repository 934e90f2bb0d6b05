"""Runs a plan and reports its results, complete or not."""

import argparse
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from feasigrasp.models.objects.tracking import TrackerConfig, TrackerKind
from feasigrasp.runs.results.interrupts import Unfinished
from feasigrasp.runs.results.provenance import git_revision
from feasigrasp.scenario.parts import Part
from feasigrasp.scenario.sampling import largest_speed
from feasigrasp.scenario.schema import Scenario, Segmentation
from feasigrasp_lab.protocols.ablations import without_ablation
from feasigrasp_lab.protocols.tuned import is_tuned
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.runs.isolated import report_crashes, run_all
from feasigrasp_lab.runs.plan import Plan, PlannedRun

#: Whether constants were chosen on the runs; None if on some of them.
_TUNED = {
    True: "constants were chosen on these runs",
    False: "no constant was chosen on these runs",
    None: "constants were chosen on the runs of presets `tuned:`",
}


def conditions_text(found: Mapping[str, Any]) -> str:
    """What `conditions` has found as one paragraph, to stand beside a table."""
    speeds = ", ".join(
        f"{name} {speed['path_m_s']:.2f} m/s and {speed['spin_rad_s']:.2g} rad/s"
        for name, speed in found["speeds"].items()
    )
    objects, left_out = found["objects"], found["left_out"]
    latency = _either(found["perception_latency_s"], "{:g} s")
    parts = [
        f"{found['split']} split",
        *([f"arm: {_either(found['arm'])}"] if "arm" in found else []),
        f"largest speed of the object: {speeds}",
        f"camera: {_either(found['camera'])}",
        f"from a view to its grasps {latency}",
        f"tracking: {_either(found['tracking'])}",
        f"segmentation: {_either(found['segmentation'])}",
        f"object frame: {found['object_frame']}",
        f"friction {_either(found['friction'])}",
        *(f"{key}: {_either(found[key])}" for key in ("mass", "execution") if key in found),
        f"{len(objects)} object{'s' * (len(objects) > 1)}: {', '.join(objects)}",
        f"seeds {_ranges(found['seeds'])}",
    ]
    if "tuned" in found:
        parts.append(_TUNED[found["tuned"]])
    parts += [f"left out: {name} ({why})" for name, why in left_out.items()]
    parts += [] if left_out else ["no object left out"]
    return f"Conditions: {'; '.join(parts)}."


def _either(value: Any, form: str = "{}") -> str:
    values = value if isinstance(value, list) else [value]
    return " or ".join(form.format(each) for each in values)


def _ranges(numbers: Iterable[int]) -> str:
    """Whole numbers in ascending order with runs of them drawn together: ``0 to 2, 5``."""
    spans: list[list[int]] = []
    for number in numbers:
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in spans)


#: The object's frame, by the source of its pose.
_FRAME: dict[str, str] = {
    TrackerKind.MOCAP: "given, with the pose",
    TrackerKind.CAMERA: "that of the first view",
}
#: The source of the object's pixels.
_SEGMENTATION: dict[str, str] = {
    Segmentation.LABELS: "label image of the simulation",
    Segmentation.DEPTH: "depth image, arm and cell known",
}
#: The errors of a tracker's measurements, and how they are modeled.
_ERRORS = {
    "latency": "{:g} s late",
    "position_noise": "noise {:g} m",
    "rotation_noise": "{:.2g} rad",
    "dropout": "{:.0%} lost",
}


def conditions(plan: Plan, split: str) -> dict[str, Any]:
    """The conditions of many runs, for ``summary.json``; ``docs/results_schema.md`` defines them.

    An entry that is not the same in all runs is a list of what it is.
    """
    runs = plan.runs
    by_name: dict[str, Scenario] = {}
    for planned in runs:
        by_name.setdefault(without_ablation(planned.name), planned.scenario)
    tuned = {is_tuned(p.name, p.object_name, p.scenario.random_seed) for p in runs}
    return {
        "split": split,
        "speeds": {
            name: {"path_m_s": round(largest_speed(s), 4), "spin_rad_s": abs(s.motion.spin)}
            for name, s in by_name.items()
        },
        "arm": _common(runs, lambda s: s.arm),
        "camera": _common(runs, _camera),
        "perception_latency_s": _common(runs, lambda s: s.perception.latency),
        "tracking": _common(runs, lambda s: _tracking(s.tracker)),
        "segmentation": _common(runs, _segmentation),
        "object_frame": _common(runs, lambda s: _FRAME[s.tracker.kind]),
        "friction": _common(runs, _friction),
        "mass": _common(runs, _mass),
        "execution": _common(runs, _execution),
        "objects": list(dict.fromkeys(planned.object_name for planned in runs)),
        "left_out": plan.left_out,
        "seeds": sorted({planned.scenario.random_seed for planned in runs}),
        "tuned": tuned.pop() if len(tuned) == 1 else None,
    }


def _friction(scenario: Scenario) -> float | str:
    friction = scenario.object.friction
    if isinstance(friction, float | int):
        return friction
    return f"{friction.min:g} to {friction.max:g}"


def _segmentation(scenario: Scenario) -> str:
    own = scenario.parts.get(Part.SEGMENTATION)
    return _SEGMENTATION[scenario.perception.segmentation] if own is None else own.name


def _common(runs: Sequence[PlannedRun], read: Callable[[Scenario], Any]) -> Any:
    """What all runs have, or the list of what some have."""
    values = list(dict.fromkeys(read(planned.scenario) for planned in runs))
    return values[0] if len(values) == 1 else values


def _camera(scenario: Scenario) -> str:
    name = scenario.perception.camera
    camera, noise = scenario.cameras[name], scenario.camera_noise.get(name)
    size = f"{name}, {camera.width} x {camera.height}"
    if noise is None:
        return f"{size}, without noise"
    if scenario.sensors.error_factor != 1.0:
        noise = noise | {"errors times": scenario.sensors.error_factor}
    changed = ", ".join(f"{key} {value:g}" for key, value in sorted(noise.items()))
    return f"{size}, noise of a D435" + (f" with {changed}" if changed else "")


def _mass(scenario: Scenario) -> str:
    mass, factor = scenario.object.mass, scenario.object.mass_factor
    own = "the object's own" if mass is None else f"{mass:g} kg"
    return own if factor == 1.0 else f"{factor:.3g} times {own}"


def _execution(scenario: Scenario) -> str:
    config = scenario.execution
    if config.teleport:
        return "the arm is put at a grasp"
    if config.position_error == config.angle_error == 0.0:
        return "the hand is at its nominal pose"
    angle = math.degrees(config.angle_error)
    return f"the hand is {1e3 * config.position_error:.3g} mm and {angle:.3g} deg off"


def _tracking(tracker: TrackerConfig) -> str:
    if tracker.kind == TrackerKind.CAMERA:
        return f"in the camera's depth images, {1.0 / tracker.image_period:.3g} Hz"
    rate = f"{1.0 / tracker.period:g} Hz"
    errors = {text: getattr(tracker, name) for name, text in _ERRORS.items()}
    if not any(errors.values()):
        return f"true pose, {rate}, no latency"
    return f"measured pose, {rate}, {', '.join(text.format(x) for text, x in errors.items())}"


def run_plan(
    args: argparse.Namespace,
    whole: Plan,
    split: str,
    command: str,
    summarize: Callable[[Sequence[Record]], list[Row]],
    table: Callable[[Sequence[Row]], str],
) -> int:
    """Runs a plan, or the shard of it that is asked for; prints and writes rows and ``runs.csv``.

    Args:
        args: Arguments of the command, those of `add_worker_arguments` among them.
        whole: All runs.
        split: ``development`` or ``test``.
        command: Its name behind ``evaluate``.
        summarize: Makes the rows of records.
        table: What is printed of rows.

    Returns:
        The exit status of the command: 1 if a run crashed.

    Raises:
        Unfinished: Ctrl-C, or a full disk; what is there is reported before.
    """
    planned = whole.share(args.shard)
    found = conditions(planned, split)

    def report(records: Sequence[Record], **more: bool) -> None:
        rows = summarize(records)
        text = f"{table(rows)}\n{conditions_text(found)}"
        report_rows(args, f"evaluate {command}", rows, text, conditions=found, **more)
        write_csv(args.out / "runs.csv", map(flat, records))

    try:
        records = run_all(
            planned.runs,
            args.out / "runs",
            args.jobs,
            desc=command,
            elsewhere=sorted(args.out.glob("shard-*-of-*/runs")),
        )
    except Unfinished as stopped:
        if stopped.records:
            report(stopped.records, partial=True)
        raise
    report(records, **({} if args.shard is None else {"partial": True}))
    revision = str(git_revision())
    others = sorted({str(record["git"]) for record in records} - {revision})
    if others:
        print(f"the code changed meanwhile: some runs are of {', '.join(others)}, not {revision}")
    return report_crashes(records)


def flat(record: Record) -> Record:
    """A run with all its metrics as one row of a table."""
    heads = ("scenario", "controller", "mode", "object", "seed", "git")
    about = {head: record[head] for head in heads}
    return about | record["metrics"] | record["timings"] | {"error": record["error"]}
