"""The JSON schema of one run's result file, from the code: ``feasigrasp/runs/run.schema.json``.

`tools/make_docs.py` writes it after a change of metrics, causes, status codes or modes.
"""

from __future__ import annotations

import math
from typing import Any

from feasigrasp.models.choices import controller_names, mode_names
from feasigrasp.models.control.status import StatusCode
from feasigrasp.runs.metrics.cause import Cause
from feasigrasp.runs.metrics.table import METRICS, Metric

_TEXT = {"type": "string", "minLength": 1}
_TEXT_OR_NULL = {"type": ["string", "null"], "minLength": 1}
_SECONDS = {"type": ["number", "null"], "minimum": 0}


def _object(properties: dict[str, Any], **more: Any) -> dict[str, Any]:
    """An object with exactly these properties."""
    return {
        "type": "object",
        "required": list(properties),
        "additionalProperties": False,
        "properties": properties,
    } | more


def _metric(name: str, metric: Metric) -> dict[str, Any]:
    """The values that a metric can have."""
    if name == "cause":
        return {"enum": [None, *Cause]}
    if metric.unit == "bool":
        return {"type": ["boolean", "null"]}
    bounds = {"minimum": metric.lower, "maximum": metric.upper}
    finite = {key: bound for key, bound in bounds.items() if math.isfinite(bound)}
    return {"type": ["number", "null"], **finite}


def run_schema() -> dict[str, Any]:
    """The schema of the file that ``feasigrasp run --results`` writes."""
    count = {"type": "object", "additionalProperties": {"type": "integer", "minimum": 1}}
    counts = dict.fromkeys(("sampler", "reachability"), count)
    status = [{"type": "number", "minimum": 0}, {"enum": [*StatusCode]}, {"type": "string"}]
    words = {"enum": sorted(controller_names())}
    properties = {
        "scenario": {"type": "string"},
        "controller": {"type": "string", "anyOf": [words, {"pattern": "^[^:]+:[^:]+$"}]},
        "mode": {"enum": mode_names()},
        "object": _TEXT,
        "seed": {"type": "integer"},
        "files": {"type": "object", "additionalProperties": {"type": "string"}},
        "git": _TEXT_OR_NULL,
        "versions": {
            "type": "object",
            "required": ["python", "drake", "numpy"],
            "additionalProperties": {"type": "string"},
        },
        "machine": {
            "type": "object",
            "required": ["cpus", "system"],
            "properties": {
                "cpus": {"type": ["integer", "null"], "minimum": 1},
                "system": {"type": "string"},
            },
        },
        "timings": {
            "type": "object",
            "required": ["build_s", "wall_s", "simulated_s", "real_time_factor"],
            "additionalProperties": _SECONDS,
        },
        "metrics": _object({name: _metric(name, metric) for name, metric in METRICS.items()}),
        "error": _TEXT_OR_NULL,
        "status": {
            "type": "array",
            "items": {"type": "array", "prefixItems": status, "minItems": 3, "maxItems": 3},
        },
        "rejected": {
            "type": "array",
            "items": {
                "type": "array",
                "prefixItems": [{"type": "number", "minimum": 0}, _object(counts)],
                "minItems": 2,
                "maxItems": 2,
            },
        },
        "scenario_yaml": _TEXT,
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "One run of a feasigrasp scenario",
        "description": "docs/results_schema.md and docs/api.md define the entries.",
    } | _object(properties)
