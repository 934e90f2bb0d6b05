"""A network between two message buses that is as bad as it is told to be."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from enum import StrEnum
from functools import partial

import numpy as np
from drake import lcmt_image, lcmt_image_array
from pydrake.lcm import DrakeLcm

from feasigrasp.systems.hardware import channels

#: How late messages are, that are late, at most [s].
LATE = 0.03
#: What share of the messages is doubled, or overtaken by others.
SHARE = 0.2
_IMAGES = channels.image_channel("")
_TO_CELL = "|".join((channels.IIWA_REQUEST, channels.IIWA_COMMAND, channels.WSG_COMMAND))
_FROM_CELL = "|".join(
    (channels.IIWA_STATUS, channels.WSG_STATUS, channels.OBJECT_POSE, f"{_IMAGES}.*")
)


class Network(StrEnum):
    """What is wrong with it."""

    LATE = "late"
    DOUBLED = "doubled"
    DISORDERED = "disordered"
    NO_IMAGES = "no_images"
    DEPTH_NAN = "depth_nan"


class Relay:
    """Carries the messages of a cell from one bus to another, and those for it back.

    Until it is told to begin, it is a good network.
    """

    def __init__(self, one: str, other: str, fault: Network, seed: int) -> None:
        """A network between the bus of a cell and that of its controller, by their URLs."""
        self.begun = False
        self._fault, self._rng = fault, np.random.default_rng(seed)
        self._ends = DrakeLcm(one), DrakeLcm(other)
        self._queue: list[tuple[float, int, int, str, bytes]] = []
        self._numbers = itertools.count()
        self._over = threading.Event()
        # By direction: an end hears what is published on it, too.
        self._subscriptions = [
            _all_of(self._ends[0], _FROM_CELL, partial(self._take, 1)),
            _all_of(self._ends[1], _TO_CELL, partial(self._take, 0)),
        ]
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends it."""
        self._over.set()
        self._thread.join()

    def _take(self, to: int, channel: str, data: bytes) -> None:
        now = time.monotonic()
        copies = [now]
        # The guard belongs on the driver's own computer: no network is between those two.
        if self.begun and channel != channels.IIWA_COMMAND:
            if channel.startswith(_IMAGES) and self._fault is Network.NO_IMAGES:
                return
            if channel.startswith(_IMAGES) and self._fault is Network.DEPTH_NAN:
                data = _nan_depth(data)
            struck = self._rng.random() < SHARE
            if self._fault is Network.LATE or (struck and self._fault is Network.DISORDERED):
                copies = [now + LATE * self._rng.random()]
            if struck and self._fault is Network.DOUBLED:
                copies = [now, now + LATE * self._rng.random()]
        for due in copies:
            heapq.heappush(self._queue, (due, next(self._numbers), to, channel, data))

    def _work(self) -> None:
        while not self._over.is_set():
            self._step()

    def _step(self) -> None:
        for end in self._ends:
            end.HandleSubscriptions(1)
        while self._queue and self._queue[0][0] <= time.monotonic():
            _, _, to, channel, data = heapq.heappop(self._queue)
            self._ends[to].Publish(channel, data)


def _all_of(lcm: DrakeLcm, pattern: str, take: Callable[[str, bytes], None]) -> object:
    """A subscription to every message on the channels of a pattern."""
    return lcm.SubscribeMultichannel(pattern, take)


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
