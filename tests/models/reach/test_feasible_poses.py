"""Grasps of others are judged as the pipeline judges its own."""

import json
from collections import Counter

import numpy as np
import pytest
import trimesh

from feasigrasp import cli
from feasigrasp.errors import InputError, ReachabilityError
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.suction import SuctionSampler, filter_suction
from feasigrasp.models.reach import (
    InterceptionOptions,
    Reachability,
    Situation,
    Verdict,
    feasible_grasps,
    feasible_poses,
)
from feasigrasp.models.robot.gripper import ParallelGripper, SuctionCup
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.runs.results.grasps_file import read_grasps, write_grasps

REACH = Reachability()
Q = np.deg2rad([0.0, 30.0, 0.0, -90.0, 0.0, 60.0, 0.0])


def some_poses(n, seed=0, spread=0.5):
    rng = np.random.default_rng(seed)
    R = se3.so3_exp(rng.normal(0.0, 0.8, (n, 3))) @ np.diag([1.0, -1.0, -1.0])
    return se3.make_pose(R, [0.5, 0.0, 0.35] + spread * rng.uniform(-1.0, 1.0, (n, 3)))


def situation(V_WO=(0.0, 0.0, 0.0), X_WO=None):
    X_WO = np.eye(4) if X_WO is None else X_WO
    return Situation(0.0, Q, np.zeros(7), X_WO, np.array([0.0, 0.0, 0.0, *V_WO]))


@pytest.mark.parametrize("V_WO", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.05)])
def test_the_arm_is_judged_as_by_the_filter_of_the_pipeline(V_WO):
    poses, now = some_poses(200), situation(V_WO)
    found = feasible_poses(poses, now, REACH)
    grasps = GraspSet(poses, np.full(200, 0.05), np.ones(200))
    options = InterceptionOptions()
    ours = feasible_grasps(grasps, now, REACH, options, symmetric_grasps=False).verdicts
    in_reach = {"kept", "better grasps in reach"}
    expected = ["reachable" if verdict in in_reach else verdict for verdict in ours]
    assert list(found.verdicts) == expected
    met = np.isfinite(found.arrival)
    np.testing.assert_array_equal(met, [verdict == "reachable" for verdict in found.verdicts])
    assert 20 < met.sum() < 180 and (found.arrival[met] >= 0.0).all()
    assert REACH.admissible(found.q[met]).all() and np.isnan(found.q[~met]).all()
    # Half a second on, as the poses are then.
    moved = poses.copy()
    moved[:, :3, 3] += 0.5 * np.array(V_WO)
    codes = REACH.verdicts(moved)
    np.testing.assert_array_equal(codes == 0, [verdict == "reachable" for verdict in found.later])


def ball_on_table():
    i = np.arange(1500) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * i / 1500), np.pi * (1.0 + 5**0.5) * i
    across = np.sin(polar)
    unit = np.stack([np.cos(azimuth) * across, np.sin(azimuth) * across, np.cos(polar)], axis=1)
    gpdf = fit_gpdf(0.03 * unit)
    object.__setattr__(gpdf, "table", np.array([0.0, 0.0, 1.0, 0.03]))
    return gpdf


def test_hand_object_and_table_come_first():
    gpdf = ball_on_table()
    down, up = np.diag([1.0, -1.0, -1.0, 1.0]), np.eye(4)
    beside = se3.make_pose(down[:3, :3], [0.03, 0.0, 0.0])  # a finger in the ball
    X_OG = np.stack([down, up, beside, down])
    now = situation(X_WO=se3.make_pose(np.eye(3), [0.5, 0.0, 0.3]))
    found = feasible_poses(X_OG, now, REACH, gpdf=gpdf, width=[0.06, 0.06, 0.06, 0.2])
    assert found.verdicts == ("reachable", "hits the table", "gripper collides", "too wide")
    # As by the filter, which tries flips too: they change nothing here.
    kept = filter_grasps(gpdf, X_OG, [0.06, 0.06, 0.06, 0.2], ParallelGripper())
    np.testing.assert_array_equal(kept.id, [0])
    with pytest.raises(ReachabilityError, match="finite"):
        feasible_poses(X_OG, situation(X_WO=np.full((4, 4), np.nan)), REACH)


