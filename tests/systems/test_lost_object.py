"""In the whole diagram: what the arm does while nobody knows where the object is."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.models.control.status import StatusCode
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp

#: Before the hand is where the object would run into it.
START, DURATION, SILENCE = 0.4, 1.3, 0.4


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_it_rests_half_a_second_after_the_stated_silence_and_goes_on_after(controller):
    text = (
        f"{{random_seed: 1, object: {{model: soup_can}}, control: {{controller: {controller}}}, "
        f"tracker: {{silence: {SILENCE}}}, grasp: {{close: false}}, "
        f"faults: [!PoseNan {{start: {START}, duration: {DURATION}}}]}}"
    )
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", text)
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(3.4)
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


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_with_the_camera_alone_it_looks_for_the_object_and_goes_on_when_it_is_back(controller):
    start, duration = 1.0, 2.5
    text = (
        f"{{random_seed: 1, object: {{model: soup_can}}, control: {{controller: {controller}}}, "
        f"grasp: {{close: false}}, faults: [!CameraGone {{start: {start}, duration: {duration}}}]}}"
    )
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinear", text)
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(start + duration)
    context = simulator.get_context()
    station = diagram.GetSubsystemByName("station")
    station_context = station.GetMyContextFromRoot(context)
    X_WC, X_WB = (
        station.GetOutputPort(name).Eval(station_context)
        for name in ("wrist_camera.pose", "object.pose")
    )
    # The object, which has gone on meanwhile, is in the image (87 x 58 degrees), some way off.
    p_CO = X_WC.inverse() @ X_WB.translation()
    assert 0.15 < p_CO[2] < 0.6
    assert np.all(np.abs(p_CO[:2]) < np.tan(np.deg2rad([43.5, 29.0])) * p_CO[2])
    simulator.AdvanceTo(start + duration + 1.0)
    monitor = diagram.GetSubsystemByName("status")
    history = monitor.history(monitor.GetMyContextFromRoot(context))
    times = {status.code: status.time for status in history}
    assert start + 0.2 <= times[StatusCode.LOOKING_FOR_OBJECT] <= start + 0.6
    assert history[-1].code is StatusCode.FOLLOWING
    log = diagram.GetSubsystemByName("log(drive)").FindLog(context)
    speed = np.abs(log.data()[7:])
    assert (speed <= IIWA_7.velocity_limits[:, None] + 1e-9).all()
