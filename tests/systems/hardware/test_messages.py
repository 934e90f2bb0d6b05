"""Images and poses are the same behind the wire, as exactly as the messages are."""

import gc
import os
import weakref

import numpy as np
import pytest
from drake import lcmt_image, lcmt_image_array
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmPublisherSystem
from pydrake.systems.primitives import ConstantValueSource
from pydrake.systems.sensors import ImageDepth16U, ImageToLcmImageArrayT, PixelType

from feasigrasp.errors import HardwareError
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.tracking import TrackerConfig
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.measurements import (
    ObjectPoseReceiver,
    ObjectPoseSender,
    RgbdReceiver,
    pose_message,
)

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
    expected = np.where(millimetres < 65535, 1e-3 * millimetres, np.inf)
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
        assert not received(message, fixed_context)[0].any()
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


@pytest.mark.parametrize(
    "url",
    [
        "nonsense",
        "udpm://300.1.1.1:7667",
        "udpm://10.0.0.1:7667",
        "udpm://239.1.1.1:99999",
        "tcpq:",
    ],
)
def test_a_url_of_no_message_bus_is_refused_at_once(url):
    """LCM itself takes it, and waits for messages that cannot come."""
    with pytest.raises(HardwareError, match="--lcm-url .* is no message bus: give udpm://"):
        channels.open_lcm(url)


@pytest.mark.parametrize("url", [channels.LCM_URL, "memq://"])
def test_urls_of_message_buses_are_taken(url):
    assert isinstance(channels.open_lcm(url), DrakeLcm)


def test_what_receives_messages_is_freed_with_its_bus():
    class Receiver:
        def __init__(self):
            self.lcm, self.got = DrakeLcm("memq://"), []
            channels.subscribe(self.lcm, "words", self.receive, "given")

        def receive(self, given, data):
            self.got.append((given, data))

    receiver, there = Receiver(), len(os.listdir("/proc/self/fd"))
    receiver.lcm.Publish("words", b"message")
    receiver.lcm.HandleSubscriptions(0)
    assert receiver.got == [("given", b"message")]
    gone = weakref.ref(receiver)
    del receiver
    gc.collect()
    assert gone() is None
    assert len(os.listdir("/proc/self/fd")) < there
