"""Joints and poses at an image are those of its time."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from feasigrasp.models.geometry import se3
from feasigrasp.systems.station.exposures import PoseAt, PositionAt


def test_the_joints_at_an_image_are_those_of_its_time():
    system, rates = PositionAt(0.005, 2), np.array([0.4, -1.0])
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    for k in range(150):
        system.GetInputPort("position").FixValue(context, 0.005 * k * rates)
        system.GetInputPort("stamp").FixValue(context, [0.0])
        system.GetInputPort("measured_at").FixValue(context, [0.005 * k])
        if 100 < k < 110:
            continue  # busy: the next message will be a later one
        simulator.AdvanceTo(0.005 * k)
        simulator.AdvancePendingEvents()
    for stamp, then in ((0.5123, 0.5123), (9.0, 0.745), (0.0, 0.205), (np.nan, 0.205)):
        system.GetInputPort("stamp").FixValue(context, [stamp])
        found = system.get_output_port().Eval(context)
        np.testing.assert_allclose(found, then * rates, atol=1e-9)


def test_the_pose_at_an_image_is_that_of_its_time():
    w, v = np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.2, -0.1])
    system = PoseAt(0.005)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()

    def pose(t):
        return RigidTransform(se3.make_pose(se3.so3_exp(t * w), t * v))

    fixed = system.GetInputPort("pose").FixValue(context, Value(pose(0.0)))
    system.GetInputPort("stamp").FixValue(context, [0.0])
    for k in range(60):
        fixed.GetMutableData().set_value(pose(0.005 * k))
        simulator.AdvanceTo(0.005 * k)
        simulator.AdvancePendingEvents()

    def found(t):
        system.GetInputPort("stamp").FixValue(context, [t])
        return system.get_output_port().Eval(context).GetAsMatrix4()

    for t in (0.0123, 0.1, 0.2871):
        np.testing.assert_allclose(found(t), pose(t).GetAsMatrix4(), atol=1e-6)
    np.testing.assert_allclose(found(9.0), pose(0.295).GetAsMatrix4(), atol=1e-9)  # not there yet
    np.testing.assert_allclose(found(-1.0), pose(0.0).GetAsMatrix4(), atol=1e-9)
