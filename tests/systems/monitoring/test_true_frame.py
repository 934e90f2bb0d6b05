"""The frame of a tracker, followed on the true object."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw

from feasigrasp.models.tracking.tracker import FieldTrack
from feasigrasp.systems.metrics import TrueFrame

UNKNOWN = RigidTransform(np.full((3, 4), np.nan))
X_WB = RigidTransform(RollPitchYaw(0.1, 0.7, 2.0), [0.5, -0.1, 0.4])
X_BO = RigidTransform(RollPitchYaw(-1.0, 0.2, 0.3), [0.02, 0.01, -0.03])
MOVED = RigidTransform(RollPitchYaw(0.5, 0.0, -1.0), [0.1, 0.2, 0.3])


def at(dut, context, true, tracked, at_view=None):
    """The frame after one update with these poses; by default the image is of now."""
    dut.GetInputPort("object_pose").FixValue(context, true)
    dut.GetInputPort("pose_at_view").FixValue(context, at_view or true)
    dut.GetInputPort("tracked_pose").FixValue(context, tracked)
    updated = dut.EvalUniquePeriodicDiscreteUpdate(context)
    context.get_mutable_discrete_state_vector().SetFromVector(updated.get_vector().value())
    return dut.get_output_port().Eval(context).GetAsMatrix4()


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(TrueFrame(0.0025))
    assert (list(inputs), list(outputs)) == documented_ports(TrueFrame)


def test_it_is_aligned_once_and_then_follows_the_object():
    dut = TrueFrame(0.0025)
    context = dut.CreateDefaultContext()
    np.testing.assert_allclose(at(dut, context, X_WB, UNKNOWN), X_WB.GetAsMatrix4())
    first = at(dut, context, X_WB, X_WB @ X_BO)
    np.testing.assert_allclose(first, (X_WB @ X_BO).GetAsMatrix4(), atol=1e-12)
    # The tracker drifts, and loses the object: the frame stays on it.
    for tracked in (MOVED, UNKNOWN):
        later = at(dut, context, MOVED @ X_WB, tracked)
        np.testing.assert_allclose(later, (MOVED @ X_WB @ X_BO).GetAsMatrix4(), atol=1e-12)


def test_a_frame_that_the_tracker_begins_anew_is_aligned_anew():
    dut = TrueFrame(0.0025)
    context = dut.CreateDefaultContext()
    begun = [AbstractValue.Make(FieldTrack(begun_at=t)) for t in (0.1, 2.0)]
    dut.GetInputPort("track").FixValue(context, begun[0])
    at(dut, context, X_WB, X_WB @ X_BO)
    dut.GetInputPort("track").FixValue(context, begun[1])
    later = at(dut, context, X_WB, X_WB @ MOVED)
    np.testing.assert_allclose(later, (X_WB @ MOVED).GetAsMatrix4(), atol=1e-12)


def test_where_the_frame_is_on_the_object_is_of_the_exposure():
    """The object has gone on since the image was taken; the frame was chosen where it was."""
    dut = TrueFrame(0.0025)
    frame = at(dut, dut.CreateDefaultContext(), MOVED @ X_WB, X_WB @ X_BO, at_view=X_WB)
    np.testing.assert_allclose(frame, (MOVED @ X_WB @ X_BO).GetAsMatrix4(), atol=1e-12)
