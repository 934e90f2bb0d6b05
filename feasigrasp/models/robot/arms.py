"""Arms by name or file."""

from __future__ import annotations

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import nearest
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7

ARMS = {"iiwa7": IIWA_7}


def load_arm(name: str) -> Arm:
    """An arm by its name.

    Raises:
        ScenarioError: There is none.
    """
    if name not in ARMS:
        raise ScenarioError(f"there is no arm {name!r}{nearest(name, ARMS)}")
    return ARMS[name]
