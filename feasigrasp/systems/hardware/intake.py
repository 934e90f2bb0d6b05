"""What may be used of the messages that arrive: whole ones, of the right type, in order."""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Callable, Mapping

import numpy as np
from drake import lcmt_iiwa_status, lcmt_image_array
from pydrake.lcm import DrakeLcm

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.hardware import channels

#: Every message begins with the fingerprint of its type, of 8 bytes; then comes the time stamp
#: [us], but for images, which have a running number of 4 bytes before it.
_FINGERPRINT, _NUMBER, _STAMP = 8, 4, struct.Struct(">q")


class Intake:
    """Keeps the newest message of each channel, and hands them on to a diagram's own bus.

    Of the arm's status it keeps all that it gets, in their order. Of those that come while nobody
    listens, pydrake's bus keeps the newest.

    A diagram that listened itself would take whatever comes last: a message that was overtaken, one
    that came twice, or one of another program on the same channel.

    Attributes:
        dropped: How many messages were not used, by channel.
        zero: The time stamp that is zero of the diagram's clock [us]; what is handed on is stamped
            relative to it.
    """

    def __init__(self, lcm: DrakeLcm, kinds: Mapping[str, type], inbox: DrakeLcm) -> None:
        """Listens on a bus.

        Args:
            lcm: Where the messages come from.
            kinds: The type of message of every channel.
            inbox: Where they are handed on to; a bus inside this process.
        """
        self._lcm, self._inbox = lcm, inbox
        self.zero = 0
        self._stamp_at = {
            channel: _FINGERPRINT + (_NUMBER if kind is lcmt_image_array else 0)
            for channel, kind in kinds.items()
        }
        self._newest: dict[str, bytes] = {}
        self._utime: dict[str, int] = {}
        self._statuses: deque[tuple[int, bytes]] = deque()
        self.dropped: Counter[str] = Counter()
        self._subscriptions = [
            lcm.Subscribe(channel, self._taker(channel, kind)) for channel, kind in kinds.items()
        ]

    def receive(self, timeout: float) -> None:
        """Takes in what has arrived; if nothing has, waits for so long [s]."""
        self._lcm.HandleSubscriptions(round(1e3 * timeout))

    def oldest(self) -> int | None:
        """Time stamp of the oldest status that waits [us]; None if there is none."""
        return self._statuses[0][0] if self._statuses else None

    def skip(self) -> None:
        """Drops the oldest status."""
        self._statuses.popleft()

    def hand_on(self) -> None:
        """Gives the diagram the oldest status, and the newest of everything else; once each."""
        utime, data = self._statuses.popleft()
        self._hand_on(channels.IIWA_STATUS, utime, data)
        for channel, newest in self._newest.items():
            self._hand_on(channel, self._utime[channel], newest)
        self._newest.clear()

    def _hand_on(self, channel: str, utime: int, data: bytes) -> None:
        stamped = bytearray(data)
        _STAMP.pack_into(stamped, self._stamp_at[channel], utime - self.zero)
        self._inbox.Publish(channel, bytes(stamped))
        self._inbox.HandleSubscriptions(0)

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
                return
            self._utime[channel] = utime
            if kind is lcmt_iiwa_status:
                self._statuses.append((utime, data))
            else:
                self._newest[channel] = data

        return take


def _tells_positions(data: bytes) -> bool:
    """Whether a status is whole and tells the positions of all joints."""
    try:
        measured = lcmt_iiwa_status.decode(data).joint_position_measured
    except (ValueError, struct.error):
        return False
    return len(measured) == IIWA_7.joints and bool(np.isfinite(measured).all())
