"""``feasigrasp track``: a recorded folder of depth images, as somebody with a camera has one."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from feasigrasp import cli
from feasigrasp.commands.track import check_size
from feasigrasp.errors import InputError
from feasigrasp.models.clouds.files import read_cloud
from feasigrasp.models.geometry import se3
from feasigrasp.recordings.folder import read_depth_folder
from feasigrasp_lab.training.data.raycasting import Raycaster
from tests.object_views import CAMERA, FOCAL, HEIGHT, WIDTH, camera_at
from tests.tracked_block import MESH, SURFACE

COUNT, RATE = 24, 30.0
TWIST = np.array([0.0, 0.0, 0.4, 0.05, -0.04, 0.0])
X_WC = camera_at([0.0, -0.45, 0.3])
UNITS = 5000.0
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])


def pose(k):
    """The block slides and turns on the table z = -0.06."""
    return se3.extrapolate(np.eye(4), TWIST, k / RATE)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Block, table and a ball beside it that is nearer to the camera."""
    folder = tmp_path_factory.mktemp("tum")
    (folder / "depth").mkdir()
    table = trimesh.creation.box((1.5, 1.5, 0.02))
    table.apply_translation([0.0, 0.0, -0.07])
    ball = trimesh.creation.icosphere(3, 0.025)
    ball.apply_translation([0.12, -0.17, -0.035])
    still = table + ball
    behind = Raycaster(still.vertices, still.faces).depth_image(K, se3.inverse(X_WC), WIDTH, HEIGHT)
    rng, lines = np.random.default_rng(0), ["# time file"]
    for k in range(COUNT):
        depth = np.minimum(
            SURFACE.depth_image(K, se3.inverse(X_WC) @ pose(k), WIDTH, HEIGHT), behind
        )
        depth = np.where(np.isfinite(depth), depth + 5e-4 * rng.standard_normal(depth.shape), 0.0)
        name = f"depth/{1e3 + k / RATE:.6f}.png"
        Image.fromarray(np.round(UNITS * depth).astype(np.uint16)).save(folder / name)
        lines.append(f"{1e3 + k / RATE:.6f} {name}")
    (folder / "depth.txt").write_text("\n".join(lines))
    fx, fy, cx, cy = CAMERA.intrinsics
    content = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "depth_scale": 1e3 / UNITS}
    (folder / "camera.json").write_text(json.dumps(content))
    p, quaternion = X_WC[:3, 3], Rotation.from_matrix(X_WC[:3, :3]).as_quat()
    row = " ".join(f"{x:.9f}" for x in [*p, *quaternion])
    (folder / "groundtruth.txt").write_text(
        "\n".join(f"{1e3 + k / RATE:.6f} {row}" for k in range(COUNT))
    )
    return folder


def box_about(p_W):
    u, v = CAMERA.pixels((p_W[None] - X_WC[:3, 3]) @ X_WC[:3, :3])
    return [int(u[0]) - 8, int(v[0]) - 8, int(u[0]) + 8, int(v[0]) + 8]


def test_it_follows_what_the_box_is_about_and_learns_its_shape(recording, tmp_path, capsys):
    poses, shape = tmp_path / "poses.txt", tmp_path / "shape.ply"
    box = map(str, box_about(np.array([0.0, 0.0, 0.04])))
    argv = ["track", "--folder", str(recording), "--on-table", "--box", *box]
    assert cli.main([*argv, "--poses", str(poses), "--shape", str(shape)]) == 0
    assert f"a pose in {COUNT} of them" in capsys.readouterr().out
    rows = np.loadtxt(poses)
    np.testing.assert_allclose(rows[:, 0], 1e3 + np.arange(COUNT) / RATE, atol=1e-5)
    X_WO = [se3.make_pose(Rotation.from_quat(r[4:]).as_matrix(), r[1:4]) for r in rows]
    # O is that of the first view; from then on it moves as the block does.
    X_BO = se3.inverse(pose(0)) @ X_WO[0]
    for k in range(10, COUNT):
        E = se3.inverse(pose(k)) @ X_WO[k] @ se3.inverse(X_BO)
        moved = MESH.vertices @ E[:3, :3].T + E[:3, 3]
        assert SURFACE.distance(moved).mean() < 2e-3
    points = read_cloud(shape) @ X_BO[:3, :3].T + X_BO[:3, 3]
    assert len(points) > 300 and np.percentile(SURFACE.distance(points), 95) < 3e-3


def test_what_is_nearest_to_the_camera_is_followed_without_a_box(recording, tmp_path):
    argv = ["track", "--folder", str(recording), "--on-table"]
    files = [f"--poses={tmp_path / 'p.txt'}", f"--shape={tmp_path / 's.ply'}"]
    assert cli.main([*argv, *files]) == 0
    rows = np.loadtxt(tmp_path / "p.txt")
    assert np.ptp(rows[:, 1:4], axis=0).max() < 2e-3  # the ball lies still


