"""A camera that does not move tracks the object while that of the arm does not show it."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.errors import ScenarioError
from feasigrasp.models.control.status import StatusCode
from feasigrasp.models.objects.tracking import TrackingState
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.remote.remote_stage import end_processes
from tests.pipeline import SECOND_CAMERA, scenario

#: From then on the arm's camera shows nothing [s].
GONE = 1.0
BLIND = f"{{grasp: {{close: false}}, faults: [!CameraGone {{start: {GONE}}}]}}"


def simulated(until, *texts):
    """The diagram after a while, and its context."""
    diagram = make_dynamic_grasp(scenario("ReachLinear", *texts))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(until)
    return diagram, simulator.get_context(), simulator


def output(diagram, context, system, port):
    found = diagram.GetSubsystemByName(system)
    return found.GetOutputPort(port).Eval(found.GetMyContextFromRoot(context))


@pytest.mark.xfail(
    strict=True,
    reason="seed 2: two thirds of what the other camera sees of the shiny can are new, and no pose "
    "is accepted (`Registration.on_model`); the object is lost, and named so",
)
def test_it_is_tracked_by_the_other_camera_until_the_first_one_sees_it_again():
    # How far a run is off depends on what the arm came to see in the first second: several.
    errors = [error_by_the_other_camera(seed) for seed in (2, 1, 3)]
    assert np.median(errors) < 0.015 and max(errors) < 0.02


def error_by_the_other_camera(seed):
    """Of the position after two seconds [m]."""
    texts = (SECOND_CAMERA, BLIND, f"{{random_seed: {seed}}}")
    diagram, context, simulator = simulated(GONE - 0.05, *texts)
    learnt = output(diagram, context, "tracker", "keyframe").time
    for after in (0.5, 2.0):
        simulator.AdvanceTo(GONE + after)
        tracking = output(diagram, context, "tracker", "tracking")
        assert tracking.state is TrackingState.TRACKING
    assert tracking.in_view == 0.0  # of the camera that the arm carries
    # By what the camera at its side saw nothing was learnt.
    assert output(diagram, context, "tracker", "keyframe").time <= max(learnt, GONE)
    monitor = diagram.GetSubsystemByName("status")
    codes = [s.code for s in monitor.history(monitor.GetMyContextFromRoot(context))]
    assert StatusCode.LOOKING_FOR_OBJECT not in codes
    tracked = output(diagram, context, "tracker", "object_pose").translation()
    true = output(diagram, context, "true_frame", "frame_pose").translation()
    return float(np.linalg.norm(tracked - true))


def test_without_it_the_object_is_lost():
    diagram, context, _ = simulated(GONE + 1.0, BLIND)
    assert output(diagram, context, "tracker", "tracking").state is TrackingState.LOST


def test_in_another_process_its_images_are_looked_at_as_well():
    elsewhere = "{perception: {execution: processes}}"

    diagram = make_dynamic_grasp(scenario("ReachLinear", SECOND_CAMERA, elsewhere))
    remote = diagram.GetSubsystemByName("remote_tracker")
    names = [remote.get_input_port(i).get_name() for i in range(remote.num_input_ports())]
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.3)
    context = simulator.get_context()
    tracking = output(diagram, context, "tracker", "tracking")
    end_processes(diagram)
    assert tracking.state is TrackingState.TRACKING
    assert {f"second_{n}" for n in ("point_cloud", "camera_pose", "depth_image")} <= set(names)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("ReachLinear", "{perception: {second_camera: side}}", "beside perception.camera .* none"),
        ("ReachLinear", "{perception: {second_camera: wrist_camera}}", "cameras has none"),
        ("ReachLinearMocap", SECOND_CAMERA, "not tracked in images; give tracker"),
    ],
)
def test_what_cannot_be_is_refused(name, text, message):
    with pytest.raises(ScenarioError, match=message):
        scenario(name, text)
