"""What the console says of a run: the line while it goes on, the verdict, the figures."""

import io
import re
import time

import numpy as np
import pytest

from feasigrasp.models.control.status import Status, StatusCode
from feasigrasp.resources import diagram_path
from feasigrasp.runs.console import StatusLine, progress, summary, verdict
from feasigrasp.runs.metrics.cause import Cause
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.runs.run import crash_record, run
from feasigrasp.scenario.files import load_scenario

FILE = diagram_path("dynamic.scenarios.yaml")
TEXT = "{simulation_duration: 0.3, random_seed: 3, object: {model: soup_can}}"


class Terminal(io.StringIO):
    """A stream that says that it is a terminal, and what is seen on it in the end."""

    def isatty(self):
        return True

    def screen(self):
        """Its last line, as `\\r` and "erase to the end of the line" leave it."""
        seen, at = "", 0
        for part in re.split(r"(\r|\x1b\[K)", self.getvalue().rpartition("\n")[2]):
            if part == "\r":
                at = 0
            elif part == "\x1b[K":
                seen = seen[:at]
            else:
                seen = seen[:at] + part + seen[at + len(part) :]
                at += len(part)
        return seen


def record(**metrics):
    made = crash_record(load_scenario(FILE, "ReachLinearMocap"), "ReachLinearMocap", None)
    return made | {"metrics": made["metrics"] | metrics}


def test_a_shorter_line_leaves_nothing_of_a_longer_one():
    terminal = Terminal()
    line = StatusLine(terminal)
    line.show("a long line")
    assert terminal.screen() == "a long line"
    line.show("short")
    assert terminal.screen() == "short"
    line.clear()
    assert terminal.screen() == ""


def test_a_line_fits_the_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    terminal = Terminal()
    StatusLine(terminal).show("x" * 50)
    assert terminal.screen() == "x" * 19


def test_a_patient_line_does_not_flicker():
    terminal = Terminal()
    line = StatusLine(terminal)
    for k in range(50):
        line.show(str(k), patient=True)
    assert terminal.screen() == "0"
    line.show("now")
    assert terminal.screen() == "now"


def test_what_is_no_terminal_gets_no_line():
    stream = io.StringIO()
    line = StatusLine(stream)
    line.show("anything")
    line.clear()
    assert stream.getvalue() == ""


def test_a_text_that_stays_counts_the_seconds():
    terminal = Terminal()
    line = StatusLine(terminal)
    line.show("building")
    deadline = time.monotonic() + 20.0
    while "(1 s)" not in terminal.screen() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert terminal.screen() == "building  (1 s)"
    line.show("starting")
    assert terminal.screen() == "starting"
    line.clear()
    said = terminal.getvalue()
    time.sleep(1.6)
    assert terminal.getvalue() == said and terminal.screen() == ""


def test_progress_says_time_speed_and_status():
    status = Status(1.0, StatusCode.NO_GRASP, "too wide")
    said = progress(3.0, 2.0, status)
    assert "3.0 s" in said and "1.50 x real time" in said
    assert said.endswith("no grasp: too wide")
    assert "0.00 x" in progress(0.0, 0.0, status)


def test_the_line_changes_nothing_that_is_computed():
    scenario = load_scenario(FILE, "ReachLinearMocap", TEXT)
    terminal = Terminal()
    said, silent = run(scenario, line=StatusLine(terminal)), run(scenario)
    np.testing.assert_array_equal(said.samples, silent.samples)
    assert said.record["status"] == silent.record["status"]
    text = terminal.getvalue()
    order = [text.index(word) for word in ("building", "starting", "simulating", "measuring")]
    assert order == sorted(order)


@pytest.mark.parametrize(
    ("metrics", "says"),
    [
        ({"grasp_held": True, "cause": None}, "held"),
        (
            {"cause": Cause.SLIPPED, "slip_mm": 31.2, "turn_deg": 7.0},
            "not held: slipped (slip 31 mm, turned 7 deg)",
        ),
        ({"cause": Cause.SLIPPED}, "not held: slipped"),
        ({"cause": Cause.DROPPED, "slip_mm": 12.0}, "not held: dropped (slip 12 mm)"),
        ({"cause": Cause.PUSHED_AWAY, "pushed_mm": 60.0}, "not held: pushed away (by 60 mm)"),
        ({"cause": Cause.NONE_REACHABLE}, "not held: none reachable (last: pose lost: for 2 s)"),
        ({"cause": Cause.OUT_OF_TIME}, "not held: out of time (last: pose lost: for 2 s)"),
        ({"grasp_held": None, "cause": None}, "followed, with an open gripper"),
        (
            {"grasp_held": None, "cause": None, "tracked_percent": 81.0},
            "followed, with an open gripper (at a grasp 81 % of the time)",
        ),
    ],
)
def test_the_verdict_says_why(metrics, says):
    status = [[0.0, "following", ""], [4.0, "pose_lost", "for 2 s"]]
    assert verdict(record(**metrics) | {"status": status}) == says


def test_a_run_that_broke_off_says_why():
    assert verdict(record() | {"error": "no convergence"}) == (
        "not held: broke off (no convergence)"
    )
    open_hand = record(grasp_held=None, cause=None) | {"error": "interrupted"}
    assert verdict(open_hand) == "broke off (interrupted)"


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_a_verdict(cause):
    assert verdict(record(cause=cause)) == f"not held: {cause.replace('_', ' ')}"


def test_the_summary_has_verdict_history_and_every_figure():
    made = record(cause=Cause.SLIPPED, slip_mm=31.25, friction=0.6)
    lines = list(summary(made | {"status": [[4.0, "pose_lost", "for 2 s"]]}))
    assert lines[0].startswith("not held: slipped")
    assert "     4.00 s  pose lost: for 2 s" in lines
    shown = [*METRICS, *made["timings"]]
    assert sorted(line.split()[0] for line in lines if line.split()[0] in shown) == sorted(shown)
    values = {name: rest for name, *rest in map(str.split, lines) if name in shown}
    assert values["slip_mm"] == ["31.25", "mm"] and values["friction"] == ["0.6"]
    assert values["grasp_held"] == ["no"] and values["turn_deg"] == ["-"]
