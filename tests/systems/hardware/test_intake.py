"""What of the messages that arrive is used, and what a diagram is given of them."""

import re
import tracemalloc
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
from drake import (
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_image,
    lcmt_image_array,
    lcmt_robot_state,
    lcmt_schunk_wsg_status,
)
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.systems.hardware import channels, control_loop
from feasigrasp.systems.hardware.channels import LARGEST, decode, pixels
from feasigrasp.systems.hardware.control_loop import ControlLoop, Intake
from feasigrasp.systems.hardware.measurements import pose_message


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


@pytest.fixture
def clock(monkeypatch):
    """This computer's clock, which stands unless it is set."""
    clock = SimpleNamespace(now=0.0, monotonic=lambda: clock.now)
    monkeypatch.setattr(control_loop, "time", clock)
    return clock


@pytest.mark.parametrize("ahead", [0.3, 1.0, 3600.0, 9e12])
def test_a_single_stamp_far_ahead_is_dropped(bus, clock, ahead):
    """On every channel: the next message is used."""
    bus[2].begun = True
    for channel in (channels.IIWA_STATUS, "images"):
        for k in range(1, 20):
            clock.now = 5e-3 * k
            tell(bus, a_message(channel, clock.now), channel=channel)
            if k == 10:
                tell(bus, a_message(channel, clock.now + ahead), channel=channel)
        assert bus[2].dropped[channel] == 1 and bus[2]._utime[channel] == 95_000
    assert bus[2].clock_set is None


def a_message(channel, at):
    utime = round(1e6 * at)
    if channel == channels.IIWA_STATUS:
        return status(utime)
    message = lcmt_image_array()
    message.header.utime, message.header.frame_name = utime, "camera"
    return message.encode()


@pytest.mark.parametrize("by", [-3600.0, -1.0, 1.0, 3600.0])
def test_a_clock_that_is_set_ends_a_run_with_words_and_a_camera_goes_on(bus, clock, by):
    loop = ControlLoop.__new__(ControlLoop)
    loop.intake, bus[2].begun = bus[2], True
    for k in range(1, 300):
        clock.now = 5e-3 * k
        at = 4000.0 + clock.now + by * (k > 100)
        tell(bus, a_message("images", at), channel="images")
        tell(bus, a_message(channels.IIWA_STATUS, at))
    assert bus[2]._utime["images"] == round(1e6 * at)
    with pytest.raises(
        HardwareError, match=re.escape(f"jump by {by:+.3g} s: the clock of the arm's driver")
    ):
        loop._wait(1.0)


def test_one_that_was_stopped_for_long_does_not_make_up_for_it(bus, clock):
    bus[2].begun = True
    tell(bus, status(5000))
    clock.now = 3600.0
    assert tell(bus, status(3_600_005_000)) == [5000]


def whole(kind):
    """A message of each type with values that can be used."""
    if kind is lcmt_iiwa_status:
        return status(5, (0.1,) * 7)
    message = kind()
    if kind is lcmt_robot_state:
        return pose_message(0.5, np.array([1.0, 0, 0, 0, 0.5, 0, 0.5])).encode()
    if kind is lcmt_image_array:
        image = lcmt_image()
        image.height, image.width, image.data = 4, 6, b"\0" * 48
        image.size, image.channel_type = 48, lcmt_image.CHANNEL_TYPE_UINT16
        message.num_images, message.images = 1, [image]
    return message.encode()


KINDS = [lcmt_iiwa_status, lcmt_schunk_wsg_status, lcmt_robot_state, lcmt_image_array]


@pytest.mark.parametrize("kind", KINDS)
def test_malformed_messages_of_the_right_type_are_none(kind):
    """Cut off anywhere, with bytes to spare, changed anywhere: never an error."""
    data = whole(kind)
    assert decode(kind, data) is not None
    for n in range(len(data)):
        assert decode(kind, data[:n]) is None
    assert decode(kind, data + b"\0") is None
    assert decode(kind, data + bytes(LARGEST)) is None
    rng = np.random.default_rng(0)
    for _ in range(500):
        changed = bytearray(data)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            changed[at] = rng.choice([0, 0x7F, 0x80, 0xFF, rng.integers(0, 256)])
        decode(kind, bytes(changed))


