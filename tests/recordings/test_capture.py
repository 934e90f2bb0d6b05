"""Depth images in files: points in metres, or one line that says what is wrong."""

import json

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from PIL import Image

from feasigrasp.errors import CameraError, FeasigraspError, InputError, PointCloudError
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.recordings import captured_points, read_camera, read_depth, read_depth_folder
from feasigrasp.recordings.camera_file import find_camera
from feasigrasp.recordings.images import decimated, read_color

WIDTH, HEIGHT, FX, FY, CX, CY = 120, 90, 100.0, 105.0, 58.0, 46.0
CENTER, RADIUS, WALL = np.array([0.02, -0.01, 0.5]), 0.1, 0.8
CAMERA = {"fx": FX, "fy": FY, "cx": CX, "cy": CY, "depth_scale": 0.2}


def ball_before_a_wall():
    """Depths along z [m], and which pixels show the ball, from the quadratic equation."""
    v, u = np.indices((HEIGHT, WIDTH))
    ray = np.stack([(u - CX) / FX, (v - CY) / FY, np.ones_like(u)], axis=-1)
    a, b = (ray**2).sum(axis=-1), ray @ CENTER
    root = b**2 - a * (CENTER @ CENTER - RADIUS**2)
    hit = root > 0.0
    return np.where(hit, (b - np.sqrt(np.where(hit, root, 0.0))) / a, WALL), hit


@pytest.fixture
def folder(tmp_path):
    """In the layout of recordings: one image in units of 0.2 mm, with its mask."""
    depth, mask = ball_before_a_wall()
    depth[:4] = 0.0  # nothing measured
    for name in ("depth", "mask"):
        (tmp_path / name).mkdir()
    Image.fromarray(np.round(5000.0 * depth).astype(np.uint16)).save(tmp_path / "depth" / "a.png")
    Image.fromarray(mask.astype(np.uint8)).save(tmp_path / "mask" / "a.png")
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    return tmp_path


def test_the_points_are_those_of_the_object_in_metres(folder):
    points = captured_points(folder / "depth" / "a.png", mask=folder / "mask" / "a.png")
    assert len(points) > 800
    distance = np.linalg.norm(points - CENTER, axis=1)
    np.testing.assert_allclose(distance, RADIUS, atol=2e-4)  # rounded to 0.2 mm
    everything = captured_points(folder / "depth" / "a.png")
    on_wall = np.abs(everything[:, 2] - WALL) < 2e-4
    on_ball = np.abs(np.linalg.norm(everything - CENTER, axis=1) - RADIUS) < 2e-4
    assert (on_wall | on_ball).all() and on_wall.sum() > 3000 and on_ball.sum() > 800


def test_pixels_at_an_edge_are_left_out(folder):
    """A stereo camera smears an outline: here every pixel of the rim lies behind the ball."""
    file = folder / "depth" / "a.png"
    depth, mask = np.asarray(Image.open(file)).copy(), ball_before_a_wall()[1]
    inside = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    rim = mask & ~np.pad(inside, 1)
    depth[rim] = 3250
    Image.fromarray(depth).save(file)
    points = captured_points(file, mask=folder / "mask" / "a.png")
    np.testing.assert_allclose(np.linalg.norm(points - CENTER, axis=1), RADIUS, atol=2e-4)


def test_a_box_leaves_out_what_is_outside(folder):
    file = folder / "depth" / "a.png"
    points = captured_points(file, box=[40, 30, 60, 50])
    column, row = FX * points[:, 0] / points[:, 2] + CX, FY * points[:, 1] / points[:, 2] + CY
    assert column.min() >= 39.99 and column.max() <= 60.01 and len(points) > 300
    assert row.min() >= 29.99 and row.max() <= 50.01
    for wrong in ([60, 30, 40, 50], [40, 30, 39, 50], [-1, 0, 5, 5], [0, 0, WIDTH, 5]):
        with pytest.raises(CameraError, match="LEFT <= RIGHT"):
            captured_points(file, box=wrong)


