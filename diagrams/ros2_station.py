"""The station's ports fed from ROS 2 topics: a pattern to copy, for cells without LCM drivers.

    python diagrams/ros2_station.py --camera /camera/depth/image_rect_raw

Not a dependency: it needs a sourced ROS 2 (``rclpy``, ``sensor_msgs``, ``geometry_msgs``). It
translates topics into the messages of ``docs/hardware.md`` and back, so that ``feasigrasp run
SCENARIO --hardware`` and its guard work as they do with Drake's drivers. Topics: ``joint_states``,
``gripper_states`` (one joint: the distance between the pads) and the object's ``pose`` in,
``joint_command`` (positions) and ``gripper_command`` (metres) out.
"""

import importlib
import sys
import zlib

import numpy as np
from drake import (
    lcmt_header,
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_image,
    lcmt_image_array,
    lcmt_schunk_wsg_command,
    lcmt_schunk_wsg_status,
)
from pydrake.lcm import DrakeLcm

from feasigrasp.cli import command_parser
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.measurements import pose_message


def microseconds(stamp) -> int:
    """A ROS time as messages on the wire have it."""
    return int(stamp.sec * 1_000_000 + stamp.nanosec // 1000)


def status(joint_state) -> lcmt_iiwa_status:
    """A ``sensor_msgs/JointState`` as the status of the arm's driver."""
    at = {name: index for index, name in enumerate(joint_state.name)}
    order = [at[name] for name in IIWA_7.joint_names]
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = microseconds(joint_state.header.stamp), IIWA_7.joints
    for name in message.__slots__[2:]:
        setattr(message, name, [0.0] * IIWA_7.joints)
    message.joint_position_measured = [joint_state.position[i] for i in order]
    message.joint_position_commanded = message.joint_position_measured
    return message


def fingers(joint_state) -> lcmt_schunk_wsg_status:
    """A ``JointState`` of the distance between the pads [m] as the status of a WSG's driver."""
    message = lcmt_schunk_wsg_status()
    message.utime = microseconds(joint_state.header.stamp)
    message.actual_position_mm = 1e3 * joint_state.position[0]
    message.actual_speed_mm_per_s = 1e3 * joint_state.velocity[0] if joint_state.velocity else 0.0
    return message


def images(depth) -> lcmt_image_array:
    """A ``sensor_msgs/Image`` of encoding 16UC1 [mm] as the message of a camera."""
    if depth.encoding != "16UC1":
        raise SystemExit(f"the depth image is {depth.encoding}; 16UC1 (millimetres) is needed")
    pixels = np.frombuffer(bytes(depth.data), ">u2" if depth.is_bigendian else "<u2")
    header = lcmt_header()
    header.utime, header.frame_name = microseconds(depth.header.stamp), depth.header.frame_id
    image = lcmt_image()
    image.header, image.width, image.height = header, depth.width, depth.height
    image.row_stride, image.pixel_format = 2 * depth.width, lcmt_image.PIXEL_FORMAT_DEPTH
    image.channel_type = lcmt_image.CHANNEL_TYPE_UINT16
    image.compression_method = lcmt_image.COMPRESSION_METHOD_ZLIB
    image.data = zlib.compress(pixels.astype("<u2").tobytes(), 1)
    image.size = len(image.data)
    message = lcmt_image_array()
    message.header, message.num_images, message.images = header, 1, [image]
    return message


def pose(stamped):
    """A ``geometry_msgs/PoseStamped`` as the message of a motion-capture system."""
    q, p = stamped.pose.orientation, stamped.pose.position
    values = np.array([q.w, q.x, q.y, q.z, p.x, p.y, p.z])
    return pose_message(1e-6 * microseconds(stamped.header.stamp), values)


def main() -> int:
    """Translates until ROS is shut down."""
    parser = command_parser("ros2_station.py", (__doc__ or "").partition(".\n")[0])
    parser.add_argument(
        "--camera", default="/camera/depth/image_rect_raw", help="Topic of the depth images."
    )
    parser.add_argument(
        "--camera-name", default="wrist_camera", help="Name of the camera in the scenario."
    )
    parser.add_argument("--lcm-url", default=channels.LCM_URL, help="Address of the LCM messages.")
    args = parser.parse_args()
    try:
        rclpy, sensors, geometry, standard = (
            importlib.import_module(name)
            for name in ("rclpy", "sensor_msgs.msg", "geometry_msgs.msg", "std_msgs.msg")
        )
    except ModuleNotFoundError as error:
        print(f"{error}: source a ROS 2 installation first", file=sys.stderr)
        return 2
    rclpy.init()
    node, lcm = rclpy.create_node("feasigrasp_station"), DrakeLcm(args.lcm_url)
    joints = node.create_publisher(standard.Float64MultiArray, "joint_command", 1)
    gripper = node.create_publisher(standard.Float64, "gripper_command", 1)
    for kind, topic, channel, translated in (
        (sensors.JointState, "joint_states", channels.IIWA_STATUS, status),
        (sensors.JointState, "gripper_states", channels.WSG_STATUS, fingers),
        (sensors.Image, args.camera, channels.image_channel(args.camera_name), images),
        (geometry.PoseStamped, "pose", channels.OBJECT_POSE, pose),
    ):
        node.create_subscription(
            kind,
            topic,
            lambda m, channel=channel, f=translated: lcm.Publish(channel, f(m).encode()),
            1,
        )

    def command(data: bytes) -> None:
        positions = list(lcmt_iiwa_command.decode(data).joint_position)
        joints.publish(standard.Float64MultiArray(data=positions))

    def close(data: bytes) -> None:
        width = 1e-3 * lcmt_schunk_wsg_command.decode(data).target_position_mm
        gripper.publish(standard.Float64(data=width))

    subscriptions = [
        lcm.Subscribe(channels.IIWA_COMMAND, command),
        lcm.Subscribe(channels.WSG_COMMAND, close),
    ]
    while rclpy.ok():
        rclpy.spin_once(node, timeout_sec=0.001)
        lcm.HandleSubscriptions(0)
    del subscriptions
    return 0


if __name__ == "__main__":
    sys.exit(main())
