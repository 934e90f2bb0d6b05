"""``feasigrasp evaluate static``: what it runs, its rows, and that shards come together."""

import argparse
import json

import numpy as np
import pytest
import trimesh

from feasigrasp import cli
from feasigrasp.scenario.sampling import make_friction, make_hand_error, make_motion
from feasigrasp_lab.results.workers import Shard
from feasigrasp_lab.studies import static


@pytest.fixture
def fake_runs(monkeypatch, fake_simulation):
    """Even seeds hold, but not under the hard rules."""
    monkeypatch.setattr(static, "judge", judge)
    return fake_simulation(
        lambda scenario, name: scenario.random_seed % 2 == 0 and "hard" not in name,
        build_s=1.0,
        wall_s=3.0,
    )


def judge(name, item):
    return [{"left_out": "too wide" if name == "bowl" else None}]


def evaluate(out, *arguments):
    objects = ("--jobs", "1", "--objects", "mug,bowl,ball", "--trials", "3")
    return cli.main(["evaluate", "static", "--out", str(out), *objects, *arguments])


def summary_of(out):
    return json.loads((out / "summary.json").read_text())


def rows_of(out):
    return {(row["preset"], row["name"]): row for row in summary_of(out)["rows"]}


def test_protocols_have_rows_and_objects_without_a_grasp_are_named(fake_runs, tmp_path, capsys):
    assert evaluate(tmp_path) == 0
    assert len(set(fake_runs)) == len(fake_runs) == 3 * 2 * 3
    found = rows_of(tmp_path)
    assert found["honest", "static.held_percent"]["value"] == pytest.approx(200.0 / 3.0)
    assert found["hard", "static.held_percent"]["value"] == 0.0
    assert found["hard", "static.cause.slipped_percent"]["value"] == 100.0
    assert found["paper/mug", "static.object_held_percent"]["n"] == 3
    assert found["honest", "static.run_s"]["value"] == 4.0
    assert summary_of(tmp_path)["conditions"]["left_out"] == {"bowl": "too wide"}
    assert "left out: bowl (too wide)" in capsys.readouterr().out
    assert cli.main(["report", str(tmp_path)]) == 0
    text = (tmp_path / "report.md").read_text()
    assert "| printed: the paper | 90.00 (11.49) |" in text and "left out: bowl" in text


def test_the_ablation_has_every_sampler_and_stage(fake_runs, tmp_path):
    assert evaluate(tmp_path, "--protocols", "honest", "--ablation") == 0
    found = {preset for preset, name in rows_of(tmp_path) if name == "static.held_percent"}
    stages = ("", "+filter", "+filter+reachability")
    samplers = ("network", "paper", "antipodal", "diffusion")
    assert found == {"honest", *(f"honest/{a}{b}" for a in samplers for b in stages)}
    assert len(fake_runs) == 12 * 2 * 3  # the whole pipeline is run once
    assert cli.main(["report", str(tmp_path)]) == 0
    text = (tmp_path / "report.md").read_text()
    for stage, share in (("", 77.6), ("+filter", 88.6), ("+filter+reachability", 90.0)):
        assert f"| printed: network{stage} | {share} |" in text


def plan_of(*arguments, out="out"):
    parser = argparse.ArgumentParser()
    static.add_arguments(parser)
    return static.plan(parser.parse_args(["--out", str(out), "--jobs", "1", *arguments]))


def test_by_the_camera_alone_pose_and_mask_are_not_given(monkeypatch, tmp_path):
    monkeypatch.setattr(static, "judge", judge)
    for run in plan_of("--camera", "--objects", "mug", "--trials", "1", out=tmp_path).runs:
        assert run.name.startswith("StaticCamera-")
        assert run.scenario.tracker.kind == "camera"
        assert run.scenario.perception.segmentation == "depth"


def test_rules_are_what_they_are_called(monkeypatch, tmp_path):
    monkeypatch.setattr(static, "judge", judge)
    runs = plan_of("--objects", "mug", "--trials", "2", out=tmp_path).runs
    by_name = {(run.name, run.scenario.random_seed): run.scenario for run in runs}
    honest, hard, paper = (by_name[f"Static-{n}", 1] for n in ("honest", "hard", "paper"))
    assert (
        0.5 <= make_friction(honest) <= 0.7
        and honest.camera_noise
        and honest.perception.latency > 0
    )
    np.testing.assert_array_equal(make_motion(hard).pose(0.0), make_motion(honest).pose(0.0))
    assert (hard.object.friction, hard.object.mass_factor) == (0.3, 2.0)
    X = make_hand_error(hard)
    assert np.linalg.norm(X[:3, 3]) == pytest.approx(0.005)
    assert np.degrees(np.arccos((np.trace(X[:3, :3]) - 1) / 2)) == pytest.approx(5.0)
    np.testing.assert_array_equal(make_hand_error(honest), np.eye(4))
    np.testing.assert_array_equal(make_motion(paper).pose(0.0)[:3, :3], np.eye(3))
    assert (paper.object.friction, paper.object.mass) == (100.0, 0.1) and paper.execution.teleport


def test_shards_do_all_runs_once_and_come_together(fake_runs, tmp_path):
    for k in (1, 2, 3):
        assert evaluate(tmp_path, "--shard", f"{k}/4") == 0
        part = summary_of(tmp_path / Shard(k, 4).folder)
        assert part["partial"] is True
    assert len(set(fake_runs)) == len(fake_runs) < 18
    done = set(fake_runs)
    assert evaluate(tmp_path) == 0  # the fourth was killed: its runs are done now
    assert len(set(fake_runs)) == len(fake_runs) == 18
    assert {f.stem for f in (tmp_path / "runs").iterdir()} == set(fake_runs) > done
    whole = summary_of(tmp_path)
    assert "partial" not in whole

    alone = tmp_path / "alone"
    assert evaluate(alone, "--jobs", "2") == 0
    assert summary_of(alone)["rows"] == whole["rows"]


def test_a_wrong_protocol_is_refused(fake_runs, tmp_path, capsys):
    assert evaluate(tmp_path, "--protocols", "gentle") == 2
    assert "choose of honest, hard, paper" in capsys.readouterr().err


def test_what_the_hand_cannot_hold_is_judged_on_the_true_surface(tmp_path):
    assert static.judge("soup_can", "soup_can") == [{"left_out": None}]
    cube = tmp_path / "cube.obj"
    trimesh.creation.box((0.2, 0.2, 0.2)).export(cube)
    (record,) = static.judge("cube", str(cube))
    assert "no grasp for this hand" in record["left_out"]
    (tmp_path / "open.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n")
    (record,) = static.judge("open", str(tmp_path / "open.obj"))
    assert record["left_out"]
