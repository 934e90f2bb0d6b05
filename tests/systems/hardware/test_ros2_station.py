"""What topics say is what the messages of the drivers say; no ROS is needed for that."""

from types import SimpleNamespace as Message

import numpy as np
from pydrake.common.value import Value
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import SchunkWsgStatusReceiver
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmSubscriberSystem

from diagrams.ros2_station import fingers, images, pose, status
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware.measurements import ObjectPoseReceiver, RgbdReceiver

HEADER = Message(stamp=Message(sec=3, nanosec=250_000_000), frame_id="camera")


def test_joints_are_told_by_their_names():
    names = list(reversed(IIWA_7.joint_names))
    found = status(Message(header=HEADER, name=names, position=list(range(7))))
    assert list(found.joint_position_measured) == [6, 5, 4, 3, 2, 1, 0]
    assert found.utime == 3_250_000
    assert found.encode()


def test_the_opening_comes_through():
    topic = Message(header=HEADER, name=["opening"], position=[0.05], velocity=[-0.02])
    message = fingers(topic)
    assert message.utime == 3_250_000
    lcm, builder = DrakeLcm("memq://"), DiagramBuilder()
    subscriber = builder.AddSystem(
        LcmSubscriberSystem.Make("FINGERS", type(message), lcm, use_cpp_serializer=True)
    )
    receiver = builder.AddSystem(SchunkWsgStatusReceiver())
    builder.Connect(subscriber.get_output_port(), receiver.get_input_port(0))
    simulator = Simulator(builder.Build())
    lcm.Publish("FINGERS", message.encode())
    lcm.HandleSubscriptions(0)
    simulator.AdvanceTo(0.01)
    context = receiver.GetMyContextFromRoot(simulator.get_context())
    opening = receiver.GetOutputPort("state").Eval(context)
    np.testing.assert_allclose(opening, [0.05, -0.02])
    assert fingers(Message(header=HEADER, position=[0.05], velocity=[])).actual_speed_mm_per_s == 0


def test_images_come_through(fixed_context):
    millimetres = np.arange(12, dtype="<u2").reshape(3, 4) + 500
    topic = Message(header=HEADER, encoding="16UC1", is_bigendian=0, width=4, height=3)
    topic.data = millimetres.tobytes()
    message = images(topic)
    assert message.encode()
    receiver = RgbdReceiver(4, 3)
    context = fixed_context(receiver, message=Value(message))
    depth = receiver.GetOutputPort("depth_image").Eval(context).data[:, :, 0]
    np.testing.assert_allclose(depth, 1e-3 * millimetres, rtol=1e-6)
    assert receiver.GetOutputPort("stamp").Eval(context)[0] == 3.25


def test_a_pose_comes_through(fixed_context):
    place = Message(x=0.5, y=-0.1, z=0.4)
    turn = Message(w=np.sqrt(0.5), x=0.0, y=0.0, z=np.sqrt(0.5))
    message = pose(Message(header=HEADER, pose=Message(position=place, orientation=turn)))
    receiver = ObjectPoseReceiver()
    context = fixed_context(receiver, message=Value(message))
    X = receiver.GetOutputPort("pose").Eval(context)
    np.testing.assert_allclose(X.translation(), [0.5, -0.1, 0.4])
    np.testing.assert_allclose(X.rotation().matrix()[:, 0], [0.0, 1.0, 0.0], atol=1e-7)
