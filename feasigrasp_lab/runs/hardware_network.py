"""Network impairment between two message buses: delay, loss, other senders, clock steps."""

import heapq
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from enum import StrEnum
from functools import partial

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_image, lcmt_image_array
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.priority import Priority, real_time

#: How late messages are, that are late, at most [s]. Source: definition.
LATE = 0.03
#: Starts the impairment in a process.
_BEGIN = signal.SIGUSR1
_IMAGES = channels.image_channel("")
_TO_CELL = (channels.IIWA_REQUEST, channels.WSG_COMMAND)
_FROM_CELL = (channels.IIWA_STATUS, channels.WSG_STATUS, channels.OBJECT_POSE, f"{_IMAGES}.*")
#: Time in every second in which statuses are lost, and for which a guard is stopped [s].
#: Source: definition.
LOST = 0.15


class Network(StrEnum):
    """Parameters of the network impairment."""

    LATE = "late"
    DOUBLED = "doubled"
    DISORDERED = "disordered"
    NO_IMAGES = "no_images"
    DEPTH_NAN = "depth_nan"
    MALFORMED = "malformed"
    CLOCK_SET = "clock_set"
    STATUS_LOST = "status_lost"
    RIVAL = "rival"
    FORGED = "forged"

    @property
    def at_driver(self) -> bool:
        """Whether the guard is behind the network, too: not on the computer of the driver."""
        return self in (Network.CLOCK_SET, Network.STATUS_LOST, Network.RIVAL, Network.FORGED)


class Relay:
    """Carries the messages of a cell from one bus to another, and those for it back.

    Until `begin`, the network is perfect.
    """

    def __init__(self, one: str, other: str, fault: Network, seed: int) -> None:
        """A network between the bus of a cell and that of its controller, by their URLs."""
        self.begun = False
        self._fault, self._rng = fault, np.random.default_rng(seed)
        self._ends = DrakeLcm(one), DrakeLcm(other)
        self._queue: list[tuple[float, int, int, str, bytes]] = []
        self._numbers = itertools.count()
        self._rivals: set[bytes] = set()
        # What a clock is set by [s].
        set_by = self._rng.choice((-3600.0, -1.0, -0.01, 0.01, 1.0, 3600.0))
        self._set_by = round(1e6 * float(set_by))
        # By direction: an end receives what is published on it, too. The arm's commands come from
        # where the guard is.
        command = [channels.IIWA_COMMAND]
        there, back = (command, []) if fault.at_driver else ([], command)
        self._subscriptions = [
            *_each(self._ends[0], [*_FROM_CELL, *back], partial(self._take, 1)),
            *_each(self._ends[1], [*_TO_CELL, *there], partial(self._take, 0)),
        ]

    def _take(self, to: int, channel: str, data: bytes) -> None:
        if data in self._rivals:
            self._rivals.remove(data)
            return
        now = time.monotonic()
        copies = [now]
        if self.begun:
            if channel.startswith(_IMAGES) and self._fault is Network.NO_IMAGES:
                return
            if channel.startswith(_IMAGES) and self._fault is Network.DEPTH_NAN:
                data = _nan_depth(data)
            if channel == channels.IIWA_STATUS and self._fault.at_driver:
                data = self._of_driver(data)
            # What share of the messages is doubled, or overtaken by others.
            faulted = self._rng.random() < 0.2
            if faulted and self._fault is Network.MALFORMED and to == 1:  # cut off on the way
                data = data[: self._rng.integers(len(data))]
            if self._fault is Network.LATE or (faulted and self._fault is Network.DISORDERED):
                copies = [now + LATE * self._rng.random()]
            if faulted and self._fault is Network.DOUBLED:
                copies = [now, now + LATE * self._rng.random()]
        for due in copies if data else ():
            heapq.heappush(self._queue, (due, next(self._numbers), to, channel, data))

    def _of_driver(self, data: bytes) -> bytes:
        """The arm's status, or nothing, beside what another sender commands or requests."""
        status = lcmt_iiwa_status.decode(data)
        if self._fault is Network.STATUS_LOST and 1e-6 * status.utime % 1.0 < LOST:
            return b""
        if self._fault is Network.CLOCK_SET:
            status.utime = max(status.utime + self._set_by, 0)
            encoded: bytes = status.encode()
            return encoded
        if self._fault in (Network.RIVAL, Network.FORGED):
            command = lcmt_iiwa_command()
            command.utime, command.num_joints = status.utime + 1, status.num_joints
            # A rival's do not reach the driver: what the guard does is judged, not the rival.
            q = np.array(status.joint_position_commanded)
            forged = self._fault is Network.FORGED
            command.joint_position = list(q + forged * self._rng.uniform(-0.1, 0.1, len(q)))
            channel = channels.IIWA_REQUEST if forged else channels.IIWA_COMMAND
            sent: bytes = command.encode()
            if not forged:
                self._rivals.add(sent)
            self._ends[1].Publish(channel, sent)
        return data

    def step(self) -> None:
        """Carries what has come and is due."""
        came = sum(end.HandleSubscriptions(0) for end in self._ends)
        while self._queue and self._queue[0][0] <= time.monotonic():
            _, _, to, channel, data = heapq.heappop(self._queue)
            self._ends[to].Publish(channel, data)
        if not came:
            time.sleep(5e-4)


class RelayProcess:
    """A `Relay` that works in a process of its own, where no other work holds it up.

    It asks for a priority of real time: a network does not wait for the processors of the
    computers at its ends.
    """

    def __init__(self, one: str, other: str, fault: Network, seed: int) -> None:
        """Starts it, and waits until it carries messages; the arguments are those of `Relay`.

        Raises:
            HardwareError: It does not start.
        """
        command = [sys.executable, "-m", __name__, one, other, fault, str(seed)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        if not self._process.stdout.readline():
            self.close()
            raise HardwareError(f"the network between {one} and {other} does not start")

    def begin(self) -> None:
        """Starts the network impairment."""
        self._process.send_signal(_BEGIN)

    def close(self) -> None:
        """Ends it."""
        self._process.kill()
        self._process.communicate()


def main(one: str, other: str, fault: str, seed: str) -> None:
    """What a `RelayProcess` runs: says a word when it is ready, and works until it is ended.

    It does not outlive whoever has started it.
    """
    owner = os.getppid()
    relay = Relay(one, other, Network(fault), int(seed))

    def begin(*_: object) -> None:
        relay.begun = True

    signal.signal(_BEGIN, begin)
    print("ready", flush=True)
    with real_time(Priority.DRIVER):
        while os.getppid() == owner:
            relay.step()


def _each(
    lcm: DrakeLcm, patterns: Iterable[str], take: Callable[[str, bytes], None]
) -> list[object]:
    """A subscription to every message on the channels of each pattern."""
    # Not one to them all: a subscription keeps one message until that is handled, and drops what
    # comes meanwhile, on whatever channel.
    return [lcm.SubscribeMultichannel(pattern, take) for pattern in patterns]


def _nan_depth(data: bytes) -> bytes:
    """The message of images with a depth that is not a number anywhere."""
    message = lcmt_image_array.decode(data)
    for image in message.images:
        if image.pixel_format == lcmt_image.PIXEL_FORMAT_DEPTH:
            image.channel_type = lcmt_image.CHANNEL_TYPE_FLOAT32
            image.compression_method = lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED
            pixels = np.full(image.width * image.height, np.nan, dtype="<f4").tobytes()
            image.data, image.size, image.row_stride = pixels, len(pixels), 4 * image.width
    encoded: bytes = message.encode()
    return encoded


if __name__ == "__main__":
    main(*sys.argv[1:])
