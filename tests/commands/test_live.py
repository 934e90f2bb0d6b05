"""``feasigrasp live``, from a RealSense that plays a folder, and from a camera of one's own."""

import json
import sys
import urllib.request
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from feasigrasp import cli
from feasigrasp.commands.track import step
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.samplers import make_sampler
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.recordings import CameraInfo, DepthFrame, read_depth_folder
from feasigrasp.recordings.recorder import _SETTLING
from feasigrasp.recordings.unaided import TrackerImage, UnaidedTracker
from feasigrasp.runs.live import CameraView
from feasigrasp.runs.replay import quiet_meshcat
from tests import fake_realsense
from tests.browser import visit
from tests.fake_realsense import camera, intrinsics, stream
from tests.tracked_block import MESH, SURFACE

WIDTH, HEIGHT, FOCAL, RATE = 320, 240, 300.0, 30.0
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
START = se3.make_pose(Rotation.from_euler("xyz", [0.5, 0.4, 0.2]).as_matrix(), [0.0, 0.0, 0.5])
TWIST = np.array([0.0, 0.0, 0.4, 0.06, -0.03, 0.0])
SIZE = ["--size", f"{WIDTH}x{HEIGHT}"]
BOX = ["--box", "100", "60", "220", "185"]


def true_pose(k):
    return se3.extrapolate(START, TWIST, k / RATE)


def frames(count):
    """A block before a wall."""
    for k in range(count):
        depth = np.minimum(SURFACE.depth_image(K, true_pose(k), WIDTH, HEIGHT), 0.9)
        color = np.where(depth[..., None] < 0.8, [200, 40, 30], [90, 90, 90]).astype(np.uint8)
        yield DepthFrame(10.0 + k / RATE, k, np.round(1e4 * depth).astype(np.uint16), color)


@contextmanager
def mine(width, height, rate):
    """A camera of one's own."""
    yield CameraInfo((FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), 1e-4), frames(12)


@contextmanager
def clicked(width, height, rate):
    """The same; after its third image somebody clicks the block on the page."""

    def images():
        for frame in frames(12):
            yield frame
            if frame.number == 2:
                shares = [0.5, 0.5, 0.5, 0.5]
                request = urllib.request.Request(
                    pages[-1] + "box", json.dumps(shares).encode(), method="POST"
                )
                urllib.request.urlopen(request).read()

    yield CameraInfo((FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), 1e-4), images()


@contextmanager
def blind(width, height, rate):
    """A camera without any image."""
    yield CameraInfo((FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), 1e-4), []


pages = []


@pytest.fixture(autouse=True)
def shown(monkeypatch):
    """What is shown: the addresses of pages, and words and poses by image."""
    seen, url = [], CameraView.show
    pages.clear()

    def show(view, words, color, X_CO=None):
        if not pages or pages[-1] != view.url:
            pages.append(view.url)
        seen.append((words, X_CO))
        url(view, words, color, X_CO)

    monkeypatch.setattr(CameraView, "show", show)
    return seen


def live(name, *options):
    return cli.main(["live", "--camera", f"{__name__}:{name}", *SIZE, *options])


def error_of(poses, first=0):
    """Largest distance of the block's corners from where they are, after the first image [m]."""
    X_first = true_pose(0) @ se3.inverse(true_pose(first)) @ poses[0]
    corners = (_corners(X, X_first, first + k) for k, X in enumerate(poses))
    return max(SURFACE.distance(each).mean() for each in corners)


def tracked_again(folder, tmp_path, said):
    """Poses that ``feasigrasp track`` finds with what ``live`` has said."""
    words = said.partition("again: feasigrasp ")[2].split("\n")[0].split()
    assert words[0] == "track"
    files = [f"--poses={tmp_path / 'p.txt'}", f"--shape={tmp_path / 's.ply'}"]
    assert cli.main([*words, *files]) == 0
    rows = np.loadtxt(tmp_path / "p.txt")
    R = Rotation.from_quat(rows[:, 4:]).as_matrix()
    return [se3.make_pose(*pair) for pair in zip(R, rows[:, 1:4], strict=True)]


def test_an_object_is_followed_and_the_recording_tracks_as_it_did(tmp_path, capsys, shown):
    folder = tmp_path / "a"
    assert live("mine", "--record", str(folder), *BOX) == 0
    said = capsys.readouterr().out
    assert "12 images, a pose in 12 of them" in said and "localhost" in said
    poses = [X for _, X in shown]
    assert len(poses) == 12 and error_of(poses) < 2e-3
    np.testing.assert_allclose(tracked_again(folder, tmp_path, said), poses, atol=1e-5)


def test_a_click_on_the_page_chooses_the_object(tmp_path, capsys, shown):
    folder = tmp_path / "a"
    assert live("clicked", "--record", str(folder)) == 0
    said = capsys.readouterr().out
    poses = [X for _, X in shown if X is not None]
    assert [X is None for _, X in shown] == 3 * [True] + 9 * [False]
    assert "click the object" in shown[0][0] and error_of(poses, 3) < 2e-3
    assert len(read_depth_folder(folder).files) == 9 and "--on-table" in said
    np.testing.assert_allclose(tracked_again(folder, tmp_path, said), poses, atol=1e-5)


