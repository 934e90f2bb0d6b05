"""What of the messages that arrive is used, and what a diagram is given of them."""

import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_image_array
from pydrake.lcm import DrakeLcm

from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.control_loop import Intake


def status(utime, q=(0.0,) * 7):
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = utime, len(q)
    for name in message.__slots__[2:]:
        setattr(message, name, list(q))
    return message.encode()


@pytest.fixture
def bus():
    """Outside, inside, the intake between them, and the time stamps that came in."""
    outside, inside, seen = DrakeLcm("memq://"), DrakeLcm("memq://"), []
    kinds = {channels.IIWA_STATUS: lcmt_iiwa_status, "images": lcmt_image_array}
    intake = Intake(outside, kinds, inside)
    subscription = inside.Subscribe(
        channels.IIWA_STATUS, lambda data: seen.append(lcmt_iiwa_status.decode(data).utime)
    )
    yield outside, inside, intake, seen
    del subscription


def tell(bus, *messages, channel=channels.IIWA_STATUS):
    outside, _, intake, seen = bus
    for message in messages:
        outside.Publish(channel, message)
        intake.receive(0.0)
        while intake.oldest() is not None:
            intake.forward()
    return seen


def test_messages_pass_in_their_order(bus):
    assert tell(bus, status(5), status(10), status(15)) == [5, 10, 15]


def test_late_and_doubled_ones_do_not(bus):
    assert tell(bus, status(5), status(15), status(10), status(15), status(20)) == [5, 15, 20]
    assert bus[2].dropped[channels.IIWA_STATUS] == 2


def test_nor_those_that_cannot_be_used(bus):
    command = lcmt_iiwa_command()
    command.utime = 30
    broken = [status(5, (np.nan,) * 7), status(6, (0.0,) * 6), status(-1), command.encode(), b""]
    broken += [status(7)[:n] for n in (17, 40)]  # cut off on the way
    assert tell(bus, *broken) == []
    assert bus[2].dropped[channels.IIWA_STATUS] == len(broken)
    assert bus[2].oldest() is None


def test_all_statuses_are_handed_on_one_after_the_other(bus):
    outside, _, intake, seen = bus
    for utime in (5, 10, 15):
        outside.Publish(channels.IIWA_STATUS, status(utime))
        intake.receive(0.0)
    intake.forward()
    assert seen == [5] and intake.oldest() == 10
    intake.skip()
    intake.forward()
    assert seen == [5, 15] and intake.oldest() is None


def test_of_images_only_the_newest(bus):
    outside, inside, intake, _ = bus
    stamps = []
    inside.Subscribe("images", lambda data: stamps.append(lcmt_image_array.decode(data)))
    for utime in (5, 10, 15):
        message = lcmt_image_array()
        message.header.utime, message.header.frame_name = utime, "camera"
        outside.Publish("images", message.encode())
        intake.receive(0.0)
    tell(bus, status(20))
    tell(bus, status(25))
    assert [message.header.utime for message in stamps] == [15]


def test_stamps_are_relative_to_zero(bus):
    _, inside, intake, seen = bus
    stamps = []
    inside.Subscribe("images", lambda data: stamps.append(lcmt_image_array.decode(data)))
    intake.zero = 1_000_000
    message = lcmt_image_array()
    message.header.seq, message.header.utime, message.header.frame_name = 7, 1_250_000, "camera"
    tell(bus, message.encode(), channel="images")
    tell(bus, status(1_500_000))
    assert seen == [500_000]
    (header,) = [each.header for each in stamps]
    assert (header.seq, header.utime, header.frame_name) == (7, 250_000, "camera")
