"""What topics say is what the messages of the drivers say; no ROS is needed for that."""

from types import SimpleNamespace as Message

import numpy as np
from pydrake.common.value import Value

from diagrams.ros2_station import images, pose, status
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware.images import RgbdReceiver
from feasigrasp.systems.hardware.object_pose import ObjectPoseReceiver

HEADER = Message(stamp=Message(sec=3, nanosec=250_000_000), frame_id="camera")


def test_joints_are_told_by_their_names():
    names = list(reversed(IIWA_7.joint_names))
    found = status(Message(header=HEADER, name=names, position=list(range(7))))
    assert list(found.joint_position_measured) == [6, 5, 4, 3, 2, 1, 0]
    assert found.utime == 3_250_000
    assert found.encode()


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
