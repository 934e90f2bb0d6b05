"""From the records of ``feasigrasp evaluate sampler`` to its rows and raw files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from feasigrasp.evaluation.measures.grasps import average_precision, resampled
from feasigrasp.results.finished import Record
from feasigrasp.results.rows import Row, write_csv
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
            for what, statistic, unit in (
                ("width_mm", _WIDTH, "mm"),
                ("closing_deg", _CLOSING, "deg"),
                ("approach_valid_percent", _APPROACH, "%"),
            ):
                rows.append(_pooled(f"sampler.{what}{suffix}", preset, found, statistic, unit))
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
            # Coverage is asked for with one view; other conditions are named.
            name = "sampler.coverage_percent" + (condition != "1view") * f".{condition}"
            rows.append(_counted(name, preset, enough))
        for choice in ("top1", "random"):
            held = [r["held"] for r in _of(of_preset, "hold", choice=choice) if r["graspable"]]
            if held:
                rows.append(_counted(f"sampler.held_{choice}_percent", preset, held))
        errors = [r["equivariance_error"] for r in of_preset if "equivariance_error" in r]
        if errors:
            name = "sampler.equivariance.f64"
            rows.append(Row.plain(name, preset, max(errors), "1", len(errors)))
    return rows


def write_records(records: Sequence[Record], folder: Path) -> None:
    """Writes ``sets.csv``, ``proposals.csv`` and ``holds.csv``, one line per record."""
    for kind, columns in _COLUMNS.items():
        found = _of(records, kind)
        lines = [r | _proposal_figures(r) for r in found] if kind == "proposal" else found
        write_csv(folder / f"{kind}s.csv", lines, (*_ABOUT, *columns), ".6g")


def _of(records: Sequence[Record], kind: str, **where: str) -> list[Record]:
    return [
        record
        for record in records
        if record["kind"] == kind and all(record[key] == value for key, value in where.items())
    ]


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


def _of_column(
    column: str, reduce: Callable[[np.ndarray], np.floating], factor: float
) -> Callable[[Sequence[Record]], float]:
    """A statistic of all values of a column; NaN without any."""

    def statistic(records: Sequence[Record]) -> float:
        values = _joined(records, column)
        return factor * float(reduce(values)) if len(values) else float("nan")

    return statistic


_WIDTH = _of_column("width_error", np.median, 1e3)
_CLOSING = _of_column("closing_error", np.median, 1.0)
_APPROACH = _of_column("approach_free", np.mean, 100.0)


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
        "width_mm": _WIDTH(one),
        "closing_deg": _CLOSING(one),
        "approach_percent": _APPROACH(one),
    }
