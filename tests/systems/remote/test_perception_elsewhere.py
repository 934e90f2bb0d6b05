"""The whole pipeline with perception in a process of its own, in simulation."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.errors import ScenarioError
from feasigrasp.models.grasps.samplers import AntipodalSampler
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.one_thread import one_thread
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.remote.remote_stage import end_processes
from tests.pipeline import scenario

#: Grasps of the view at the start are there after 0.1 s, those of the next one after 0.6 s.
LATENCY, UNTIL = 0.1, 0.7


def simulated(execution):
    """Grasps every 50 ms as the controller gets them, the field's time, and the arm's path."""
    text = f"{{perception: {{execution: {execution}, latency: {LATENCY}}}}}"
    diagram = make_dynamic_grasp(scenario(text=text))
    simulator = Simulator(diagram)
    context = simulator.get_context()
    perception, late = diagram.subsystems.perception, diagram.GetSubsystemByName("latency")
    grasps, seen = [], []
    for instant in np.arange(0.025, UNTIL, 0.05):
        simulator.AdvanceTo(instant)
        found = late.get_output_port().Eval(late.GetMyContextFromRoot(context))
        grasps.append((found.X_OG, found.id, found.score))
        at = perception.GetOutputPort("view_time").Eval(perception.GetMyContextFromRoot(context))
        seen.append(at[0])
    end_processes(diagram)
    log = diagram.GetSubsystemByName("log(arm)").FindLog(context)
    return grasps, np.array(seen), log.data().copy()


@pytest.fixture(scope="module")
def runs():
    with one_thread():  # as the processes compute
        return simulated("processes"), simulated("processes"), simulated("inline")


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_a_run_repeats_bit_for_bit(runs):
    first, second, _ = runs
    assert all(same(a, b) for a, b in zip(first[0], second[0], strict=True))
    np.testing.assert_array_equal(first[1], second[1])
    np.testing.assert_array_equal(first[2], second[2])
    assert np.ptp(first[2][:7], axis=1).max() > 0.01  # it moves


def test_results_are_there_at_the_latency_and_no_sooner(runs):
    grasps, seen, _ = runs[0]
    counts = [len(X_OG) for X_OG, _, _ in grasps]
    assert counts[:2] == [0, 0] and counts[2] > 0
    assert np.isnan(seen[:2]).all() and (seen[2:12] == 0.0).all() and (seen[12:] == 0.5).all()


def test_the_grasps_of_a_view_are_those_that_are_found_inline(runs):
    elsewhere, _, inline = runs
    assert len(elsewhere[0][2][0]) > 0
    assert all(same(a, b) for a, b in zip(elsewhere[0][:12], inline[0][:12], strict=True))


def test_what_cannot_go_to_another_process_is_refused():
    text = "{perception: {execution: processes}, %s}"
    with pytest.raises(ScenarioError, match="parts"):
        sampler = AntipodalSampler(ParallelGripper())
        make_dynamic_grasp(scenario(text=text % "random_seed: 1"), sampler=sampler)
    with pytest.raises(ScenarioError, match="PerceptionLate"):
        make_dynamic_grasp(scenario(text=text % "faults: [!PerceptionLate {start: 1.0}]"))
    with pytest.raises(ScenarioError, match="inline"):
        scenario(text="{perception: {execution: threads}}")
