"""From the records of ``feasigrasp evaluate sampler`` to its rows and raw files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from feasigrasp.evaluation.measures.grasps import Record, average_precision, resampled
from feasigrasp.results.rows import Row
from feasigrasp.results.statistics import Estimate, proportion

#: Coverage asks for so many grasps.
ENOUGH = 10
#: Columns of the raw files, by kind of record.
_COLUMNS = {
    "set": ("grasps", "valid", "antipodal", "free", "top_valid", "cpu_ms"),
    "hold": ("choice", "held", "why"),
    "proposal": ("contacts", "contact_ap", "width_mm", "closing_deg", "approach_percent"),
}
_ABOUT = ("object", "graspable", "view", "condition", "preset")


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """All rows; intervals are of objects drawn anew, or Wilson's where trials are counted."""
    rows = []
    for preset in dict.fromkeys(record["preset"] for record in records):
        of_preset = [record for record in records if record["preset"] == preset]
        for condition, name in (("1view", "completed"), ("true", "true")):
            found = _of(of_preset, "proposal", condition=condition)
            if not found:
                continue
            rows.append(_pooled(f"sampler.contact_ap.{name}", preset, found, _ap, "1"))
            suffix = "" if name == "completed" else ".true"
            for column, factor, unit in (
                ("width_error", 1e3, "mm"),
                ("closing_error", 1.0, "deg"),
            ):
                what = "width_mm" if unit == "mm" else "closing_deg"
                statistic = _median_of(column, factor)
                rows.append(_pooled(f"sampler.{what}{suffix}", preset, found, statistic, unit))
            what = f"sampler.approach_valid_percent{suffix}"
            rows.append(_pooled(what, preset, found, _share_of("approach_free"), "%"))
        for condition in ("1view", "3views"):
            found = _of(of_preset, "set", condition=condition)
            if not found:
                continue
            name = f"sampler.precision.{condition}"
            rows.append(_pooled(name, preset, found, _precision, "1"))
            rows.append(_pooled(f"{name}.per_view", preset, found, _precision_per_view, "1"))
            tops = [r["top_valid"] for r in found if r["top_valid"] is not None]
            rows.append(_counted(f"sampler.top1_valid_percent.{condition}", preset, tops))
            enough = [int(r["grasps"] >= ENOUGH) for r in found if r["graspable"]]
            rows.append(_counted(_at("sampler.coverage_percent", condition), preset, enough))
        for choice in ("top1", "random"):
            held = [r["held"] for r in _of(of_preset, "hold", choice=choice) if r["graspable"]]
            if held:
                rows.append(_counted(f"sampler.held_{choice}_percent", preset, held))
        errors = [r["equivariance_error"] for r in of_preset if "equivariance_error" in r]
        if errors:
            name = "sampler.equivariance.f64"
            rows.append(Row(name, preset, max(errors), None, None, "1", len(errors)))
    return rows


def write_csv(records: Sequence[Record], folder: Path) -> None:
    """Writes ``sets.csv``, ``proposals.csv`` and ``holds.csv``, one line per record."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind, columns in _COLUMNS.items():
        with (folder / f"{kind}s.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, [*_ABOUT, *columns], extrasaction="ignore")
            writer.writeheader()
            for record in _of(records, kind):
                line = record | (_proposal_figures(record) if kind == "proposal" else {})
                writer.writerow({name: _cell(line[name]) for name in writer.fieldnames})


def _of(records: Sequence[Record], kind: str, **where: str) -> list[Record]:
    return [
        record
        for record in records
        if record["kind"] == kind and all(record[key] == value for key, value in where.items())
    ]


def _at(name: str, condition: str) -> str:
    """Coverage is asked for with one view; other conditions are named."""
    return name if condition == "1view" else f"{name}.{condition}"


def _pooled(
    name: str,
    preset: str,
    records: Sequence[Record],
    statistic: Callable[[Sequence[Record]], float],
    unit: str,
) -> Row:
    by_object: dict[str, list[Record]] = {}
    for record in records:
        by_object.setdefault(record["object"], []).append(record)
    estimate = resampled(
        list(by_object.values()), lambda groups: statistic([r for group in groups for r in group])
    )
    return Row.of(name, preset, estimate, unit)


def _counted(name: str, preset: str, outcomes: Sequence[int]) -> Row:
    n = len(outcomes)
    estimate = proportion(sum(outcomes), n) if n else Estimate(0.0, None, None, 0)
    return Row.of(name, preset, estimate, "%", 100.0)


def _joined(records: Sequence[Record], column: str) -> np.ndarray:
    return np.array([value for record in records for value in record[column]], dtype=float)


def _ap(records: Sequence[Record]) -> float:
    return average_precision(_joined(records, "contact"), _joined(records, "is_contact") > 0.5)


def _median_of(column: str, factor: float) -> Callable[[Sequence[Record]], float]:
    def statistic(records: Sequence[Record]) -> float:
        values = _joined(records, column)
        return factor * float(np.median(values)) if len(values) else float("nan")

    return statistic


def _share_of(column: str) -> Callable[[Sequence[Record]], float]:
    def statistic(records: Sequence[Record]) -> float:
        values = _joined(records, column)
        return 100.0 * float(values.mean()) if len(values) else float("nan")

    return statistic


def _precision(records: Sequence[Record]) -> float:
    offered = sum(record["grasps"] for record in records)
    return sum(record["valid"] for record in records) / offered if offered else float("nan")


def _precision_per_view(records: Sequence[Record]) -> float:
    shares = [record["valid"] / record["grasps"] for record in records if record["grasps"]]
    return float(np.mean(shares)) if shares else float("nan")


def _proposal_figures(record: Record) -> Record:
    one = [record]
    return {
        "contacts": sum(record["is_contact"]),
        "contact_ap": _ap(one),
        "width_mm": _median_of("width_error", 1e3)(one),
        "closing_deg": _median_of("closing_error", 1.0)(one),
        "approach_percent": _share_of("approach_free")(one),
    }


def _cell(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value
