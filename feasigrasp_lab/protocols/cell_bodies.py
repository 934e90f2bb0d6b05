"""Bodies of the cell beside the object's path: a wall, a shelf above it, a bench below."""

from __future__ import annotations

from feasigrasp.scenario.cell import BoxConfig
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.protocols.degradations import Change

#: Where it is from there, and its sides [m].
_BODIES = {
    "wall": ((0.0, 1.0, 0.0), (0.5, 0.04, 0.5)),
    "shelf": ((0.0, 1.4, 0.8), (0.6, 0.3, 0.03)),
    "bench": ((0.0, 0.0, -1.0), (0.6, 0.6, 0.04)),
}


def _beside(name: str, distance: float) -> Change:
    def change(scenario: Scenario) -> None:
        way, size = _BODIES[name]
        middle = [c + distance * w for c, w in zip(scenario.motion.center, way, strict=True)]
        scenario.cell.boxes[name] = BoxConfig(size=list(size), position=middle)

    return change


#: What the study ``cell`` runs its scenarios with, by the end of the runs' names: each body at
#: three distances from the middle of the object's path [m].
BODIES = {
    f"-{name}-{distance:g}": _beside(name, distance)
    for name in _BODIES
    for distance in (0.12, 0.18, 0.25)
}
