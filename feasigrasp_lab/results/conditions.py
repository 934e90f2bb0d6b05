"""Conditions of a measurement in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def conditions_text(found: Mapping[str, Any]) -> str:
    """The conditions as one paragraph, to stand beside a table.

    Args:
        found: As `feasigrasp_lab.runs.run_plan.conditions` makes them.
    """
    speeds = ", ".join(
        f"{name} {speed['path_m_s']:.2f} m/s and {speed['spin_rad_s']:.2g} rad/s"
        for name, speed in found["speeds"].items()
    )
    objects, left_out = found["objects"], found["left_out"]
    latency = _either(found["perception_latency_s"], "{:g} s")
    parts = [
        f"{found['split']} split",
        f"largest speed of the object: {speeds}",
        f"camera: {_either(found['camera'])}",
        f"from a view to its grasps {latency}",
        f"tracking: {_either(found['tracking'])}",
        f"segmentation: {_either(found['segmentation'])}",
        f"object frame: {found['object_frame']}",
        f"friction {_either(found['friction'], '{:.3g}')}",
        *(f"{key}: {_either(found[key])}" for key in ("mass", "execution") if key in found),
        f"{len(objects)} object{'s' * (len(objects) > 1)}: {', '.join(objects)}",
        f"seeds {_ranges(found['seeds'])}",
    ]
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
