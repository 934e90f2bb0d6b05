"""``evaluate tracking --real``: a folder of images, beside true poses of every second one."""

import numpy as np
import pytest
from PIL import Image

from feasigrasp import cli
from feasigrasp.recordings import CameraInfo, recorded
from feasigrasp_lab.studies.tracking import real_errors
from tests.commands.test_live import FOCAL, HEIGHT, WIDTH, frames, true_pose

COUNT = 10


@pytest.fixture
def folder(tmp_path):
    camera = CameraInfo((FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2), 1e-4)
    for frame in recorded(tmp_path, camera, frames(COUNT)):
        if frame.number == 0:
            (tmp_path / "mask").mkdir()
            mask = Image.fromarray(255 * (frame.depth < 8000).astype(np.uint8))
            mask.save(tmp_path / "mask" / "000000.png")
    return tmp_path


def test_errors_are_those_of_the_motion_since_the_first_pose(folder, capsys):
    truth = np.stack([true_pose(k) for k in range(0, COUNT, 2)])
    np.savez(folder / "true_poses.npz", X=truth)
    times, errors, poses = real_errors(folder)
    assert errors.shape == (5, 2) and np.isfinite(poses).all()
    np.testing.assert_allclose(np.diff(times), 2.0 / 30.0, atol=1e-5)
    assert errors[0].max() < 1e-3 and errors.max(axis=0)[0] < 3.0 and errors.max(axis=0)[1] < 3.0
    truth[3:, :3, 3] += [0.0, 0.03, 0.04]  # the tracker is beside a truth that is moved by 5 cm
    np.savez(folder / "true_poses.npz", X=truth)
    moved = real_errors(folder)[1]
    np.testing.assert_allclose(moved[3:, 0], 50.0, atol=3.0)
    np.testing.assert_allclose(moved[:, 1], errors[:, 1], atol=1e-6)
    out = folder / "out"
    assert cli.main(["evaluate", "tracking", "--real", str(folder), "--out", str(out)]) == 0
    assert "a pose in 100 %" in capsys.readouterr().out
    assert len((out / "real.csv").read_text().splitlines()) == 6


def test_more_poses_than_images_are_refused(folder, capsys):
    np.savez(folder / "true_poses.npz", X=np.tile(np.eye(4), (COUNT + 1, 1, 1)))
    argv = ["evaluate", "tracking", "--real", str(folder), "--out", str(folder / "out")]
    assert cli.main(argv) == 2
    assert "11 poses, of 10 images" in capsys.readouterr().err