def test_masks_decide_and_times_come_from_names_or_a_rate(recording, tmp_path):
    folder = tmp_path / "own"
    (folder / "depth").mkdir(parents=True)
    (folder / "mask").mkdir()
    for k, file in enumerate(sorted((recording / "depth").glob("*.png"))[:3]):
        (folder / "depth" / f"{k:06d}.png").write_bytes(file.read_bytes())
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    mask[100:120, 50:80] = 255
    Image.fromarray(mask).save(folder / "mask" / "000001.png")
    (folder / "camera.json").write_text((recording / "camera.json").read_text())
    read = read_depth_folder(folder, rate=10.0)
    np.testing.assert_allclose(read.times, [0.0, 0.1, 0.2])
    assert read.mask(0) is None
    np.testing.assert_array_equal(read.mask(1), mask > 0)
    np.testing.assert_array_equal(read.X_WC[1], np.eye(4))
    other = read_depth_folder(recording)
    np.testing.assert_allclose(read.depth(2), other.depth(2))
    np.testing.assert_allclose(other.times[1] - other.times[0], 1 / RATE, atol=1e-5)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda f: (f / "camera.json").unlink(), "no file"),
        (lambda f: (f / "camera.json").write_text('{"fx": 1}'), "fx, fy, cx, cy"),
        (lambda f: (f / "depth.txt").write_text("now"), "time file"),
        (lambda f: (f / "groundtruth.txt").write_text("1 2 3"), "qx qy qz qw"),
        (lambda f: (f / "groundtruth.txt").write_text("# time"), "has no pose"),
        (
            lambda f: (f / "depth.txt").write_text(
                "1e15 depth/1.0.png\n1000000033e6 depth/2.0.png"
            ),
            "are 3.3e.07 s apart by their times; give seconds",
        ),
        (lambda f: (f / "depth.txt").write_text("1.0 depth/none.png"), "none.png"),
    ],
)
def test_what_is_wrong_with_a_folder_is_said(recording, tmp_path, spoil, said):
    (tmp_path / "depth").mkdir()
    for name in ("camera.json", "groundtruth.txt"):
        (tmp_path / name).write_text((recording / name).read_text())
    Image.fromarray(np.zeros((HEIGHT, WIDTH), dtype=np.uint16)).save(tmp_path / "depth" / "1.0.png")
    (tmp_path / "depth.txt").write_text("1000.0 depth/1.0.png")
    spoil(tmp_path)
    with pytest.raises(InputError, match=said):
        read_depth_folder(tmp_path)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--box", "90", "20", "50", "60"], "--box 90 20 50 60: give LEFT <= RIGHT < "),
        (["--box", "0", "0", "9", "9999"], f"TOP <= BOTTOM < {HEIGHT}, from 0 on"),
        (["--box", "-1", "0", "9", "9"], "--box -1 0 9 9: give"),
        (["--label", "3"], "has no masks; leave it out"),
    ],
)
def test_what_does_not_fit_the_images_is_refused(recording, tmp_path, options, says, capsys):
    argv = ["track", "--folder", str(recording), "--poses", str(tmp_path / "p.txt")]
    assert cli.main([*argv, *options]) == 2
    assert says in capsys.readouterr().err and not (tmp_path / "p.txt").exists()


def test_an_empty_folder_is_refused_in_one_line(tmp_path, capsys):
    assert cli.main(["track", "--folder", str(tmp_path)]) == 2
    assert "there are no depth images" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("around", "reason"), [(None, "no object was found"), (30, "is one plane")]
)
def test_a_table_with_the_object_in_one_piece_is_named_with_the_mend(
    recording, tmp_path, capsys, around, reason
):
    """A table is too large for an object; a part of it with what stands there is not."""
    (tmp_path / "depth").mkdir()
    for name in ("camera.json", "groundtruth.txt"):
        (tmp_path / name).write_text((recording / name).read_text())
    for file in sorted((recording / "depth").glob("*.png"))[:3]:
        depth = np.array(Image.open(file))
        if around is not None:
            left, top, right, bottom = box_about(np.array([0.0, 0.0, -0.03]))
            seen = np.zeros_like(depth)
            rows = slice(max(top - around, 0), bottom + around)
            columns = slice(max(left - around, 0), right + around)
            seen[rows, columns] = depth[rows, columns]
            depth = seen
        Image.fromarray(depth).save(tmp_path / "depth" / file.name)
    assert cli.main(["track", f"--folder={tmp_path}", f"--poses={tmp_path / 'p.txt'}"]) == 2
    said = capsys.readouterr().err
    assert reason in said and "--on-table" in said and "--box" in said
    assert not (tmp_path / "p.txt").exists()


@pytest.mark.parametrize(("scale", "noted"), [(0.05, True), (1.0, False), (10.0, True)])
def test_a_size_that_no_object_has_is_noted(scale, noted, capsys):
    points = scale * np.random.default_rng(0).standard_normal((500, 3)) * 0.02
    check_size(points, SimpleNamespace(completion=SimpleNamespace(points=points)))
    said = capsys.readouterr().err
    length = 100.0 * np.ptp(points, axis=0).max()
    assert (f"{length:.1f} cm" in said and "depth_scale" in said) == noted
