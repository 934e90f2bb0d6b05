"""``feasigrasp evaluate grasp-targets``: what it counts, and what it leaves behind."""

import csv
import json

import numpy as np
import pytest

from feasigrasp.cli import main
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp_lab.studies import grasp_targets as study_grasp_targets

TARGETS = ["mean, K = 2", "mean, K by BIC", "ascent to means", "medoid", "ascent to medoids"]
TARGETS += ["gradient to means"]


def run(out, *objects):
    arguments = ["--components", "2", "--objects", ",".join(objects), "--out", str(out)]
    assert main(["evaluate", "grasp-targets", "--quick", *arguments]) == 0
    with (out / "objects.csv").open(newline="") as file:
        parts = list(csv.DictReader(file))
    return parts, json.loads((out / "summary.json").read_text())["rows"]


@pytest.fixture(autouse=True)
def few_ascents(monkeypatch):
    monkeypatch.setattr(study_grasp_targets, "_STARTS", 4)


def test_the_command_writes_the_shares_of_objects_and_their_means(tmp_path, capsys):
    parts, rows = run(tmp_path, "ball", "soup_can")
    assert [(p["object"], p["target"]) for p in parts] == [
        (name, target) for name in ("ball", "soup_can") for target in TARGETS
    ]
    assert [row["preset"] for row in rows] == TARGETS
    for row in rows:
        shares = [float(p["valid_percent"]) for p in parts if p["target"] == row["preset"]]
        assert (row["name"], row["unit"], row["n"]) == ("targets.valid_percent", "%", 2)
        assert row["value"] == pytest.approx(np.mean(shares))
        assert 0.0 <= row["low"] <= row["value"] <= row["high"] <= 100.0
    medoid = next(row for row in rows if row["preset"] == "medoid")
    assert medoid["value"] > 50.0  # a medoid is a grasp of the set
    assert "targets.valid_percent" in capsys.readouterr().out


def test_an_object_without_grasps_does_not_count(tmp_path, monkeypatch):
    grasps = study_grasp_targets.object_grasps

    def none_of_the_can(model, *, seed):
        return GraspSet.empty() if "soup_can" in str(model) else grasps(model, seed=seed)

    monkeypatch.setattr(study_grasp_targets, "object_grasps", none_of_the_can)
    parts, rows = run(tmp_path, "ball", "soup_can")
    assert {part["object"] for part in parts} == {"ball"}
    assert all(row["n"] == 1 for row in rows)


def test_a_pose_passes_with_the_width_of_any_grasp():
    field = fit_gpdf(sphere_points(400, 0.03))
    beside = se3.make_pose(np.eye(3), np.array([0.06, 0.0, 0.0]))
    poses = np.array([np.eye(4), beside, beside, np.eye(4)])
    for widths, expected in (([0.0, 0.06], 50.0), ([0.0, 0.01], 0.0)):
        share = study_grasp_targets._valid_percent(field, poses, np.array(widths))
        assert share == expected