def test_a_suction_cup_is_judged_as_by_its_own_filter():
    box = trimesh.creation.box([0.12, 0.12, 0.06])
    gpdf = fit_gpdf(np.asarray(trimesh.sample.sample_surface(box, 1500, seed=0)[0]))
    object.__setattr__(gpdf, "table", np.array([0.0, 0.0, 1.0, 0.03]))
    cup, rng = SuctionCup(), np.random.default_rng(0)
    poses = SuctionSampler(cup, n_candidates=400).candidates(gpdf)[0]
    poses = poses @ se3.exp(rng.normal(0.0, 1.0, (len(poses), 6)) * ([0.1] * 3 + [0.002] * 3))
    now = situation(X_WO=se3.make_pose(np.eye(3), [0.5, 0.0, 0.3]))
    reachability = Reachability(cup)
    found = feasible_poses(poses, now, reachability, gpdf=gpdf, width=np.full(len(poses), 0.001))
    kept = filter_suction(gpdf, poses, cup)
    of_arm = set(Verdict)
    ours = [k for k, verdict in enumerate(found.verdicts) if verdict in of_arm]
    np.testing.assert_array_equal(ours, np.sort(kept.id))
    counts = {v: n for v, n in Counter(found.verdicts).items() if v not in of_arm}
    assert counts == dict(kept.rejected)
    assert {"hits the table", "off the surface", "not flat enough for the cup"} <= set(counts)
    assert found.verdicts.count("reachable") >= 10
    # Without a field only the arm counts, whatever the width.
    alone = feasible_poses(poses, now, reachability, width=np.full(len(poses), 0.2))
    assert set(alone.verdicts) <= of_arm


@pytest.mark.parametrize("end", ["json", "npz", "npy"])
def test_files_of_grasps_come_back(end, tmp_path):
    poses, rng = some_poses(5), np.random.default_rng(0)
    grasps = GraspSet(poses, rng.uniform(0.01, 0.08, 5), np.linspace(0.9, 0.5, 5))
    write_grasps(tmp_path / f"g.{end}", grasps, "camera", tmp_path / "cloud.npy")
    X, width = read_grasps(tmp_path / f"g.{end}")
    np.testing.assert_allclose(X, poses, atol=1e-6)
    np.testing.assert_allclose(width, grasps.width, atol=1e-6)
    if end == "npy":  # GraspNet: the first column of the rotation is the approach
        rows = np.load(tmp_path / "g.npy")
        assert rows.shape == (5, 17)
        np.testing.assert_allclose(rows[:, 4:13].reshape(-1, 3, 3)[:, :, 0], poses[:, :3, 2])


def test_the_command_says_why(tmp_path, capsys):
    np.save(tmp_path / "theirs.npy", some_poses(50))
    out = tmp_path / "verdicts.json"
    argv = ["feasible", "--grasps", str(tmp_path / "theirs.npy"), "--verdicts", str(out)]
    assert cli.main(argv) == 0
    said, written = capsys.readouterr().out, json.loads(out.read_text())
    feasible = written["verdicts"].count("reachable")
    assert f"50 grasps, {feasible} feasible" in said and len(written["arrival_s"]) == 50
    assert cli.main([*argv, "--gripper", "suction"]) == 0
    by_cup = json.loads(out.read_text())["verdicts"]
    assert Counter(by_cup)["reachable"] > 0 and by_cup != written["verdicts"]
    np.save(tmp_path / "wrong.npy", np.zeros((3, 5)))
    with pytest.raises(InputError, match="give poses of shape"):
        read_grasps(tmp_path / "wrong.npy")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--q nan 0 0 0 0 0 0", "--q is nan 0 0 0 0 0 0; give 7 angles in degrees"),
        ("--q 900 0 0 0 0 0 0", "--q is 900 0 0 0 0 0 0; give 7 angles in degrees"),
        ("--q 0 0 --arm ur5e", "--q is 0 0; give 6 angles in degrees"),
        ("--velocity nan 0 0", "--velocity is [nan, 0.0, 0.0]; give three finite numbers"),
        ("--camera-pose X.txt", "--camera-pose X.txt: holds NaN or infinity; give"),
    ],
)
def test_a_wrong_option_is_named_before_anything_is_read(
    options, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    np.savetxt("X.txt", np.diag([1.0, 1.0, np.nan, 1.0]))
    assert cli.main(["feasible", "--grasps", "none.npy", *options.split()]) == 2
    assert message in capsys.readouterr().err
