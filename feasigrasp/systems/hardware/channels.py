"""LCM channels, message types and rates of the cell.

Those of ``IIWA_*`` are what drake-iiwa-driver reads and writes in position mode, ``SCHUNK_WSG_*``
drake-schunk-driver's, ``DRAKE_RGBD_CAMERA_IMAGES_*`` what Drake's own camera publishers send. All
time stamps are microseconds of one clock, that of the computer that the drivers run on.
"""

import weakref
from collections.abc import Callable
from enum import IntEnum
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from drake import lcmt_iiwa_status, lcmt_image_array, lcmt_robot_state, lcmt_schunk_wsg_status
from pydrake.lcm import DrakeLcm
from pydrake.manipulation import kIiwaLcmStatusPeriod

from feasigrasp.errors import HardwareError
from feasigrasp.scenario.schema import Scenario

#: Multicast that stays on this computer.
LCM_URL = "udpm://239.255.76.67:7667?ttl=0"

IIWA_STATUS, IIWA_COMMAND = "IIWA_STATUS", "IIWA_COMMAND"
#: What the controller asks of the guard, in messages of the kind that the driver reads.
IIWA_REQUEST = "FEASIGRASP_IIWA_REQUEST"
#: What a standby is about to command: the guard leaves the arm to it.
IIWA_STANDBY = "FEASIGRASP_IIWA_STANDBY"
WSG_STATUS, WSG_COMMAND = "SCHUNK_WSG_STATUS", "SCHUNK_WSG_COMMAND"
#: A motion-capture system's measurements: a floating joint's seven positions, `POSE_NAMES`.
OBJECT_POSE = "FEASIGRASP_OBJECT_POSE"

#: Time between messages of the arm's driver and of the gripper's [s]. Source: definition: rates of
#: the drivers, 200 and 20 Hz.
IIWA_PERIOD, WSG_PERIOD = kIiwaLcmStatusPeriod, 0.05
#: The order in which a pose is sent, that of Drake's floating joints.
POSE_NAMES = ["qw", "qx", "qy", "qz", "x", "y", "z"]


class MaskLabel(IntEnum):
    """Labels of a mask: everything else is 0."""

    OBJECT = 1
    ROBOT = 2


def image_channel(camera: str) -> str:
    """The channel of a camera's images: depth in millimetres, and the mask if there is one."""
    return f"DRAKE_RGBD_CAMERA_IMAGES_{camera}"


def inbound(scenario: Scenario) -> dict[str, type]:
    """Input channels of a controller of the scenario, with message types."""
    return {
        IIWA_STATUS: lcmt_iiwa_status,
        WSG_STATUS: lcmt_schunk_wsg_status,
        OBJECT_POSE: lcmt_robot_state,
        **{image_channel(name): lcmt_image_array for name in scenario.cameras},
    }


def subscribe(lcm: DrakeLcm, channel: str, receive: Callable[..., None], *given: Any) -> Any:
    """Has a method called with what comes on a channel, without keeping its object alive.

    A bus holds its handlers out of sight of Python's garbage collector: an object that has both
    the bus and a handler would never be freed, nor the file descriptors of the bus. The method
    gets the arguments ``given``, then a message's bytes. Returned is the subscription.
    """
    method = weakref.WeakMethod(receive)

    def handle(data: bytes) -> None:
        if (call := method()) is not None:
            call(*given, data)

    return lcm.Subscribe(channel, handle)


def open_lcm(url: str) -> DrakeLcm:
    """The message bus at a URL.

    Raises:
        HardwareError: There is none; the message says what to try.
    """
    works = f"on one computer {LCM_URL} works where multicast on the loopback is on"
    if not _is_bus(url):
        raise HardwareError(
            f"--lcm-url {url} is no message bus: give udpm://ADDRESS:PORT?ttl=N with a multicast "
            f"address, 224.0.0.0 to 239.255.255.255; {works}, see 'feasigrasp doctor'"
        )
    try:
        return DrakeLcm(url)
    except RuntimeError as error:
        raise HardwareError(
            f"--lcm-url {url}: no message bus can be opened there ({error}); {works}, see "
            "'feasigrasp doctor'"
        ) from error


def _is_bus(url: str) -> bool:
    """Whether LCM supports a URL; an unsupported one it accepts, and stays silent there."""
    parts = urlsplit(url)
    if parts.scheme in ("memq", "file"):
        return True
    try:
        there = ip_address(parts.hostname or "").is_multicast and parts.port != 0
    except ValueError:  # no address, or a port that is none
        return False
    return parts.scheme == "udpm" and there
