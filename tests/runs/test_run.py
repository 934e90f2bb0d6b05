"""Every scenario runs, one of each kind with either controller, and leaves a valid record."""

import gc
import json
import re
import weakref
from dataclasses import replace
from importlib import resources

import jsonschema
import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.object import ObjectMoved
from feasigrasp.outputs import write_json
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.run_metrics import summarize
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.runs.run import crash_record, run
from feasigrasp.scenario.files import load_scenario, parse_scenario, scenario_names
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.metrics import SAMPLE_NAMES

FILE = diagram_path("dynamic.scenarios.yaml")


@pytest.fixture(scope="module")
def validator():
    schema = json.loads(resources.files("feasigrasp.runs").joinpath("run.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def short(name, *, controller="task", duration=0.12, seed=3, model="soup_can"):
    return load_scenario(
        FILE,
        name,
        f"{{simulation_duration: {duration}, random_seed: {seed}, object: {{model: {model}}},"
        f" control: {{controller: {controller}}}}}",
    )


def both_controllers():
    """Of scenarios that differ by the motion alone, one has both."""
    for name in scenario_names(FILE):
        yield name, "task"
        if not any(motion in name for motion in ("Sinusoidal", "Bezier", "Fast")):
            yield name, "joint"


@pytest.mark.parametrize(("name", "controller"), [*both_controllers()])
def test_every_scenario_runs_with_either_controller(name, controller, validator, tmp_path):
    scenario = short(name, controller=controller, model="small_box")
    result = run(scenario, name)
    write_json(result.record, tmp_path / "deep" / "result.json")
    record = json.loads((tmp_path / "deep" / "result.json").read_text())
    validator.validate(record)
    assert record == result.record
    assert record["error"] is None
    assert (record["scenario"], record["controller"], record["seed"]) == (name, controller, 3)
    assert record["timings"]["simulated_s"] == pytest.approx(0.12)
    assert record["metrics"]["grasp_held"] is (None if name.startswith("Paper") else False)
    assert parse_scenario(record["scenario_yaml"]).control.controller == controller
    np.testing.assert_allclose(result.times, np.arange(0.0, 0.121, 0.02), atol=1e-9)
    assert result.samples.shape == (len(SAMPLE_NAMES), len(result.times))


def test_the_same_seed_gives_the_same_samples_bit_for_bit():
    first, again = (run(short("ReachCircularMocap", duration=0.8)) for _ in range(2))
    assert np.isfinite(first.samples[SAMPLE_NAMES.index("grasp_position_error"), -1])
    np.testing.assert_array_equal(first.samples, again.samples)
    metrics = [result.record["metrics"] for result in (first, again)]
    times = [name for name in METRICS if "_ms_" in name]
    assert all(record.pop(name) > 0.0 for record in metrics for name in times) and len(times) == 7
    assert metrics[0] == metrics[1]


def test_a_log_changes_nothing_and_holds_the_run():
    with_log, without = (
        run(short("ReachCircularMocap", duration=0.3), log=log) for log in (True, False)
    )
    np.testing.assert_array_equal(with_log.samples, without.samples)
    assert without.log == {}
    height = SAMPLE_NAMES.index("p_WO_z")
    every = with_log.log["X_WO_true"][::4, 2, 3]
    np.testing.assert_allclose(every, with_log.samples[height], atol=1e-12)


def test_a_result_says_how_it_went():
    result = run(short("ReachLinearMocap"), "ReachLinearMocap")
    assert result.held is False and result.metrics is result.record["metrics"]
    assert result.cause.startswith("no")  # no grasp yet
    assert repr(result) == (
        f"<Result: not held: {result.cause} (ReachLinearMocap, soup_can, seed 3)>"
    )
    said = [[status.time, status.code, status.detail] for status in result.status]
    assert said == result.record["status"]
    followed = run(short("PaperLinear"))
    assert followed.held is None and followed.cause is None
    assert repr(followed).startswith("<Result: followed, with an open gripper")


def test_another_seed_gives_another_run():
    starts = [run(short("ReachLinearMocap", duration=0.02, seed=k)).samples[:, 0] for k in (3, 4)]
    moved = SAMPLE_NAMES.index("p_WO_y")
    assert abs(starts[0][moved] - starts[1][moved]) > 1e-3


def test_metrics_of_the_record_are_those_of_the_samples():
    result = run(short("ReachLinearMocap"))
    of_samples = summarize(result.samples, closes=True)
    record = result.record["metrics"]
    assert {name for name in METRICS if record[name] != of_samples[name]} <= {
        "velocity_limit_violation_percent",
        "acceleration_limit_violation_percent",
        "velocity_peak_percent",
        "acceleration_peak_percent",
        "obstacle_distance_min_mm",
        "true_acceleration_peak_percent",
        "true_acceleration_violation_percent",
        "contact_impulse_n_s",
        *(name for name in METRICS if name.startswith(("self_", "torque_"))),
        *(name for name in METRICS if name.startswith(("control_", "planning_"))),
        "friction",
        "view_faults",
        "contact_force_peak_n",
        "contact_time_percent",
    }
    # These are of the control's ticks, of Drake's geometry and contact solver, and of a clock.
    assert record["self_collision_percent"] == 0.0
    assert 5.0 < record["torque_peak_percent"] < 100.0  # the weight alone is a tenth
    assert of_samples["acceleration_peak_percent"] is None
    assert 0.0 <= record["velocity_peak_percent"] < 100.0
    assert record["obstacle_distance_min_mm"] > 50.0
    assert record["contact_time_percent"] == record["contact_force_peak_n"] == 0.0


def test_a_drive_that_clips_nothing_shows_in_the_record():
    """The law without limits is not stopped by the drive; with them, the same metric is zero."""
    shares = {}
    for mode in ("safe", "corrected"):
        config = short("ReachLinearMocap", duration=0.6)
        config = replace(config, control=replace(config.control, mode=mode))
        metrics = run(config, "ReachLinearMocap").record["metrics"]
        assert metrics["grasp_position_error_mm_median"] > 0.0  # there was something to go to
        shares[mode] = metrics["acceleration_limit_violation_percent"]
    assert shares["safe"] == 0.0
    assert shares["corrected"] > 0.5


@pytest.mark.parametrize(
    "choice",
    [
        "control: {controller: task, mode: paper}",
        "control: {controller: joint, mode: paper}",
        "control: {controller: joint, mode: corrected, options: {source: flow}}",
        "reachability: {method: rmm}",
        "reachability: {method: both}",
        "perception: {sampler: antipodal}",
        "perception: {sampler: paper}",
        "perception: {preset: paper}",
    ],
)
def test_every_choice_moves_the_arm_towards_grasps(choice):
    # So long that a way that begins by leading round is nearer in the end.
    text = f"{{simulation_duration: 1.6, object: {{model: soup_can}}, {choice}}}"
    result = run(load_scenario(FILE, "ReachLinearMocap", text), log=False)
    metrics = result.record["metrics"]
    assert result.record["error"] is None
    assert metrics["no_grasp_percent"] < 90.0
    assert metrics["velocity_peak_percent"] > 5.0
    distance = result.samples[SAMPLE_NAMES.index("grasp_position_error")]
    distance = distance[np.isfinite(distance)]
    assert distance[-1] < distance.max() - 0.005


def test_a_failing_simulation_is_reported(monkeypatch, validator):
    """What Drake raises while it simulates ends the run, not the evaluation."""

    def breaks(self, context):
        if context.get_time() > 0.05:
            raise RuntimeError("the solver did not converge")
        return self.state(context)

    monkeypatch.setattr(GripperSequencer, "_advance", breaks)
    record = run(short("ReachLinearMocap", duration=0.5), "ReachLinearMocap").record
    validator.validate(record)
    assert "did not converge" in record["error"]
    assert record["metrics"]["grasp_held"] is False
    assert record["metrics"]["cause"] == "broke_off"
    assert 0.0 < record["timings"]["simulated_s"] < 0.5


def test_what_an_own_part_raises_is_told_with_its_place(monkeypatch, validator, capsys):
    def reach(self, context):
        raise ZeroDivisionError("too near")

    monkeypatch.setattr(GripperSequencer, "_advance", reach)
    record = run(short("ReachLinear"), "ReachLinear").record
    validator.validate(record)
    assert re.fullmatch(
        r"ZeroDivisionError: too near \(.*test_run\.py:\d+, in reach\)", record["error"]
    )
    assert "Traceback" in capsys.readouterr().err


STILL = """
from pydrake.systems.framework import LeafSystem

class Still(LeafSystem):
    def __init__(self, reachability, joints=7):
        super().__init__()
        self.DeclareVectorInputPort("position", 7)
        zeros = [0.0] * joints
        self.DeclareVectorOutputPort(
            "commanded_velocity", joints, lambda context, v: v.SetFromVector(zeros)
        )

class Mute(LeafSystem):
    def __init__(self, reachability):
        super().__init__()
"""


def own_controller(name, tmp_path, monkeypatch, options=""):
    (tmp_path / "still.py").write_text(STILL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    part = f"{{parts: {{controller: {{name: 'still:{name}', options: {{{options}}}}}}}}}"
    filename = diagram_path("dynamic.scenarios.yaml")
    return load_scenario(filename, "ReachLinearMocap", "{simulation_duration: 0.12}", part)


def test_a_controller_of_ones_own_needs_no_more_than_its_output(tmp_path, monkeypatch, validator):
    """It has neither plans nor commands whose times could be stopped."""
    record = run(own_controller("Still", tmp_path, monkeypatch), "ReachLinearMocap").record
    validator.validate(record)
    assert record["error"] is None
    assert record["metrics"]["control_ms_worst"] is None


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("Mute", "", "the controller, a Mute, has no input port position or no output"),
        ("Still", "joints: 6", r"Still\.commanded_velocity has 6 numbers; give .* 7 joints"),
    ],
)
def test_a_controller_that_the_arm_cannot_obey_is_refused(
    name, options, message, tmp_path, monkeypatch
):
    with pytest.raises(ScenarioError, match=message):
        run(own_controller(name, tmp_path, monkeypatch, options), "ReachLinearMocap")


def test_a_run_is_over_when_its_object_has_fallen(validator):
    """An object that falls for ever, and spins, would end the simulation with an error."""
    scenario = short("ReachLinearMocap", duration=5.0)
    scenario.faults = [ObjectMoved(to=[6.0, 0.0, -2.0], ramp=3.0)]  # past the table
    result = run(scenario, "ReachLinearMocap")
    validator.validate(result.record)
    assert result.record["error"] is None
    assert result.record["metrics"]["grasp_held"] is False
    assert 1.0 < result.record["timings"]["simulated_s"] < 3.0


@pytest.mark.parametrize(("name", "held"), [("ReachLinearMocap", False), ("PaperLinear", None)])
def test_a_crash_leaves_a_valid_record(name, held, validator):
    record = crash_record(short(name), name, "the process ended with status -11")
    validator.validate(record)
    assert record["metrics"]["grasp_held"] is held
    assert record["metrics"]["cause"] == (None if held is None else "broke_off")


def test_the_schema_can_fail(validator):
    record = crash_record(short("ReachLinearMocap"), "ReachLinearMocap", "crashed")
    for broken in (
        record | {"controller": "magic"},
        record | {"status": [[0.0, "bored", ""]]},
        record | {"metrics": record["metrics"] | {"no_grasp_percent": 101.0}},
        record | {"metrics": record["metrics"] | {"extra": 1.0}},
        record | {"metrics": record["metrics"] | {"cause": "bad luck"}},
        {key: value for key, value in record.items() if key != "git"},
    ):
        assert not validator.is_valid(broken)


def test_nothing_of_a_run_stays_alive(monkeypatch):
    """Renderers have threads; processes that are forked later would wait for them for ever."""
    alive = []

    def simulator_of(diagram):
        simulator = Simulator(diagram)
        alive.append(weakref.ref(simulator))
        return simulator

    monkeypatch.setattr("feasigrasp.runs.run.Simulator", simulator_of)
    run(load_scenario(FILE, "ReachLinearMocap", "{simulation_duration: 0.1}"))
    gc.collect()
    assert [simulator() for simulator in alive] == [None]
    assert gc.get_freeze_count() == 0
