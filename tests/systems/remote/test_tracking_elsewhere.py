"""The tracker that looks at images, in a process of its own, and the one here that it tells."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.remote.remote_stage import end_processes
from feasigrasp.systems.stages.remote import PROMPT_LATENCY
from tests.pipeline import scenario

UNTIL = 0.6


def test_what_is_tracked_elsewhere_is_where_the_object_is():
    """Judged by the truth; the frame of the first view moves with the object from then on."""
    setting = scenario("ReachLinear", text="{perception: {execution: processes}}")
    diagram = make_dynamic_grasp(setting)
    tracker, truth = diagram.subsystems.tracker, diagram.GetSubsystemByName("true_frame")
    tracker._look = pytest.fail  # images are for the other process
    simulator = Simulator(diagram)
    context = simulator.get_context()

    def pose(system, port):
        found = system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(context))
        return found.GetAsMatrix4()

    simulator.AdvanceTo(PROMPT_LATENCY - 1e-3)
    assert np.isnan(pose(tracker, "object_pose")[:3]).all()
    simulator.AdvanceTo(UNTIL)
    known = tracker.tracking(tracker.GetMyContextFromRoot(context))
    tracked = pose(tracker, "object_pose")
    true = truth.get_output_port().Eval(truth.GetMyContextFromRoot(context)).GetAsMatrix4()
    end_processes(diagram)
    # The last image was taken at 0.6 s or one before, and what it told is there a little later.
    assert not known.lost and known.age <= 1.5 / 30.0 + PROMPT_LATENCY
    assert np.linalg.norm(tracked[:3, 3] - true[:3, 3]) < 0.02


def test_a_faulty_mask_is_segmented_here():
    text = "{perception: {execution: processes}, faults: [!MaskEmpty {start: 1.0}]}"
    diagram = make_dynamic_grasp(scenario("ReachLinear", text=text))
    end_processes(diagram)
    assert not diagram.HasSubsystemNamed("remote_tracker")
