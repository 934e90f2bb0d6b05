"""Interruptions and full disks lose nothing of what was computed."""

import os
import signal
import threading
import time

import pytest

from feasigrasp.errors import OutputError
from feasigrasp.resources import diagram_path
from feasigrasp.runs.results.interrupts import Unfinished, postponed_interrupt
from feasigrasp.runs.run import INTERRUPTED, crash_record, run
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.runs import isolated
from feasigrasp_lab.runs.plan import PlannedRun


@pytest.fixture(autouse=True)
def received_interrupts():
    """Of a process in a shell's background Python leaves interrupts ignored, as it finds them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def small_run():
    text = "{object: {model: ball}}"
    return load_scenario(diagram_path("dynamic.scenarios.yaml"), "PaperLinear", text)


def test_ctrl_c_ends_a_run_with_what_it_has(tmp_path):
    scenario = small_run()
    scenario.simulation_duration = 0.1
    run(scenario)  # everything is loaded
    scenario.simulation_duration = 60.0
    kept = []
    interrupt = threading.Timer(3.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    interrupt.start()
    record = run(scenario, "Mine", keep=kept.append).record
    interrupt.join()
    assert kept == [record] and record["error"] == INTERRUPTED
    assert 0.0 < record["timings"]["simulated_s"] < 60.0
    assert record["metrics"]["manipulability_mean"] > 0.0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_breaks_off(capsys):
    with pytest.raises(KeyboardInterrupt), postponed_interrupt() as asked:
        assert not asked.is_set()
        os.kill(os.getpid(), signal.SIGINT)
        assert asked.is_set()
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.0)
    assert "once more" in capsys.readouterr().err


def test_the_record_is_there_before_a_replay_that_cannot_be_written(tmp_path, full_disk):
    scenario = small_run()
    scenario.simulation_duration = 0.1
    kept = []
    with pytest.raises(OutputError, match="full.html"):
        run(scenario, "Mine", replay=tmp_path / "full.html", keep=kept.append)
    assert kept[0]["error"] is None


def test_a_full_disk_keeps_the_record_of_the_run_that_met_it(tmp_path, monkeypatch):
    planned = [PlannedRun("Mine", "ball", Scenario(random_seed=seed)) for seed in range(3)]

    def fake(scenario, name, filename, *, replay=None):
        record = crash_record(scenario, name, "") | {"error": None}
        if scenario.random_seed == 1:
            raise Unfinished(f"{filename} cannot be written", [record], 2)
        return record

    monkeypatch.setattr(isolated, "run_isolated", fake)
    with pytest.raises(Unfinished, match="cannot be written; 2 of 3 runs came") as stopped:
        isolated.run_all(planned, tmp_path / "runs", 1, desc="test")
    assert [record["seed"] for record in stopped.value.records] == [0, 1]
    assert stopped.value.status == 2


def test_evaluations_with_a_crash_end_non_zero(capsys):
    records = [crash_record(Scenario(), "Mine", "boom"), crash_record(Scenario(), "Mine", "boom")]
    assert isolated.report_crashes(records) == 1
    assert "2 of 2 runs broke off: boom" in capsys.readouterr().err
    assert isolated.report_crashes([record | {"error": None} for record in records]) == 0
