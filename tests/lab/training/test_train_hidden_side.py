"""What the hidden-side network learns from, and the command that trains it."""

import csv

import numpy as np
import pytest

from feasigrasp.cli import main
from feasigrasp.models.clouds.view_image import view_image
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.hidden_side import HiddenSide
from feasigrasp_lab.training.data.views import ViewedObject
from feasigrasp_lab.training.train_hidden_side import true_thickness


def test_the_true_thickness_of_a_ball_is_where_lines_of_sight_leave_it():
    ball = ViewedObject(load_object("ball"))
    radius = 0.5 * np.ptp(ball.obj.vertices, axis=0).mean()
    center = 0.5 * (ball.obj.vertices.min(axis=0) + ball.obj.vertices.max(axis=0))
    camera = center + [0.0, 0.0, 0.5]
    points = ball.obj.mesh.sample(20000, seed=0)
    image = view_image(points[(points - center) @ (camera - center) > radius**2], camera)
    thickness = true_thickness(ball, image)
    known = np.isfinite(thickness)
    assert known[image.mask].mean() > 0.8
    assert not known[~image.mask].any()
    ends = image.unproject(np.nonzero(known), (image.depth + thickness)[known])
    assert np.abs(np.linalg.norm(ends - center, axis=1) - radius).max() < 1e-3
    assert (ends[:, 2] < center[2] + 0.3 * radius).all()


def test_the_command_trains_and_resumes(tmp_path, capsys):
    command = ["train", "hidden-side", "--objects", "64", "--views", "1", "--steps", "2"]
    command += ["--batch", "8", "--jobs", "1", "--out", str(tmp_path)]
    assert main(command) == 0
    lines = list(csv.DictReader((tmp_path / "curve.csv").open()))
    assert [line["step"] for line in lines] == ["2"]
    assert float(lines[0]["held_out_mm"]) == pytest.approx(float(lines[0]["believed_mm"]), rel=0.5)
    HiddenSide.load(tmp_path / "hidden_side.npz")
    before = (tmp_path / "curve.csv").read_text()
    assert main(command) == 0  # nothing is left to do
    assert (tmp_path / "curve.csv").read_text() == before
    assert main([*command, "--seed", "1"]) != 0  # another run's folder
    assert "choose another --out" in capsys.readouterr().err
