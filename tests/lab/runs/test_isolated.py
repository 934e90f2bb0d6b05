"""Runs in processes of their own: the same results, and a record however they end."""

import json
import os
import signal
from pathlib import Path

from feasigrasp.resources import diagram_path
from feasigrasp.runs import run as run_module
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.runs import isolated


def test_an_exception_in_the_process_becomes_its_record(tmp_path):
    scenario = load_scenario(
        diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", "{object: {model: teapot}}"
    )
    file = tmp_path / "run.json"
    record = isolated.run_isolated(scenario, "Mine", file)
    assert "MeshError: 'teapot' is neither" in record["error"]
    assert record["metrics"]["grasp_held"] is False
    assert json.loads(file.read_text()) == record


def run_out_of_memory(*arguments):
    Path(arguments[-1]).write_text("out of memory")
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_process_becomes_its_record(tmp_path, monkeypatch):
    monkeypatch.setattr(isolated, "_run_to_file", run_out_of_memory)
    file = tmp_path / "run.json"
    file.write_text("an old result")
    record = isolated.run_isolated(Scenario(), "Mine", file)
    assert record["error"] == "the process ended with status -9: out of memory"
    assert json.loads(file.read_text()) == record


def test_a_process_repeats_what_a_run_in_this_one_gives(tmp_path):
    text = "{simulation_duration: 0.3, object: {model: ball}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", text)
    record = isolated.run_isolated(scenario, "Mine", tmp_path / "run.json")
    here = run_module.run(scenario, "Mine").record["metrics"]
    timed = {name for name in here if "_ms_" in name}
    assert {k: v for k, v in record["metrics"].items() if k not in timed} == {
        k: v for k, v in here.items() if k not in timed
    }
