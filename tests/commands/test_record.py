"""``feasigrasp record``, from a RealSense that is played, into a folder that others read."""

import json
import os
import signal
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image

from feasigrasp import cli
from feasigrasp.models.clouds.camera import unproject
from feasigrasp.recordings import CameraInfo, captured_points, read_depth_folder
from feasigrasp.recordings.images import camera_file_of
from feasigrasp.recordings.recorder import _SETTLING
from feasigrasp.resources import model_path
from tests import fake_realsense
from tests.fake_realsense import camera, composite_frame, pixels, stream

SIZE = ["--size", "32x24"]


@pytest.fixture(autouse=True)
def plugged_in(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", fake_realsense)
    monkeypatch.setattr(camera, "images", range(1, 200))
    monkeypatch.setattr(fake_realsense.intrinsics, "coeffs", [0.0] * 5)


def record(folder, *options):
    return cli.main(["record", "--out", str(folder), *SIZE, *options])


def test_what_the_camera_saw_is_what_track_and_perceive_read(tmp_path, capsys):
    assert record(tmp_path / "a", "--frames", "4") == 0
    assert not camera.running and "a: 4 images in 0.1 s\n" in capsys.readouterr().out
    read = read_depth_folder(tmp_path / "a")
    first = _SETTLING + 1
    np.testing.assert_allclose(read.times, 5e3 + (first + np.arange(4)) / 30.0, atol=1e-6)
    np.testing.assert_allclose(read.camera.intrinsics, [30.1, 30.2, 15.6, 11.7], rtol=1e-6)
    said = json.loads((tmp_path / "a" / "camera.json").read_text())
    assert said["depth_scale"] == 0.1 and said["baseline"] == pytest.approx(0.0181)
    assert (said["width"], said["height"]) == (32, 24)
    for k in range(4):
        true = 1e-4 * pixels(stream.depth, first + k)  # a tenth of a millimetre
        np.testing.assert_allclose(read.depth(k), true, atol=1e-9)
        color = np.asarray(Image.open(tmp_path / "a" / "color" / f"{k:06d}.png"))
        np.testing.assert_array_equal(color, pixels(stream.color, first + k))
    points = captured_points(read.files[2])
    whole = unproject(read.depth(2), read.camera.intrinsics).reshape(3, -1).T
    assert len(points) > 0 and set(map(tuple, points)) <= set(map(tuple, whole))


def test_two_commands_lead_from_the_camera_to_grasps(monkeypatch, tmp_path):
    """The camera looks at the mug of the packaged capture."""
    depth, mask = (model_path("capture", kind, "mug.png") for kind in ("depth", "mask"))
    seen, info = np.asarray(Image.open(depth)), json.loads(camera_file_of(depth).read_text())
    height, width = seen.shape
    for name in ("fx", "fy", "ppx", "ppy"):
        key = {"ppx": "cx", "ppy": "cy"}.get(name, name)
        monkeypatch.setattr(fake_realsense.intrinsics, name, info[key])
    monkeypatch.setattr(fake_realsense.intrinsics, "width", width)
    monkeypatch.setattr(fake_realsense.intrinsics, "height", height)
    units = (1e4 * 1e-3 * info["depth_scale"] * seen).astype(np.uint16)

    def plays(kind, number):
        return units if kind is stream.depth else np.zeros((height, width, 3), np.uint8)

    monkeypatch.setattr(camera, "plays", plays)
    out, grasps = tmp_path / "a", tmp_path / "grasps.json"
    words = ["--out", str(out), "--frames", "1", "--size", f"{width}x{height}"]
    assert cli.main(["record", *words]) == 0
    image = str(out / "depth" / "000000.png")
    picture = ["--picture", str(tmp_path / "a.png")]
    words = ["--depth", image, "--mask", str(mask), "--grasps", str(grasps), *picture]
    assert cli.main(["perceive", *words]) == 0
    found = json.loads(grasps.read_text())
    assert len(found["poses"]) >= 3 and found["frame"] == "camera"


def test_it_ends_after_a_time(tmp_path, capsys):
    assert record(tmp_path / "a", "--seconds", "0.5") == 0
    assert "16 images in 0.5 s" in capsys.readouterr().out  # both ends of 15 intervals


def test_what_comes_twice_or_without_color_is_left_out_and_what_is_missed_counted(
    monkeypatch, tmp_path, capsys
):
    late = [41, 41, composite_frame(42, lost=True), 43, 47]
    monkeypatch.setattr(camera, "images", [*range(1, 41), *late])
    assert record(tmp_path / "a", "--frames", "13") == 0
    assert "13 images in 0.5 s; 4 more were missed" in capsys.readouterr().out
    last = read_depth_folder(tmp_path / "a").depth(12)
    np.testing.assert_allclose(last, 1e-4 * pixels(stream.depth, 47), atol=1e-9)


def test_ctrl_c_ends_it(monkeypatch, tmp_path, capsys):
    def images():
        yield from range(1, _SETTLING + 6)
        os.kill(os.getpid(), signal.SIGINT)
        yield from range(_SETTLING + 6, 10_000)

    monkeypatch.setattr(camera, "images", images())
    # A process that a shell started in the background ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert record(tmp_path / "a") == 0
    finally:
        signal.signal(signal.SIGINT, before)
    assert "a: 6 images" in capsys.readouterr().out and not camera.running
    assert len(read_depth_folder(tmp_path / "a").files) == 6


def test_a_camera_that_is_unplugged_leaves_a_whole_recording(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(camera, "images", range(1, _SETTLING + 4))
    assert record(tmp_path / "a") == 1
    assert "ended early: no image comes from the RealSense" in capsys.readouterr().out
    read = read_depth_folder(tmp_path / "a")
    assert [read.depth(k).shape for k in range(len(read.files))] == [(24, 32)] * 3
    assert not camera.running


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda m: m.setitem(sys.modules, "pyrealsense2", None), "pip install pyrealsense2"),
        (lambda m: m.setattr(camera, "images", None), "No device connected"),
        (lambda m: m.setattr(camera, "images", []), "no image comes from the RealSense"),
        (lambda m: m.setitem(globals(), "SIZE", ["--size", "33x24"]), "33 x 24 at 30 Hz"),
        (
            lambda m: m.setattr(fake_realsense.intrinsics, "coeffs", [0.1, 0, 0, 0, 0]),
            "is distorted",
        ),
    ],
)
def test_what_is_wrong_is_one_line_and_leaves_nothing(monkeypatch, tmp_path, capsys, spoil, says):
    spoil(monkeypatch)
    assert record(tmp_path / "a", "--frames", "1") == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("error: ") and says in error
    assert not list(tmp_path.rglob("*.png")) and not camera.running


