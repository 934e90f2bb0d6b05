"""Runs with seed 1, which repeat bit for bit, judged by what has become of the object."""

import numpy as np

from feasigrasp.resources import diagram_path
from feasigrasp.runs.run import run
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.metrics import SAMPLE_NAMES

SEED = 1


def seeded(name: str, model: str, controller: str) -> Scenario:
    """A scenario of the dynamic test with that object and controller, and `SEED`.

    It shakes the object once to and fro, and holds it for so long as is judged here; the whole
    sequence is in ``tests/lab/runs/test_whole_runs.py``.
    """
    text = f"{{object: {{model: {model}}}, control: {{controller: {controller}}}}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), name, text)
    scenario.random_seed = scenario.tracker.seed = SEED
    scenario.grasp.shake_time = 1.0 / scenario.grasp.shake_frequency
    scenario.grasp.hold_time = 1.0
    return scenario


def assert_held(name: str, model: str, controller: str) -> None:
    """The run says that the object is held; and it was lifted, and stays where the hand is."""
    result = run(seeded(name, model, controller), name, log=False)
    metrics = result.record["metrics"]
    assert metrics["grasp_held"] is True, metrics["cause"]
    x = dict(zip(SAMPLE_NAMES, result.samples, strict=True))
    last = result.times > result.times[-1] - 1.0
    assert metrics["lift_cm"] > 8.0
    for axis in "xyz":
        assert np.ptp(x[f"p_WO_{axis}"][last]) < 0.01  # the spring that moved it is switched off