def test_a_real_sequence_is_followed_as_from_its_folder(shared_data, monkeypatch, capsys, shown):
    """The cube on its desk, played by a RealSense."""
    source = read_depth_folder(shared_data / "real_sequences" / "cube")
    info = json.loads((shared_data / "real_sequences" / "cube" / "camera.json").read_text())
    monkeypatch.setitem(sys.modules, "pyrealsense2", fake_realsense)
    names = {"fx": "fx", "fy": "fy", "ppx": "cx", "ppy": "cy"}
    for name, key in names.items():
        monkeypatch.setattr(intrinsics, name, info[key])
    monkeypatch.setattr(intrinsics, "width", 640)
    monkeypatch.setattr(intrinsics, "height", 480)

    def plays(kind, number):
        name = source.files[number - _SETTLING - 1].stem
        if kind is stream.color:
            return np.asarray(Image.open(source.colors[name]))
        return np.asarray(Image.open(source.files[number - _SETTLING - 1])) * np.uint16(10)

    monkeypatch.setattr(camera, "plays", plays)
    monkeypatch.setattr(camera, "images", range(1, _SETTLING + 11))
    rows, columns = np.nonzero(np.repeat(np.repeat(source.mask(0), 2, axis=0), 2, axis=1))
    box = [columns.min(), rows.min(), columns.max(), rows.max()]
    argv = ["live", "--frames", "10", "--box", *map(str, box)]
    assert cli.main(argv) == 0
    assert "a pose in 10 of them" in capsys.readouterr().out
    assert all(words == "tracked" for words, _ in shown)


def test_what_comes_into_view_of_an_object_in_the_air_is_no_table():
    """Faces of the block that leave what was seen of it first, as it moves and turns."""
    found = UnaidedTracker(Camera((FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), WIDTH, HEIGHT, 0.1, 7e-4))
    poses = []
    for frame in list(frames(12))[::2]:
        depth = 1e-4 * frame.depth
        mask = depth < 0.8 if frame.number == 0 else None
        found, X_WO = step(found, TrackerImage(depth, np.eye(4), frame.time, mask, frame.color))
        assert found.plane is None and X_WO is not None
        poses.append(X_WO)
    assert SURFACE.distance(_corners(poses[-1], poses[0], 10)).mean() < 3e-3


def _corners(X, X_first, k):
    """Where the block's corners are in its own frame, by a pose in image k and the first one."""
    E = se3.inverse(true_pose(k)) @ X @ se3.inverse(X_first) @ true_pose(0)
    return MESH.vertices @ E[:3, :3].T + E[:3, 3]


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("none", BOX, "has no such class"),
        ("blind", BOX, "gave no image"),
        ("mine", ["--box", "2", "2", "30", "30"], "--box: "),
        ("mine", ["--box", "2", "2", "999", "30"], "--box 2 2 999 30: give"),
        ("mine", [*BOX, "--record", "{here}"], "holds depth images already"),
        ("mine", [*BOX, "--record", "/proc/a"], "--record: nothing can be written to /proc/a"),
    ],
)
def test_what_is_wrong_is_one_line(name, options, says, tmp_path, capsys):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "000000.png").touch()
    assert live(name, *(word.format(here=tmp_path) for word in options)) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("error: ") and says in error


def test_without_the_library_it_says_how_to_install_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    assert cli.main(["live"]) == 2
    assert "pip install pyrealsense2" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("posted", "box"),
    [
        ("[0.25, 0.5, 0.75, 1]", [10.0, 15.0, 30.0, 30.0]),
        ("[-1, 0, 2, 9]", [0.0, 0.0, 40.0, 30.0]),
        ("[0, 0, 1]", None),
        ("[NaN, 0, 1, 1]", None),
        ("{}", None),
        ("x", None),
    ],
)
def test_only_a_box_in_the_image_is_taken(posted, box, tmp_path):
    view = CameraView(
        quiet_meshcat(),
        Camera((40.0, 40.0, 20.0, 15.0), 41, 31, 0.1, 1e-3),
        make_sampler("antipodal", ParallelGripper()),
    )
    view._answer("/box", posted.encode())
    found = view.box()
    assert (found is None) == (box is None) and view.box() is None
    if box is not None:
        np.testing.assert_allclose(found, box)


def test_a_browser_shows_image_and_words_and_takes_a_box(tmp_path):
    view = CameraView(
        quiet_meshcat(),
        Camera((40.0, 40.0, 20.0, 15.0), 41, 31, 0.1, 1e-3),
        make_sampler("antipodal", ParallelGripper()),
    )
    view.show("a <word>", np.zeros((31, 41, 3), dtype=np.uint8))
    drag = b"""<script>setTimeout(() => {
      image.setPointerCapture = () => {};
      const { left, top, width, height } = image.getBoundingClientRect();
      for (const [kind, x, y] of [["down", 0.75, 0.5], ["move", 0.5, 0.8], ["up", 0.25, 0.9]])
        image.dispatchEvent(new PointerEvent("pointer" + kind,
          { clientX: left + x * width, clientY: top + y * height, bubbles: true }));
    }, 1500)</script></html>"""
    view._page = view._page.replace(b"</html>", drag)
    _, page = visit(view.url, tmp_path, seconds=4.0)
    assert "a &lt;word&gt;" in page and "data:image/jpeg;base64," in page
    np.testing.assert_allclose(view.box(), [10.0, 15.0, 30.0, 27.0], atol=0.2)


def test_a_camera_that_ends_too_early_is_one_line(capsys):
    assert live("mine") == 2
    assert "ended before an object was chosen" in capsys.readouterr().err
