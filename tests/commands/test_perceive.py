"""``feasigrasp perceive`` on depth images, and the grasps that it writes for other programs."""

import json
import runpy

import numpy as np
import pytest
from PIL import Image

from feasigrasp import __version__, cli
from feasigrasp.commands import perceive
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.recordings import read_depth_folder
from feasigrasp.resources import model_path
from feasigrasp_lab.training.data.raycasting import Raycaster

DEPTH = str(model_path("capture", "depth", "mug.png"))


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch):
    """They take longer than the rest, and have tests of their own."""
    monkeypatch.setattr(perceive, "draw_perception", lambda *of: None)
    monkeypatch.setattr(perceive, "write_perception_html", lambda *of: None)


@pytest.fixture(scope="module")
def made():
    """The script that made the sample."""
    return runpy.run_path(str(model_path("capture", "make_capture.py")))


def read(file):
    content = json.loads(file.read_text())
    poses = np.array(content["poses"]).reshape(-1, 4, 4)
    return content, poses, np.array(content["widths"]), np.array(content["scores"])


def distance_to_the_mug(points_C, made):
    """From the true surface of the sample's mug [m]."""
    mug, X_WC = load_object("mug").mesh, made["camera_pose"]()
    points_W = points_C @ X_WC[:3, :3].T + X_WC[:3, 3]
    points_W[:, 2] += mug.vertices[:, 2].min()  # it stands on z = 0
    return Raycaster(mug.vertices, mug.faces).distance(points_W)


@pytest.mark.parametrize("seen", ["by its mask", "on the table"])
def test_grasps_of_the_sample_are_on_the_true_mug(seen, made, tmp_path, capsys):
    file = tmp_path / "new" / "grasps.json"
    depth = ["--sample"]
    if seen == "on the table":
        depth = ["--depth", str(model_path("capture", "depth", "mug.png")), "--on-table"]
    # From above the hand does not open wide enough for the whole mug: a network finds its rim.
    sampler = "network" if seen == "on the table" else "antipodal"
    picture = ["--picture", str(tmp_path / "a.png"), "--sampler", sampler]
    assert cli.main(["perceive", *depth, "--grasps", str(file), *picture]) == 0
    assert f"wrote {file}" in capsys.readouterr().out
    content, X_CG, widths, scores = read(file)
    assert len(X_CG) == len(widths) == len(scores) >= 3
    assert content["frame"] == "camera" and content["feasigrasp"] == __version__
    assert content["source"].endswith("mug.png") and "metres" in content["convention"]
    R = X_CG[:, :3, :3]
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-5
    )
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-5)
    assert (np.diff(scores) <= 0.0).all() and (widths > 0.0).all() and (widths < 0.12).all()
    # x is the closing direction: half a width along it to either side are the contacts.
    half = 0.5 * widths[:, None] * R[:, :, 0]
    ends = np.concatenate([X_CG[:, :3, 3] + half, X_CG[:, :3, 3] - half])
    assert np.median(distance_to_the_mug(ends, made)) < 4e-3
    # z is the approach direction: the palm, 10 cm back, is farther from the mug than the pads.
    palm = X_CG[:, :3, 3] - 0.1 * R[:, :, 2]
    assert (distance_to_the_mug(palm, made) > 0.03).all()


def test_the_sample_is_what_its_script_makes_and_small(made, tmp_path):
    made["write_capture"](tmp_path)
    shipped, folder = model_path("capture"), read_depth_folder(tmp_path)
    files = [file for file in shipped.rglob("*") if file.suffix in (".png", ".json")]
    assert sum(file.stat().st_size for file in files) < 150_000
    for file in files:
        if file.suffix == ".png":
            ours, theirs = (
                np.asarray(Image.open(of)).astype(int)
                for of in (file, tmp_path / file.relative_to(shipped))
            )
            # Another processor may round otherwise.
            assert (np.abs(ours - theirs) > 1).mean() < 1e-3, file
    assert read_depth_folder(shipped).camera.intrinsics == folder.camera.intrinsics