def test_a_recording_is_not_written_over(tmp_path, capsys):
    assert record(tmp_path, "--frames", "2") == 0
    before = {file: file.read_bytes() for file in tmp_path.rglob("*.png")}
    assert record(tmp_path, "--frames", "2") == 2
    assert "holds depth images already; give another folder" in capsys.readouterr().err
    assert before == {file: file.read_bytes() for file in tmp_path.rglob("*.png")}


@contextmanager
def nameless(width, height, rate):
    """A camera that says nothing of itself."""
    yield "camera", []


@contextmanager
def still(width, height, rate):
    """A camera without images."""
    yield CameraInfo((40.0, 40.0, 20.0, 15.0)), None


@contextmanager
def wordy(width, height, rate):
    """Images that are none."""
    yield CameraInfo((40.0, 40.0, 20.0, 15.0)), ["image"]


@contextmanager
def alone(width, height, rate):
    """No pair."""
    yield CameraInfo((40.0, 40.0, 20.0, 15.0))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("os:getcwd", "getcwd() takes no arguments"),
        ("builtins:range", "context manager"),
        (f"{__name__}:nameless", "'camera' is no CameraInfo"),
        (f"{__name__}:still", "not iterable"),
        (f"{__name__}:alone", "unpack"),
        (f"{__name__}:wordy", "gave str, not a DepthFrame"),
    ],
)
@pytest.mark.parametrize("command", [["record", "--out", "a"], ["live"]])
def test_what_is_no_camera_is_named(command, name, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main([*command, "--camera", name]) == 2
    error = capsys.readouterr().err
    assert f"error: --camera {name}" in error and says in error


@pytest.mark.parametrize("size", ["640", "640x", "x480", "0x0", "640x480x3", "a"])
def test_a_size_is_two_numbers(tmp_path, size, capsys):
    with pytest.raises(SystemExit):
        cli.main(["record", "--out", str(tmp_path), "--size", size])
    assert "--size" in capsys.readouterr().err


def test_the_played_library_has_no_name_that_the_real_one_lacks():
    sys.modules.pop("pyrealsense2")
    rs = pytest.importorskip("pyrealsense2")
    for name, thing in vars(fake_realsense).items():
        if isinstance(thing, type) and thing.__module__ == fake_realsense.__name__:
            real, ours = getattr(rs, name), {n for n in vars(thing) if n[0] != "_"}
            assert ours - {"memory", "kind", "number", "lost"} <= set(dir(real)), name
