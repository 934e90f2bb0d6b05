"""In the whole diagram: what the arm does while nobody knows where the object is."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.models.control.status import StatusCode
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp

START, DURATION, SILENCE = 1.2, 1.3, 0.4


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_it_rests_half_a_second_after_the_stated_silence_and_goes_on_after(controller):
    text = (
        f"{{random_seed: 0, object: {{model: soup_can}}, control: {{controller: {controller}}}, "
        f"tracker: {{silence: {SILENCE}}}, grasp: {{close: false}}, "
        f"faults: [!PoseNan {{start: {START}, duration: {DURATION}}}]}}"
    )
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinear", text)
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(4.0)
    context = simulator.get_context()
    log = diagram.GetSubsystemByName("log(drive)").FindLog(context)
    times, speed = log.sample_times(), np.abs(log.data()[7:]).max(axis=0)
    lost, found = START + SILENCE, START + DURATION
    assert speed[(times > lost - 0.1) & (times < lost)].min() > 0.1  # on its way until then
    assert speed[(times > lost + 0.5) & (times < found)].max() < 1e-3
    assert speed[times > found + 0.2].max() > 0.1
    monitor = diagram.GetSubsystemByName("status")
    history = monitor.history(monitor.GetMyContextFromRoot(context))
    (told,) = (status.time for status in history if status.code is StatusCode.POSE_LOST)
    assert lost <= told <= lost + 0.2
    assert history[-1].code is StatusCode.FOLLOWING