def test_the_sample_errs_as_a_d405_does(made):
    """Against the true surface: more than with a perfect camera, as much as its data sheet says."""
    folder = read_depth_folder(model_path("capture"))
    depth, mask, (fx, fy, cx, cy) = folder.depth(0), folder.mask(0), folder.camera.intrinsics
    assert Image.open(folder.files[0]).mode.startswith("I;16")
    v, u = np.nonzero(mask & (depth > 0.0))
    z = depth[v, u]
    error = distance_to_the_mug(np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z]), made)
    expected = folder.camera.depth_noise * np.median(z) ** 2  # its standard deviation along z
    assert 0.2 * expected < np.median(error) < expected and 0.0 < (depth[mask] == 0.0).mean() < 0.3


def perceive_ball(radius, tmp_path):
    """Grasps of the upper side of a ball about (1, 1, 1), seen from above."""
    i = np.arange(1500) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / 1500), np.pi * (1 + 5**0.5) * i
    ball = np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1
    )
    np.save(tmp_path / "ball.npy", radius * ball[ball[:, 2] > 0.2] + 1.0)
    argv = ["perceive", "--cloud", str(tmp_path / "ball.npy"), "--viewpoint", "1", "1", "1.7"]
    argv += ["--sampler", "antipodal", "--picture", str(tmp_path / "a.png")]
    assert cli.main([*argv, "--grasps", str(tmp_path / "g.json")]) == 0
    return read(tmp_path / "g.json")


def test_a_cloud_with_a_viewpoint_is_in_its_own_frame(tmp_path):
    content, poses, *_ = perceive_ball(0.03, tmp_path)
    assert content["frame"] == "cloud" and content["source"].endswith("ball.npy")
    assert len(poses) > 0 and (np.linalg.norm(poses[:, :3, 3] - 1.0, axis=1) < 0.03).all()


def test_without_a_grasp_the_lists_are_empty(tmp_path, capsys):
    content, *_ = perceive_ball(0.2, tmp_path)
    assert content["poses"] == content["widths"] == content["scores"] == []
    assert "no grasp, most often because: too wide" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--sample", "--scale", "0.001"], "--scale goes with --cloud only"),
        (["--sample", "--merged"], "--merged goes with --cloud only"),
        (["--depth", "a.png", "--viewpoint", "0", "0", "0"], "--viewpoint goes with --cloud only"),
        (["--cloud", "a.ply", "--mask", "m.png"], "--mask goes with --depth only"),
        (["--cloud", "a.ply", "--intrinsics", "1,2,3,4"], "--intrinsics goes with --depth only"),
        (["--cloud", "a.ply", "--box", "1", "2", "3", "4"], "--box goes with --depth only"),
        (["--sample", "--on-table"], "--on-table needs to see the table"),
        (["--depth", "a.png"], "no camera.json beside a.png"),
        (["--depth", "a.png", "--intrinsics", "1,2,3"], "give camera.json, or the numbers"),
        (["--depth", "a.png", "--intrinsics", "9,9,4,4"], "there is no file a.png"),
        (["--sample", "--label", "9"], "mask/mug.png shows 0, 255 and no object; give another"),
        (["--depth", DEPTH], "cut that out with --on-table or --crop, in a depth image also with"),
        (["--depth", DEPTH, "--label", "9"], "--label 9 is a value in a mask; give --mask"),
        (["--depth", DEPTH, "--box", "5", "5", "1", "1"], "LEFT <= RIGHT < 424 and TOP <= BOTTOM"),
        (["--sample", "--voxel", "3"], "voxels of 3 m leave 0 of"),
        (["--cloud", "nan.npy"], "nan.npy: all points are zero or not finite"),
    ],
)
def test_options_that_do_not_fit_are_named(options, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.save("nan.npy", np.full((9, 3), np.nan))
    assert cli.main(["perceive", *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and says in error
