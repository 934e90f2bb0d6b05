"""Pictures of what was perceived, and the script that draws them, on generated clouds."""

import runpy
import sys
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest
from scipy.spatial import cKDTree

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.perceive import perceive
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.runs.pictures.perception import (
    dense_surface,
    draw_perception,
    gripper_outline,
    towards_viewer,
    upward,
)
from feasigrasp.runs.pictures.splats import Viewer
from feasigrasp.systems.monitoring.meshcat_view import distance_from_seen

RADIUS = 0.03


def sphere(count=1500):
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return RADIUS * np.column_stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)]
    )


def seen_sphere():
    """A ball 0.4 m before a camera in the origin: the side that faces it."""
    points = sphere()
    return points[points[:, 2] < -0.2 * RADIUS] + [0.0, 0.0, 0.4]


def no_grasps(gpdf):
    return GraspSet.empty()


@pytest.fixture
def run_script(repository, monkeypatch, capsys):
    """Runs the script in this process: exit status, and what it prints and complains of."""

    def run(*arguments):
        script = str(repository / "diagrams" / "perceive.py")
        monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(script, run_name="__main__")
        return ended.value.code, *capsys.readouterr()

    return run


def test_a_dense_surface_covers_the_ball_evenly():
    surface = dense_surface(fit_gpdf(sphere()), across=50)
    spacing = 2 * RADIUS / 50
    np.testing.assert_allclose(np.linalg.norm(surface.points, axis=1), RADIUS, atol=1e-3)
    holes = cKDTree(surface.points).query(sphere(4000))[0]
    assert holes.max() < 2.5 * spacing
    radial = surface.points / np.linalg.norm(surface.points, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", radial, surface.normals).min() > 0.95


def test_uncertainty_is_the_distance_from_a_single_observation():
    """Of one observation without noise, by the variance's definition."""
    gpdf = SimpleNamespace(length_scale=0.3, variance=lambda x: 1.0 - np.exp(-x[:, 0] / 0.3) ** 2)
    points = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.03, 0.0, 0.0]])
    np.testing.assert_allclose(distance_from_seen(gpdf, points), points[:, 0], atol=1e-12)


def test_a_viewer_sees_right_handed_with_up_on_top():
    rng = np.random.default_rng(0)
    for _ in range(20):
        up = rng.normal(size=3)
        viewer = Viewer.at(rng.normal(size=3), up, turn=rng.uniform(-3, 3))
        axes = np.stack([viewer.right, viewer.up, viewer.back])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert viewer.project(up)[0] == pytest.approx(0.0, abs=1e-12)
        assert viewer.project(up)[1] > 0.0
    front = Viewer.at([0.0, -1.0, 0.0], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(front.project([1.0, 0.0, 0.0]), [1.0, 0.0, 0.0], atol=1e-12)
    above = Viewer.at([0.0, 0.0, 1.0], [0.0, 0.0, 1.0])
    assert above.project([0.0, 0.0, 1.0])[2] > 0.99


def test_the_outline_of_the_hand_spans_its_opening():
    gripper = ParallelGripper()
    line = gripper_outline(gripper)
    assert np.ptp(line[:, 0]) == pytest.approx(gripper.max_opening)
    assert line[:, 2].max() == gripper.tip and (line[:, 1] == 0.0).all()


def test_the_sky_is_up_and_the_camera_looks():
    found = perceive(seen_sphere(), sampler=no_grasps)
    np.testing.assert_array_equal(upward(found), [0.0, -1.0, 0.0])
    assert towards_viewer(found)[2] < 0.0
    np.testing.assert_array_equal(upward(replace(found, viewpoint=None)), [0.0, 0.0, 1.0])


def test_the_picture_shows_seen_in_blue_and_made_up_in_warm_colours(tmp_path):
    draw_perception(perceive(seen_sphere()), tmp_path / "ball.png", "ball")
    pixels = matplotlib.image.imread(tmp_path / "ball.png")[..., :3]
    width = pixels.shape[1] // 4
    high = slice(pixels.shape[0] // 6, 5 * pixels.shape[0] // 6)  # without title and colour bar

    def share(panel, warm):
        part = pixels[high, panel * width : (panel + 1) * width].reshape(-1, 3)
        colored = part[np.ptp(part, axis=1) > 0.2]
        return np.mean((colored[:, 0] > colored[:, 2]) == warm)

    assert share(1, warm=False) > 0.8
    assert share(2, warm=True) > 0.5


@pytest.mark.parametrize("sampler", ["network", "antipodal"])
def test_the_script_writes_picture_and_html(run_script, tmp_path, sampler):
    np.save(tmp_path / "ball.npy", 1000.0 * seen_sphere())
    status, out, err = run_script("--cloud", tmp_path / "ball.npy")
    assert status == 2 and "--scale 0.001" in err and not out
    status, out, err = run_script(
        *("--cloud", tmp_path / "ball.npy", "--scale", 0.001),
        *("--picture", tmp_path / "out" / "ball.png"),
        *("--sampler", sampler),
    )
    assert status == 0, err
    assert "grasps kept" in out and "dropped: " in out
    assert "another object beside this one" not in out
    assert (tmp_path / "out" / "ball.png").stat().st_size > 20_000
    html = (tmp_path / "out" / "ball.html").read_text()
    assert "perception/completion" in html or len(html) > 1_000_000
    assert 'src="http' not in html


def test_a_second_object_in_the_cloud_is_told_of(run_script, tmp_path):
    ball = seen_sphere()
    np.save(tmp_path / "two.npy", np.vstack([ball, ball[: len(ball) // 2] + [0.2, 0.0, 0.0]]))
    arguments = ("--cloud", tmp_path / "two.npy", "--sampler", "antipodal")
    status, out, _ = run_script(*arguments, "--picture", tmp_path / "two.png")
    assert status == 0 and "another object beside this one" in out


def test_nothing_to_hold_is_explained(run_script, tmp_path):
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, 60), np.linspace(-0.1, 0.1, 60))
    big = np.column_stack([u.ravel(), v.ravel(), 0.6 - 0.5 * (u.ravel() ** 2 + v.ravel() ** 2)])
    np.save(tmp_path / "wall.npy", big)
    status, out, err = run_script(
        *("--cloud", tmp_path / "wall.npy", "--picture", tmp_path / "wall.png"),
        *("--sampler", "antipodal"),
    )
    assert status == 0, err
    if "grasps kept                             0" in out:
        assert "no grasp, most often because" in out
    assert "dropped: too wide" in out