def test_intrinsics_are_a_file_or_four_numbers_of_images_in_millimetres(folder):
    info = read_camera(folder / "camera.json")
    assert info.intrinsics == (FX, FY, CX, CY) and info.unit == pytest.approx(2e-4)
    text = read_camera(f"{FX}, {FY},{CX},{CY}")
    assert text.intrinsics == info.intrinsics and text.unit == 1e-3
    true = captured_points(folder / "depth" / "a.png")
    image(lambda d: np.round(d / 5.0).astype(np.uint16))(folder)
    in_millimetres = captured_points(folder / "depth" / "a.png", f"{FX},{FY},{CX},{CY}")
    for axis in range(3):
        ends = np.percentile(in_millimetres[:, axis], [0, 50, 100])
        np.testing.assert_allclose(ends, np.percentile(true[:, axis], [0, 50, 100]), atol=1e-3)


def camera(**changes):
    return lambda folder: (folder / "camera.json").write_text(json.dumps({**CAMERA, **changes}))


def image(change, name="depth"):
    def spoil(folder):
        file = folder / name / "a.png"
        Image.fromarray(change(np.asarray(Image.open(file)))).save(file)

    return spoil


#: What is wrong, and the words of the one line that says so.
WRONG = {
    "8 bit": (image(lambda d: (d // 16).astype(np.uint8)), "8-bit pixels"),
    "1 bit": (image(lambda d: d > 2600), "bool"),
    "of colors": (image(lambda d: np.dstack(3 * [d // 16]).astype(np.uint8)), "3 channels"),
    "metres per unit": (camera(depth_scale=0.0002), "metres per unit, depth_scale is 0.2$"),
    "units per metre": (camera(depth_scale=5000), "units per metre, depth_scale is 0.2$"),
    "no unit at all": (camera(depth_scale=3e-8), "mend depth_scale"),
    "no scale": (camera(depth_scale=0), "positive"),
    "scale is a word": (camera(depth_scale="mm"), "could not convert .*depth_scale"),
    "not finite": (camera(fx=np.nan), "positive fx"),
    "infinite size": (camera(width=np.inf), "give the numbers fx"),
    "of half the size": (camera(fx=200, fy=210, cx=119.0, cy=92.0), "no intrinsics of 120 x 90"),
    "normalised": (camera(fx=0.8, fy=1.1, cx=0.5, cy=0.5), "no intrinsics of 120 x 90"),
    "of another size": (camera(width=240, height=180), "240 x 180 pixels, this one has 120 x 90"),
    "no camera": (lambda folder: (folder / "camera.json").unlink(), "no .*camera.json"),
    "a list": (lambda folder: (folder / "camera.json").write_text("[1]"), "fx, fy, cx, cy"),
}


@pytest.mark.parametrize(("spoil", "says"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_said_by_both_readers(folder, spoil, says):
    spoil(folder)
    for read in (
        lambda: captured_points(folder / "depth" / "a.png"),
        lambda: read_depth_folder(folder),
    ):
        with pytest.raises((InputError, CameraError), match=says) as refused:
            read()
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda m: m[:-1], "120 x 89 pixels, but the depth image 120 x 90"),
        (lambda m: np.zeros_like(m), "a.png shows 0 and no object; give another --mask"),
        (lambda m: np.dstack(3 * [m]), "3 channels"),
    ],
)
def test_what_is_wrong_with_a_mask_is_said(folder, change, says):
    image(change, "mask")(folder)
    with pytest.raises((InputError, PointCloudError), match=says):
        captured_points(folder / "depth" / "a.png", mask=folder / "mask" / "a.png")


def test_an_image_without_depth_amid_a_recording_is_none_of_another_unit(folder):
    empty = Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint16))
    empty.save(folder / "depth" / "0.png")
    read = read_depth_folder(folder)
    assert not read.depth(0).any() and read.depth(1).max() == pytest.approx(WALL, abs=2e-4)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_of_a_file_is_refused_or_read(folder, data):
    name = data.draw(st.sampled_from(["depth/a.png", "camera.json", "mask/a.png"]))
    whole = (folder / name).read_bytes()
    content = bytearray(whole[: data.draw(st.integers(0, len(whole)))])
    for i in data.draw(st.lists(st.integers(0, max(len(content) - 1, 0)), max_size=3)):
        content[i : i + 1] = bytes([data.draw(st.integers(0, 255))])
    (folder / name).write_bytes(content)
    try:
        points = captured_points(folder / "depth" / "a.png", mask=folder / "mask" / "a.png")
    except FeasigraspError as error:
        assert "\n" not in str(error)
    else:
        assert points.shape[1] == 3 and np.isfinite(points).all()
    finally:
        (folder / name).write_bytes(whole)


def test_depth_is_read_from_floats_in_metres_and_whole_numbers(tmp_path):
    depth = np.array([[0.5, np.nan], [0.0, 1.25]], dtype=np.float32)
    Image.fromarray(depth).save(tmp_path / "a.tiff")
    np.save(tmp_path / "a.npy", depth)
    np.savez(tmp_path / "a.npz", depth=depth)
    for end in ("tiff", "npy", "npz"):
        np.testing.assert_array_equal(read_depth(tmp_path / f"a.{end}"), np.nan_to_num(depth))
    np.save(tmp_path / "mm.npy", np.full((4, 4), 800.0))
    with pytest.raises(InputError, match="floating-point images are in metres"):
        read_depth(tmp_path / "mm.npy")


K_ROWS = [600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0]
K_COLUMNS = np.reshape(K_ROWS, (3, 3)).T.ravel().tolist()
ROS = f"image_width: 640\nimage_height: 480\ncamera_matrix: {{rows: 3, cols: 3, data: {K_ROWS}}}\n"
SIZE = {"width": 640, "height": 480}
REALSENSE = SIZE | {"fx": 600.0, "fy": 610.0, "ppx": 320.0, "ppy": 240.0}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("scene_camera.json", json.dumps({"3": {"cam_K": K_ROWS, "depth_scale": 1.0}})),
        ("intrinsics.json", json.dumps({"intrinsic_matrix": K_COLUMNS} | SIZE)),
        ("camera_info.yaml", ROS),
        ("camera_info.yaml", f"width: 640\nheight: 480\nK: {K_ROWS}\n"),
        ("camera.json", json.dumps(REALSENSE)),
        ("camera.json", json.dumps({"intrinsics": REALSENSE})),
        ("cam_K.txt", "600 0 320\n0 610 240\n0 0 1\n"),
    ],
)
def test_camera_files_of_others_are_read(name, text, tmp_path):
    """BOP, Open3D (by columns), ROS, RealSense, a matrix as text."""
    (tmp_path / name).write_text(text)
    found = read_camera(find_camera(tmp_path))
    assert found.intrinsics == (600.0, 610.0, 320.0, 240.0) and found.unit == 1e-3
    assert found.size in (None, (640, 480))


def test_a_decimated_image_holds_medians_at_the_places_of_its_camera():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 1.0, (7, 8))
    depth[rng.random(depth.shape) < 0.4] = 0.0
    small = decimated(depth, 3)
    assert small.shape == (2, 2)
    for row, column in np.ndindex(2, 2):
        square = depth[3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
        valid = np.sort(square[square > 0.0])
        assert small[row, column] == valid[(len(valid) - 1) // 2]
    camera = Camera((300.0, 310.0, 4.0, 3.0), 8, 7, 0.1, 1e-3)
    # The middle pixel of a square lies in the same direction.
    coarse = camera.decimated(3)
    np.testing.assert_allclose(coarse.rays([0, 1], [1, 0]), camera.rays([1, 4], [4, 1]))


@pytest.mark.parametrize(("end", "factor"), [("jpg", 1), ("jpg", 2), ("png", 2), ("jpg", 3)])
def test_colors_are_those_of_the_decimated_pixels(end, factor, tmp_path):
    """Of a smooth picture, at the middle of each square of pixels."""
    row, column = np.meshgrid(np.arange(48.0), np.arange(64.0), indexing="ij")
    color = np.stack([2 * row + 40, 3 * column + 20, 120 + row - column], axis=2)
    file = tmp_path / f"c.{end}"
    Image.fromarray(color.astype(np.uint8)).save(file, quality=95)
    found = read_color(file, (48, 64), factor)
    assert found.shape == (48 // factor, 64 // factor, 3) and found.dtype == np.uint8
    at = [(np.arange(n // factor) + 0.5) * factor - 0.5 for n in (48, 64)]
    middle = np.meshgrid(*at, indexing="ij")
    expected = np.stack([2 * middle[0] + 40, 3 * middle[1] + 20, 120 + middle[0] - middle[1]], 2)
    assert np.abs(found - expected).mean() < 4.0
    with pytest.raises(InputError, match="pixels, but the depth image"):
        read_color(file, (96, 128), 2)
