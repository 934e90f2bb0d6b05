"""What may be used of the messages that arrive: whole ones, of the right type, in order."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np
from drake import lcmt_iiwa_status, lcmt_image_array
from pydrake.lcm import DrakeLcm

from feasigrasp.models.robot.iiwa import IIWA_7

#: Every message begins with the fingerprint of its type, of 8 bytes; then comes the time stamp
#: [us], but for images, which have a running number of 4 bytes before it.
_FINGERPRINT, _NUMBER, _STAMP = 8, 4, struct.Struct(">q")


class Intake:
    """Keeps the newest message of each channel, and hands it on to a diagram's own bus.

    A diagram that listened itself would take whatever comes last: a message that was overtaken, one
    that came twice, or one of another program on the same channel.

    Attributes:
        dropped: How many messages were not used, by channel.
        zero: The time stamp that is zero of the diagram's clock [us]; what is handed on is stamped
            relative to it.
    """

    def __init__(self, lcm: DrakeLcm, channels: Mapping[str, type], inbox: DrakeLcm) -> None:
        """Listens on a bus.

        Args:
            lcm: Where the messages come from.
            channels: The type of message of every channel.
            inbox: Where they are handed on to; a bus inside this process.
        """
        self._lcm, self._inbox = lcm, inbox
        self.zero = 0
        self._stamp_at = {
            channel: _FINGERPRINT + (_NUMBER if kind is lcmt_image_array else 0)
            for channel, kind in channels.items()
        }
        self._newest: dict[str, bytes] = {}
        self._utime: dict[str, int] = {}
        self.dropped: Counter[str] = Counter()
        self._subscriptions = [
            lcm.Subscribe(channel, self._taker(channel, kind)) for channel, kind in channels.items()
        ]

    def receive(self, timeout: float) -> None:
        """Takes in what has arrived; if nothing has, waits for so long [s]."""
        self._lcm.HandleSubscriptions(round(1e3 * timeout))

    def hand_on(self) -> None:
        """Gives the diagram the newest message of each channel, once."""
        for channel, data in self._newest.items():
            stamped, at = bytearray(data), self._stamp_at[channel]
            _STAMP.pack_into(stamped, at, self._utime[channel] - self.zero)
            self._inbox.Publish(channel, bytes(stamped))
        self._newest.clear()
        self._inbox.HandleSubscriptions(0)

    def utime(self, channel: str) -> int | None:
        """Time stamp of the newest message of a channel [us]; None before the first."""
        return self._utime.get(channel)

    def _taker(self, channel: str, kind: type) -> Callable[[bytes], None]:
        fingerprint = kind._get_packed_fingerprint()  # type: ignore[attr-defined]

        def take(data: bytes) -> None:
            at = self._stamp_at[channel]
            whole = len(data) >= at + _STAMP.size and data.startswith(fingerprint)
            # The arm's driver sends -1 until it knows how its clock and the robot's are related.
            utime = _STAMP.unpack_from(data, at)[0] if whole else -1
            usable = utime > self._utime.get(channel, -1)
            if usable and kind is lcmt_iiwa_status:
                usable = _tells_positions(data)
            if not usable:
                self.dropped[channel] += 1
            else:
                self._utime[channel], self._newest[channel] = utime, data

        return take


def _tells_positions(data: bytes) -> bool:
    """Whether a status tells the positions of all joints."""
    measured = lcmt_iiwa_status.decode(data).joint_position_measured
    return len(measured) == IIWA_7.joints and bool(np.isfinite(measured).all())
