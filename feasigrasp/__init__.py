"""feasigrasp: feasible grasping of moving objects, as Drake systems.

A run, and how it went::

    import feasigrasp as fg

    result = fg.run(fg.load_scenario("ReachLinear"))
    print(result.held, result.log["X_WO"][-1])
"""

from feasigrasp.lazy import TYPE_CHECKING, hand_on

if TYPE_CHECKING:
    from feasigrasp.runs.run import Result, run
    from feasigrasp.scenario.files import load_scenario
    from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp

__version__ = "0.1.0"
__all__ = ["Result", "load_scenario", "make_dynamic_grasp", "run"]

__getattr__, __dir__ = hand_on(
    __name__,
    {
        "Result": "runs.run",
        "load_scenario": "scenario.files",
        "make_dynamic_grasp": "systems.dynamic_grasp",
        "run": "runs.run",
    },
)
