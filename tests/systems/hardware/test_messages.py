"""Images and poses are the same behind the wire, as exactly as the messages are."""

import numpy as np
import pytest
from drake import lcmt_image, lcmt_image_array
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmPublisherSystem
from pydrake.systems.primitives import ConstantValueSource
from pydrake.systems.sensors import ImageDepth16U, ImageToLcmImageArrayT, PixelType

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.tracker_config import TrackerConfig
from feasigrasp.systems.hardware.object_pose import (
    ObjectPoseReceiver,
    ObjectPoseSender,
    pose_message,
)
from feasigrasp.systems.hardware.rgbd_receiver import RgbdReceiver
from feasigrasp.systems.station.pose_at import PoseAt, PositionAt

SIZE = (6, 4)


def sent(millimetres, *, compress):
    """The message that Drake's own system makes of a depth image."""
    image = ImageDepth16U(*SIZE)
    image.mutable_data[:, :, 0] = millimetres
    system = ImageToLcmImageArrayT(do_compress=compress)
    system.DeclareImageInputPort[PixelType.kDepth16U]("depth")
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantValueSource(Value(image)))
    builder.AddSystem(system)
    builder.Connect(source.get_output_port(), system.get_input_port(0))

    lcm, got = DrakeLcm("memq://"), []
    publisher = builder.AddSystem(
        LcmPublisherSystem.Make("images", lcmt_image_array, lcm, use_cpp_serializer=True)
    )
    builder.Connect(system.get_output_port(), publisher.get_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    context.SetTime(0.25)
    subscription = lcm.Subscribe("images", lambda data: got.append(lcmt_image_array.decode(data)))
    diagram.ForcedPublish(context)
    lcm.HandleSubscriptions(0)
    del subscription
    return got[0]


def received(message, fixed_context):
    receiver = RgbdReceiver(*SIZE)
    context = fixed_context(receiver, message=Value(message))
    depth, labels, stamp = (receiver.GetOutputPort(name).Eval(context) for name in PORTS)
    return depth.data[:, :, 0], labels.data[:, :, 0], stamp[0]


PORTS = ("depth_image", "label_image", "stamp")


@pytest.mark.parametrize("compress", [True, False])
def test_depth_comes_in_millimetres(fixed_context, compress):
    millimetres = np.arange(24).reshape(4, 6) * 100
    millimetres[0, 1] = 65535
    depth, labels, stamp = received(sent(millimetres, compress=compress), fixed_context)
    expected = np.where((millimetres > 0) & (millimetres < 65535), 1e-3 * millimetres, np.inf)
    np.testing.assert_allclose(depth, expected.astype(np.float32))
    assert not labels.any() and stamp == 0.25


def test_what_is_no_depth_image_shows_nothing(fixed_context):
    good = sent(np.full((4, 6), 500), compress=True)
    for change in (
        {"data": b"no zlib"},
        {"height": 5},
        {"channel_type": lcmt_image.CHANNEL_TYPE_FLOAT32},
        {"compression_method": lcmt_image.COMPRESSION_METHOD_JPEG},
        {"bigendian": True},
    ):
        image = lcmt_image.decode(good.images[0].encode())
        for name, value in change.items():
            setattr(image, name, value)
        message = lcmt_image_array()
        message.num_images, message.images = 1, [image]
        assert np.isinf(received(message, fixed_context)[0]).all()
    assert np.isnan(received(lcmt_image_array(), fixed_context)[2])


def test_a_pose_comes_through(fixed_context):
    X = se3.random_pose(np.random.default_rng(0), 1)[0]
    sender = ObjectPoseSender(TrackerConfig(period=0.01, latency=0.02))
    context = fixed_context(sender, pose=Value(RigidTransform(X)))
    message = sender.get_output_port().Eval(context)
    assert message.utime == -1
    receiver = ObjectPoseReceiver()
    values = np.concatenate([se3.quaternions(X), X[:3, 3]])
    context = fixed_context(receiver, message=Value(pose_message(0.5, values)))
    found = receiver.GetOutputPort("pose").Eval(context).GetAsMatrix4()
    np.testing.assert_allclose(found, X, atol=1e-6)
    assert receiver.GetOutputPort("stamp").Eval(context)[0] == 0.5


def test_a_pose_that_is_none_is_unknown(fixed_context):
    strange = pose_message(0.5, np.zeros(7))
    other = pose_message(0.5, np.array([1.0, 0, 0, 0, 0, 0, 0]))
    other.joint_name = ["joint"] * 7
    receiver = ObjectPoseReceiver()
    for message in (strange, other):
        context = fixed_context(receiver, message=Value(message))
        assert np.isnan(receiver.GetOutputPort("pose").Eval(context).GetAsMatrix4()[0, 0])


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
