"""The gallery: what it shows, and its page."""

import argparse
import json
import re

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.runs import run as run_module
from feasigrasp.runs.run import crash_record
from feasigrasp_lab.results import finished, workers
from feasigrasp_lab.runs import isolated
from feasigrasp_lab.studies import gallery


def planned(*arguments):
    parser = argparse.ArgumentParser()
    gallery.add_arguments(parser)
    return gallery.shown(gallery.plan(parser.parse_args(arguments)).runs)


def test_there_is_one_run_for_every_row_of_the_tables():
    runs = planned("--seeds", "1")
    rows = {(r.name, r.scenario.control.controller, r.scenario.control.mode) for r in runs}
    assert len(rows) == len(runs) == 6 * 2 * 3 + 2 * (5 * 3 + 4 + 2)
    for run in runs:
        assert run.scenario.random_seed == 0
        if not run.scenario.grasp.close:
            assert run.object_name == "duck"
            assert run.scenario.simulation_duration == pytest.approx(
                2 * np.pi / run.scenario.motion.rate
            )


@pytest.fixture
def fake_runs(monkeypatch):
    ran = []

    def run(scenario, name, filename, *, replay):
        ran.append(replay.stem)
        record = crash_record(scenario, name, "") | {"error": None}
        record["metrics"] |= {"gripper_object_distance_cm_mean": 3.456, "grasp_held": True}
        record["timings"]["wall_s"] = 1.0
        filename.write_text(json.dumps(record))
        replay.write_text("<html>a replay</html>")
        return record

    monkeypatch.setattr(isolated, "run_isolated", run)
    monkeypatch.setattr(gallery, "take_picture", lambda replay: "task" in replay.stem)
    for module in (finished, workers, gallery, run_module):
        monkeypatch.setattr(module, "git_revision", lambda: "57f3f21b0c4e")
    return ran


def show(out):
    return cli.main(["evaluate", "gallery", "--out", str(out), "--scenarios", "ReachLinearMocap",
                     "--objects", "mug,ball", "--jobs", "1"])  # fmt: skip


def test_the_page_links_every_replay(fake_runs, tmp_path):
    assert show(tmp_path) == 0
    assert fake_runs == ["ReachLinearMocap-mug-task-safe-0", "ReachLinearMocap-mug-joint-safe-0"]
    page = (tmp_path / "index.html").read_text()
    links = re.findall(r'href="([^"]+)"', page)
    assert links == [f"{name}.html" for name in fake_runs]
    assert all((tmp_path / link).exists() for link in links)
    assert re.findall(r'<img src="([^"]+)"', page) == ["ReachLinearMocap-mug-task-safe-0.png"]
    assert "<dd>3.46</dd>" in page and "<dd>yes</dd>" in page
    assert "57f3f21b0c4e" in page and "$" not in page


def test_finished_replays_are_kept(fake_runs, tmp_path):
    show(tmp_path)
    (tmp_path / "ReachLinearMocap-mug-joint-safe-0.html").unlink()
    fake_runs.clear()
    show(tmp_path)
    assert fake_runs == ["ReachLinearMocap-mug-joint-safe-0"]
