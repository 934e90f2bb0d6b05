"""The measuring rig against a ball, whose views and distances are known in closed form."""

import csv
import json

import numpy as np
import pytest

from feasigrasp.cli import main
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.gpdf import fit_gpdf, predicted_deviation, surface_deviation
from feasigrasp_lab.studies.shape import auc, measure, sample_level_set, true_samples
from feasigrasp_lab.training.data.views import ViewedObject, look_at, turning_views

RADIUS = 0.033


@pytest.fixture(scope="module")
def ball():
    return ViewedObject(load_object("ball"))


@pytest.fixture(scope="module")
def camera():
    return look_at(np.array([0.3, -0.2, 0.35]), roll=0.4)


@pytest.fixture(scope="module")
def field():
    return fit_gpdf(sphere_points(600, RADIUS), max_points=600)


def test_look_at_looks_at_the_origin(camera):
    np.testing.assert_allclose(camera[:3, :3].T @ camera[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(camera[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(np.linalg.inv(camera)[:2, 3], 0.0, atol=1e-12)
    assert np.linalg.inv(camera)[2, 3] > 0.0


def test_a_perfect_camera_sees_points_of_the_surface(ball, camera):
    view = ball.view(camera, None)
    assert len(view.points) > 400
    assert ball.surface.distance(view.points).max() < 1e-5
    towards = np.einsum("ij,ij->i", view.points, camera[:3, 3] - view.points)
    assert (towards > 0.0).all()
    assert view.measured.sum() == len(view.points)


def test_noise_is_that_of_the_sensor_and_of_the_tracker(ball, camera):
    exact = ball.view(camera, None).points
    noisy = ball.view(camera, np.random.default_rng(0))
    assert 0.0003 < ball.surface.distance(noisy.points).mean() < 0.003
    tracked = ball.view(camera, np.random.default_rng(0), (0.01, 0.0))
    np.testing.assert_allclose(
        tracked.points - noisy.points, np.tile(tracked.p_OC - noisy.p_OC, (len(noisy.points), 1))
    )
    assert 0.002 < np.linalg.norm(tracked.p_OC - camera[:3, 3]) < 0.04
    assert len(noisy.points) <= len(exact)


def test_sight_ends_at_the_horizon(ball, camera):
    """On a ball a point is in sight if its tangent plane has the camera on its outer side."""
    points, normals = true_samples(ball, 0)
    in_sight, seen = ball.sees(points, normals, ball.view(camera, None))
    height = np.einsum("ij,ij->i", camera[:3, 3] - points, normals)
    clear = np.abs(height) > 0.03
    np.testing.assert_array_equal(in_sight[clear], height[clear] > 0.0)
    assert (seen <= in_sight).all()
    # The pixels at the rim are dropped; a ball shows much of its surface there.
    assert 0.5 < seen.sum() / in_sight.sum() < 0.8


def test_the_object_turns_between_views():
    poses = turning_views(np.random.default_rng(2), np.array([0.1, 0.0, 0.0]), 3)
    for X in poses:
        towards = np.array([0.1, 0.0, 0.0]) - X[:3, 3]
        assert 0.45 <= np.linalg.norm(towards) <= 0.55
        np.testing.assert_allclose(X[:3, 2], towards / np.linalg.norm(towards), atol=1e-9)
    angle = np.rad2deg(np.arccos(poses[0][:3, 2] @ poses[1][:3, 2]))
    assert 45.0 < angle <= 120.0


def test_level_set_of_a_ball(field):
    surface = sample_level_set(field)
    np.testing.assert_allclose(np.linalg.norm(surface.points, axis=1), RADIUS, atol=5e-4)
    directions = sphere_points(300, 1.0)
    for r in (RADIUS - 0.01, RADIUS + 0.004):
        np.testing.assert_allclose(surface.distance(r * directions), abs(r - RADIUS), atol=5e-4)
    assert surface.distance(RADIUS * directions).max() < 1e-3
    assert surface.distance(RADIUS * directions).mean() < 1e-4


def test_figures_of_a_ball_of_the_wrong_size(ball, camera):
    """Three millimetres too large: every figure follows."""
    points, normals = true_samples(ball, 0)
    large = fit_gpdf(sphere_points(600, RADIUS + 0.003), max_points=600)
    figures = measure(ball, large, [ball.view(camera, None)], points, normals)
    for name in ("true_to_completed_mm", "unseen_mm"):
        assert figures[name] == pytest.approx(3.0, abs=0.15), name
    assert figures["invented_percent"] == 0.0
    far = fit_gpdf(sphere_points(600, RADIUS + 0.02), max_points=600)
    figures = measure(ball, far, [ball.view(camera, None)], points, normals)
    assert figures["invented_percent"] == 100.0


def test_auc_is_the_share_of_pairs_in_order():
    rng = np.random.default_rng(0)
    score, positive = rng.integers(0, 5, 60).astype(float), rng.random(60) < 0.4
    pairs = score[positive][:, None] - score[~positive][None, :]
    assert auc(score, positive) == pytest.approx(np.mean((pairs > 0) + 0.5 * (pairs == 0)))
    assert np.isnan(auc(score, np.ones(60, dtype=bool)))


def test_deviation_grows_with_distance_from_what_was_seen():
    length = np.array([0.0, 0.005, 0.02])
    deviation = predicted_deviation(length)
    slope = np.diff(deviation) / np.diff(length)
    assert slope[0] == pytest.approx(slope[1])
    assert 0.1 < slope[0] < 0.5
    field = fit_gpdf(sphere_points(600, RADIUS))
    away = np.array([[RADIUS + 0.01, 0.0, 0.0]])
    assert surface_deviation(field, away)[0] == pytest.approx(predicted_deviation(0.01), rel=0.1)


def test_the_command_writes_its_files_and_resumes(tmp_path, capsys):
    command = ["evaluate", "shape", "--objects", "ball", "--views", "1", "--jobs", "1"]
    command += ["--out", str(tmp_path)]
    assert main(command) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    rows = {(row["name"], row["preset"]): row["value"] for row in summary["rows"]}
    for name in (
        "shape.true_to_completed_mm.1view",
        "shape.unseen_mm.1view",
        "shape.true_to_completed_mm.3views",
        "shape.variance_auc",
        "shape.invented_percent.1view",
    ):
        assert {(name, "paper"), (name, "default")} <= set(rows)
    assert rows["shape.unseen_mm.1view", "default"] < rows["shape.unseen_mm.1view", "paper"]
    with (tmp_path / "views.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 4  # two conditions, two presets
    part = tmp_path / "objects" / "ball.json"
    made = part.stat().st_mtime_ns
    assert main(command) == 0
    assert part.stat().st_mtime_ns == made
    assert "shape.variance_auc" in capsys.readouterr().out
