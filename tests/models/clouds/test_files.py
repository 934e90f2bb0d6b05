"""Clouds of real sensors: formats, invalid points, units, frames."""

import numpy as np
import open3d as o3d
import pytest

from feasigrasp.errors import PointCloudError
from feasigrasp.models.clouds.files import prepare_cloud, read_cloud, viewpoint_of


@pytest.fixture
def cloud():
    return np.random.default_rng(0).uniform([-0.05, -0.1, 0.45], [0.05, 0.1, 0.55], (200, 3))


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npy", ".npz"])
def test_all_formats_hold_the_same_points(suffix, cloud, tmp_path):
    path = tmp_path / f"cloud{suffix}"
    if suffix == ".npy":
        np.save(path, cloud)
    elif suffix == ".npz":
        np.savez(path, K=np.eye(3), depth=np.ones((48, 64)), xyz=cloud)
    else:
        o3d.io.write_point_cloud(path, o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud)))
    np.testing.assert_allclose(read_cloud(path), cloud, atol=1e-6)


def test_points_drawn_with_repetition_count_once(cloud, tmp_path):
    drawn = np.random.default_rng(1).integers(0, len(cloud), 5 * len(cloud))
    np.save(tmp_path / "drawn.npy", cloud[drawn])
    found = read_cloud(tmp_path / "drawn.npy")
    assert len(found) == len(np.unique(drawn))
    np.testing.assert_array_equal(found[:3], cloud[list(dict.fromkeys(drawn))[:3]])


@pytest.mark.parametrize("how", [{"compressed": True}, {"write_ascii": True}, {}])
def test_pcd_files_of_all_kinds_are_read(how, tmp_path):
    """As another library writes them, with colours beside; runs of zeros, to be compressed."""
    rng = np.random.default_rng(1)
    points = np.repeat(rng.uniform(0.1, 1.0, (500, 3)), rng.integers(1, 60, 500), axis=0)
    points[::3, 1] = 0.25
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.colors = o3d.utility.Vector3dVector(rng.uniform(size=points.shape))
    o3d.io.write_point_cloud(tmp_path / "cloud.pcd", cloud, **how)
    once = points[np.sort(np.unique(points.astype("<f4"), axis=0, return_index=True)[1])]
    np.testing.assert_allclose(read_cloud(tmp_path / "cloud.pcd"), once, atol=1e-6)


def test_invalid_points_of_an_organised_cloud_are_dropped(cloud, tmp_path):
    organised = np.concatenate([cloud, np.ones((200, 3))], axis=1).reshape(10, 20, 6)
    organised[0, 0, :3] = np.nan
    organised[0, 1, :3] = np.inf
    organised[0, 2, :3] = 0.0
    np.save(tmp_path / "cloud.npy", organised)
    np.testing.assert_array_equal(read_cloud(tmp_path / "cloud.npy"), cloud[3:])


def test_files_that_hold_no_cloud_are_refused(cloud, tmp_path):
    with pytest.raises(PointCloudError, match="no file .*nowhere.ply"):
        read_cloud(tmp_path / "nowhere.ply")
    (tmp_path / "cloud.las").write_text("")
    with pytest.raises(PointCloudError, match="give a file of .ply, .pcd"):
        read_cloud(tmp_path / "cloud.las")
    np.save(tmp_path / "image.npy", np.ones((48, 64)))
    with pytest.raises(PointCloudError, match=r"shape \(48, 64\); give numbers"):
        read_cloud(tmp_path / "image.npy")
    np.savez(tmp_path / "two.npz", a=cloud, b=cloud)
    with pytest.raises(PointCloudError, match="2 arrays.*a, b"):
        read_cloud(tmp_path / "two.npz")
    (tmp_path / "broken.npy").write_bytes(b"nonsense")
    with pytest.raises(PointCloudError, match="broken.npy cannot be read"):
        read_cloud(tmp_path / "broken.npy")


def test_millimetres_are_recognised_and_scaled(cloud):
    with pytest.raises(PointCloudError, match="in millimetres.*--scale 0.001"):
        prepare_cloud(1000.0 * cloud)
    np.testing.assert_allclose(prepare_cloud(1000.0 * cloud, scale=0.001), cloud)
    with pytest.raises(PointCloudError, match="too small.*--scale"):
        prepare_cloud(0.001 * cloud)


def test_background_is_told_and_cropped(cloud):
    room = np.concatenate([cloud, [[1.5, 0.0, 2.5], [-1.5, 0.0, 2.5]]])
    with pytest.raises(PointCloudError, match="3.0 m wide.*--crop"):
        prepare_cloud(room)
    box = [-0.2, 0.2, -0.2, 0.2, 0.3, 0.7]
    np.testing.assert_array_equal(prepare_cloud(room, crop=box), cloud)
    with pytest.raises(PointCloudError, match="0 points inside --crop"):
        prepare_cloud(room, crop=[5, 6, 5, 6, 5, 6])
    with pytest.raises(PointCloudError, match="give xmin xmax"):
        prepare_cloud(room, crop=[0.2, -0.2, 0, 1, 0, 1])


def test_a_cloud_round_the_camera_is_in_the_wrong_frame(cloud):
    centred = cloud - cloud.mean(axis=0)
    with pytest.raises(PointCloudError, match="amid the points.*--viewpoint X Y Z, or --merged"):
        prepare_cloud(centred)
    assert len(prepare_cloud(centred, viewpoint=[0.0, 0.0, -0.5])) == 200
    assert len(prepare_cloud(centred, viewpoint=None)) == 200
    with pytest.raises(PointCloudError, match="--scale -1"):
        prepare_cloud(cloud, scale=-1.0)


def test_the_viewpoint_of_a_pcd_is_where_the_camera_was(tmp_path):
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    for place, expected in (("0.5 -0.25 1.5", [0.5, -0.25, 1.5]), ("0 0 0", None)):
        text = f"{head}VIEWPOINT {place} 1 0 0 0\nPOINTS 1\nDATA ascii\n1 2 3\n"
        (tmp_path / "a.pcd").write_text(text)
        assert viewpoint_of(tmp_path / "a.pcd") == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("comment VIEWPOINT 0.5 -0.25 1.5 1 0 0 0", [0.5, -0.25, 1.5]),
        ("obj_info viewpoint: 0.5 -0.25 1.5", [0.5, -0.25, 1.5]),
        ("comment viewpoint of a friend", None),
        ("comment the viewpoint 1 2 3", None),
    ],
)
def test_the_viewpoint_of_a_ply_stands_in_a_comment(line, expected, tmp_path):
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\n{line}\nelement vertex 1\n{axes}end_header\n"
    (tmp_path / "a.ply").write_text(f"{head}1 2 3\ncomment viewpoint 9 9 9\n")
    assert viewpoint_of(tmp_path / "a.ply") == expected
