"""Recordings of ROS 2 that are written by mcap-ros2-support are read as those of a camera."""

import io
import struct
import sys
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap_ros2.writer import Writer
from PIL import Image

from feasigrasp import cli
from feasigrasp.errors import CameraError, HardwareError, InputError, OutputError
from feasigrasp.recordings import read_depth_folder
from feasigrasp.recordings.rosbag import rosbag

_HEADER = f"""
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_DEFINITIONS = {
    "Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
    "uint8 is_bigendian\nuint32 step\nuint8[] data" + _HEADER,
    "CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data" + _HEADER,
    "CameraInfo": "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n"
    "float64[] d\nfloat64[9] k" + _HEADER,
}
DEPTH, COLOR = "/camera/aligned_depth_to_color/image_raw", "/camera/color/image_raw"
INFO = "/camera/aligned_depth_to_color/camera_info"
RNG = np.random.default_rng(0)
DEPTHS = RNG.integers(400, 900, (3, 48, 64)).astype(np.uint16)
COLORS = RNG.integers(0, 255, (3, 48, 64, 3)).astype(np.uint8)


def header(time):
    return {"stamp": {"sec": int(time), "nanosec": round(1e9 * (time % 1.0))}, "frame_id": "c"}


def raw(image, encoding, time, padding=0, big=False):
    """sensor_msgs/Image with so many bytes behind each row."""
    height, width = image.shape[:2]
    ordered = image.astype(image.dtype.newbyteorder(">" if big else "<"))
    rows = np.frombuffer(ordered.tobytes(), np.uint8).reshape(height, -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    return "Image", {
        "header": header(time), "height": height, "width": width, "encoding": encoding,
        "is_bigendian": int(big), "step": rows.shape[1], "data": rows.tobytes(),
    }  # fmt: skip


def compressed(image, time, before=b"", form="png"):
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    data = before + file.getvalue()
    return "CompressedImage", {"header": header(time), "format": form, "data": data}


def info(d=()):
    k = [60.0, 0.0, 31.5, 0.0, 61.0, 23.5, 0.0, 0.0, 1.0]
    found = {"header": header(10.0), "height": 48, "width": 64, "distortion_model": "plumb_bob"}
    return "CameraInfo", found | {"d": list(d), "k": k}


def written(path, *messages):
    """An MCAP file of (topic, (type, message)) at their stamps."""
    with path.open("wb") as file:
        writer = Writer(file)
        kinds = {
            k: writer.register_msgdef(f"sensor_msgs/msg/{k}", t) for k, t in _DEFINITIONS.items()
        }
        for topic, (kind, message) in messages:
            stamp = message["header"]["stamp"]
            writer.write_message(
                topic, kinds[kind], message, log_time=10**9 * stamp["sec"] + stamp["nanosec"]
            )
        writer.finish()
    return path


def read(path):
    with rosbag(path) as (camera, frames):
        return camera, list(frames)


def test_a_recording_becomes_a_folder_that_track_reads(tmp_path, capsys):
    """Each depth image has the color image that is nearest in time."""
    bag = written(
        tmp_path / "bag.mcap",
        (INFO, info()),
        *((DEPTH, raw(DEPTHS[k], "16UC1", 10.0 + k / 30.0)) for k in range(3)),
        (COLOR, raw(COLORS[0][..., ::-1], "bgr8", 10.001, padding=5)),
        (COLOR, raw(COLORS[1][..., ::-1], "bgr8", 10.025)),
        (COLOR, raw(COLORS[2][..., ::-1], "bgr8", 10.064)),
    )
    assert cli.main(["record", "--camera", str(bag), "--out", str(tmp_path / "out")]) == 0
    assert "3 images in 0.1 s" in capsys.readouterr().out
    folder = read_depth_folder(tmp_path / "out")
    np.testing.assert_allclose(folder.times - folder.times[0], np.arange(3) / 30.0, atol=1e-6)
    for k in range(3):
        np.testing.assert_allclose(folder.depth(k), 1e-3 * DEPTHS[k], atol=1e-9)
        np.testing.assert_array_equal(folder.color(k), COLORS[k])
    assert (folder.camera.width, folder.camera.height) == (64, 48)
    assert folder.camera.intrinsics == (60.0, 61.0, 31.5, 23.5)


def test_depth_of_floats_is_in_metres(tmp_path):
    depth = np.full((48, 64), 0.5123, np.float32)
    depth[0, :4] = np.nan, np.inf, 0.0, 100.0
    bag = written(tmp_path / "a.mcap", (INFO, info()), (DEPTH, raw(depth, "32FC1", 10.0, big=True)))
    camera, (frame,) = read(bag)
    assert camera.unit == 1e-3 and not frame.depth[0, :4].any() and (frame.depth[1:] == 512).all()
    assert not frame.color.any() and frame.color.shape == (48, 64, 3)


def test_compressed_images_are_read(tmp_path):
    bag = written(
        tmp_path / "a.mcap",
        (INFO, info()),
        (f"{DEPTH}/compressedDepth", compressed(DEPTHS[0], 10.0, before=bytes(12))),
        (f"{COLOR}/compressed", compressed(COLORS[0], 10.0)),
    )
    _, (frame,) = read(bag)
    np.testing.assert_array_equal(frame.depth, DEPTHS[0])
    np.testing.assert_array_equal(frame.color, COLORS[0])


def test_compressed_depth_of_floats_is_quantized_inverse_depth(tmp_path):
    """By compressed_depth_image_transport, up to 10 m with its usual quantization."""
    A = 100.0 * 101.0
    B = 1.0 - A / 10.0
    inverse = np.rint(A / (1e-3 * DEPTHS[0]) + B).astype(np.uint16)
    inverse[0, :4] = 0
    message = compressed(inverse, 10.0, struct.pack("<iff", 0, A, B), "32FC1; compressedDepth png")
    bag = written(tmp_path / "a.mcap", (INFO, info()), (f"{DEPTH}/compressedDepth", message))
    _, (frame,) = read(bag)
    assert not frame.depth[0, :4].any()
    np.testing.assert_allclose(frame.depth[1:], DEPTHS[0][1:], atol=1)


@pytest.mark.parametrize(
    ("messages", "error", "says"),
    [
        ([(COLOR, raw(COLORS[0], "rgb8", 10.0))], InputError, f"no images of depth.*{COLOR}"),
        ([(DEPTH, raw(DEPTHS[0], "16UC1", 10.0))], InputError, "no .*camera_info"),
        (
            [(INFO, info([0.1])), (DEPTH, raw(DEPTHS[0], "16UC1", 10.0))],
            CameraError,
            "distorted.*rectified",
        ),
        (
            [(INFO, info()), (DEPTH, raw(DEPTHS[0], "yuv422", 10.0))],
            InputError,
            "yuv422; give 16UC1",
        ),
    ],
)
def test_what_is_missing_is_named(tmp_path, messages, error, says):
    with pytest.raises(error, match=says):
        read(written(tmp_path / "a.mcap", *messages))


def test_a_broken_image_and_a_recording_that_was_cut_off_are_named(tmp_path):
    kind, message = raw(DEPTHS[0], "16UC1", 10.0)
    short = kind, message | {"data": message["data"][:-7]}
    with pytest.raises(InputError, match="image_raw: an image is broken"):
        read(written(tmp_path / "a.mcap", (INFO, info()), (DEPTH, short)))
    whole = written(tmp_path / "b.mcap", (INFO, info()), (DEPTH, (kind, message))).read_bytes()
    (tmp_path / "c.mcap").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"c\.mcap (was cut off|cannot be read)"):
        read(tmp_path / "c.mcap")


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_of_a_recording_is_refused_or_read(tmp_path, data):
    messages = [(INFO, info()), *((DEPTH, raw(d, "16UC1", 10.0)) for d in DEPTHS)]
    content = bytearray(written(tmp_path / "a.mcap", *messages).read_bytes())
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=8)):
        content[at] = data.draw(st.integers(0, 255))
    (tmp_path / "a.mcap").write_bytes(content)
    with suppress(InputError, CameraError):
        read(tmp_path / "a.mcap")


def test_an_error_of_whoever_takes_the_images_is_not_the_recordings(tmp_path):
    bag = written(tmp_path / "a.mcap", (INFO, info()), (DEPTH, raw(DEPTHS[0], "16UC1", 10.0)))
    with pytest.raises(OutputError, match="full"), rosbag(bag):
        raise OutputError("the disk is full")


def test_a_camera_without_images_is_named(tmp_path, monkeypatch, capsys):
    bag = written(tmp_path / "a.mcap", (INFO, info()), (DEPTH, raw(DEPTHS[0], "16UC1", 10.0)))
    monkeypatch.setattr("feasigrasp.recordings.rosbag._frames", lambda *_: iter(()))
    assert cli.main(["record", "--camera", str(bag), "--out", str(tmp_path / "out")]) == 2
    assert "a.mcap gave no image" in capsys.readouterr().err


def test_another_file_and_a_missing_library_are_named(tmp_path, monkeypatch):
    (tmp_path / "a.mcap").write_bytes(b"no MCAP at all")
    with pytest.raises(InputError, match=r"a\.mcap cannot be read as MCAP"):
        read(tmp_path / "a.mcap")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "gone.mcap")
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)
    with pytest.raises(HardwareError, match="pip install mcap-ros2-support"):
        read(tmp_path / "a.mcap")