@pytest.mark.parametrize("kind, name", [
    (lcmt_schunk_wsg_status, "actual_position_mm"), (lcmt_schunk_wsg_status, "actual_force"),
    (lcmt_iiwa_status, "joint_torque_external"), (lcmt_iiwa_status, "joint_velocity_estimated"),
    (lcmt_robot_state, "joint_position")])  # fmt: skip
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_values_that_cannot_be_are_none(kind, name, value):
    message = kind.decode(whole(kind))
    old = getattr(message, name)
    setattr(message, name, [*old[:-1], value] if isinstance(old, tuple) else value)
    possible = kind is lcmt_robot_state and np.isnan(value)  # it says that there is no pose
    possible |= kind is lcmt_iiwa_status and value == 1e30
    assert (decode(kind, message.encode()) is not None) == possible


def test_an_image_is_inflated_no_farther_than_its_size():
    """What would be 100 MB takes less than 1."""
    packer = zlib.compressobj(9)
    image = lcmt_image()
    image.height, image.width, image.channel_type = 4, 6, lcmt_image.CHANNEL_TYPE_UINT16
    image.compression_method = lcmt_image.COMPRESSION_METHOD_ZLIB
    image.data = b"".join(packer.compress(bytes(1 << 20)) for _ in range(100)) + packer.flush()
    tracemalloc.start()
    assert pixels(image, (4, 6)) is None
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    image.data = zlib.compress(bytes(48))
    assert pixels(image, (4, 6)).shape == (4, 6)


def test_malformed_messages_are_counted_and_the_next_one_is_used(bus):
    for data in (status(5)[:60], status(5) + b"\0", b"", status(10)):
        tell(bus, data)
    assert bus[3] == [10] and bus[2].dropped[channels.IIWA_STATUS] == 3


def test_before_a_run_begins_any_clock_is_taken(bus, clock):
    """What came while nobody listened is old."""
    assert tell(bus, status(5000), status(900_000_000)) == [5000, 900_000_000]
    for k in range(1, 120):
        clock.now = 5e-3 * k
        tell(bus, status(5000 * k))
    assert bus[3][-1] == 595_000 and bus[2].clock_set is None


def test_a_camera_that_repeats_its_image_with_new_stamps_counts_as_silent(bus):
    """Whole images of one camera are never the same; a picture that differs is used again."""
    pictures = [b"a" * 48, b"b" * 48, b"b" * 48, b"b" * 48, b"c" * 48]
    for k, picture in enumerate(pictures, start=1):
        message = lcmt_image_array.decode(whole(lcmt_image_array))
        message.header.utime, message.images[0].data = 5000 * k, picture
        tell(bus, message.encode(), channel="images")
    assert bus[2].dropped["images"] == 2 and bus[2]._utime["images"] == 25_000


def test_a_camera_that_froze_for_long_is_used_again_at_once(bus, clock):
    """And what came before keeps its own stamp."""
    outside, inside, intake, _ = bus
    intake.begun, stamps = True, []
    inside.Subscribe(
        "images", lambda data: stamps.append(lcmt_image_array.decode(data).header.utime)
    )
    message = lcmt_image_array.decode(whole(lcmt_image_array))
    for k in range(1, 62):
        clock.now = k / 30
        message.header.utime = round(1e6 * clock.now)
        message.images[0].data = b"b" * 48 if k == 61 else b"a" * 48
        outside.Publish("images", message.encode())
        intake.receive(0.0)
        if k == 60:
            tell(bus, status(2_000_000))
    tell(bus, status(2_040_000))
    assert stamps == [33_333, 2_033_333] and intake.dropped["images"] == 59
