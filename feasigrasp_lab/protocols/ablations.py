"""Paired runs: without one part of the system, or with another controller."""

from collections.abc import Hashable, Sequence
from itertools import product
from operator import itemgetter

from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.grasps.samplers import SamplerName
from feasigrasp.models.objects.prediction import PredictionModel
from feasigrasp_lab.protocols.changes import setting, unchanged
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.results.statistics import grouped, mean_of_objects

#: The controller that others are compared with.
REFERENCE = ControlSpace.TASK.value
#: The system as it is.
FULL = "-full"
#: What is taken away, one thing at a time, by the end of the runs' names.
ABLATIONS = {
    FULL: unchanged,
    "-no-density": setting({"control.density": False}),
    "-no-score": setting({"control.score": False}),
    "-no-look-ahead": setting({"control.prediction": PredictionModel.NONE.value}),
    "-no-prediction": setting({"control.prediction": PredictionModel.TWIST.value}),
    "-no-hidden-side": setting({"perception.hidden_side": False}),
    "-one-view": setting({"perception.views": 1}),
    "-paper-network": setting({"perception.sampler": "paper"}),
    "-antipodal": setting({"perception.sampler": SamplerName.ANTIPODAL.value}),
}


def ablation_of(name: str) -> str:
    """The end of a run's or a preset's scenario that names its ablation; empty without one."""
    return next((suffix for suffix in ABLATIONS if name.endswith(suffix)), "")


def without_ablation(name: str) -> str:
    """The name of a run's scenario, whatever its ablation."""
    return name.removesuffix(ablation_of(name))


def ablation_rows(records: Sequence[Record]) -> list[Row]:
    """Changes by every ablation: of the share held, and of the time until an object is held.

    Runs are paired by scenario, controller, object and seed; times are compared where both held.
    Presets are those of `feasigrasp_lab.runs.summary.summary_rows` for all scenarios
    together. Every object counts once, and the intervals come from drawing the objects anew.

    Args:
        records: Records of runs; those of other studies are left out, and so are those without a
            counterpart.
    """
    full = {_whole(run): run for run in records if ablation_of(run["scenario"]) == FULL}
    pairs = []
    for run in records:
        suffix = ablation_of(run["scenario"])
        if suffix and suffix != FULL and _whole(run) in full:
            for controller in (run["controller"], "all"):
                pairs.append((f"all{suffix}/{controller}/{run['mode']}", full[_whole(run)], run))
    return _changes(pairs)


def controller_rows(records: Sequence[Record]) -> list[Row]:
    """Changes of the same figures from the controller `REFERENCE` to each other one.

    Runs are paired by scenario, mode, object and seed; presets are
    ``<scenario>/<controller>/<mode>``.

    Args:
        records: Records of runs; those without a counterpart are left out.
    """
    of_reference = [run for run in records if run["controller"] == REFERENCE]
    reference = {_key(run, run["scenario"]): run for run in of_reference}
    pairs = []
    for run in records:
        counterpart = reference.get(_key(run | {"controller": REFERENCE}, run["scenario"]))
        if counterpart is not None and run["controller"] != REFERENCE:
            pairs.append(("{scenario}/{controller}/{mode}".format_map(run), counterpart, run))
    return _changes(pairs)


def _changes(pairs: Sequence[tuple[str, Record, Record]]) -> list[Row]:
    """The rows of pairs of runs, each with its preset."""
    rows, figures = (
        [],
        (
            ("held_change_percent", "grasp_held", "%", 100.0),
            ("held_after_change_s", "held_after_s", "s", 1.0),
        ),
    )
    groups = grouped(pairs, itemgetter(0))
    for (preset, group), (name, metric, unit, factor) in product(groups.items(), figures):
        metrics = [(a["metrics"][metric], b["metrics"][metric], b["object"]) for _, a, b in group]
        both = [(float(b) - float(a), what) for a, b, what in metrics if None not in (a, b)]
        if both:
            changes, objects = zip(*both, strict=True)
            estimate = mean_of_objects(changes, objects)
            rows.append(Row.of(f"dynamic.{name}", preset, estimate, unit, factor))
    return rows


def _whole(run: Record) -> Hashable:
    """What a run has in common with the run of the whole."""
    return _key(run, without_ablation(run["scenario"]))


def _key(run: Record, scenario: str) -> Hashable:
    return scenario, run["controller"], run["mode"], run["object"], run["seed"]
