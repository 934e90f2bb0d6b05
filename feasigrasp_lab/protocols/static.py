"""Rules of the static test, and its ablations."""

from __future__ import annotations

import math

from pydrake.common.schema import Rotation

from feasigrasp.models.grasps.samplers import SamplerName, sampler_names
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.paper.judge import JudgeMethod
from feasigrasp_lab.protocols.changes import Change


def honest(scenario: Scenario) -> None:
    """The scenario as it is: any orientation, friction 0.6, noisy images, late grasps."""


def hard(scenario: Scenario) -> None:
    """Friction 0.3, the hand 5 mm and 5 degrees off its nominal pose, twice the mass."""
    scenario.object.friction = 0.3
    scenario.object.mass_factor = 2.0
    scenario.execution.position_error = 0.005
    scenario.execution.angle_error = math.radians(5.0)


def paper(scenario: Scenario) -> None:
    """As the paper's scripts: friction 100, one orientation, 0.1 kg, the arm put at a grasp."""
    scenario.object.friction = 100.0
    scenario.object.rotation = Rotation.Identity()
    scenario.object.mass = 0.1
    scenario.execution.teleport = True
    scenario.grasp.dwell = 0.0  # it is at the grasp: nothing to wait for


PROTOCOLS: dict[str, Change] = {each.__name__: each for each in (honest, hard, paper)}

#: What a sampler is followed by, by the name of the stage.
_STAGES = {
    "": (False, JudgeMethod.NONE),
    "+filter": (True, JudgeMethod.NONE),
    "+filter+reachability": (True, JudgeMethod.IK),
}
#: The whole pipeline: what the protocols run with when nothing is left out.
WHOLE = f"{SamplerName.NETWORK}+filter+reachability"


def _only(sampler: str, filtered: bool, method: JudgeMethod) -> Change:
    def change(scenario: Scenario) -> None:
        scenario.perception.sampler = sampler
        scenario.perception.filter = filtered
        scenario.reachability.method = method.value

    return change


#: The paper's ablation for each of the samplers: alone, with the filter, with reachability as well.
ABLATIONS: dict[str, Change] = {
    f"{sampler}{stage}": _only(sampler, *parts)
    for sampler in sampler_names()
    for stage, parts in _STAGES.items()
}
