"""Reference runs tell whether figures of an older revision are those of this code."""

import numpy as np
import pytest
import yaml

from feasigrasp.scenario.files import load_scenario
from tools import same_runs, stored

LOG = {"time": np.arange(3.0), "phase": np.array([0, 1, 1], np.int8), "q": np.full((3, 7), np.nan)}


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, []),
        ({"q": np.zeros((3, 7))}, ["q"]),
        ({"time": np.nextafter(LOG["time"], 9.0)}, ["time"]),
        ({"time": np.arange(4.0), "more": np.zeros(1)}, ["more", "time"]),
    ],
)
def test_one_bit_makes_two_logs_differ(tmp_path, change, found):
    np.savez(tmp_path / "one.npz", **LOG)
    np.savez(tmp_path / "other.npz", **LOG | change)
    assert same_runs.differences(tmp_path / "one.npz", tmp_path / "other.npz") == found


def test_a_revision_stands_for_itself_unless_runs_of_the_kind_were_compared(monkeypatch, tmp_path):
    notes = tmp_path / "same_runs.yaml"
    notes.write_text("same: {camera: {aaaa: bbbb}, pose given: {}}\n")
    monkeypatch.setattr(same_runs, "RUNS", notes)
    assert same_runs.stands_for("aaaa", "camera") == "bbbb"
    assert same_runs.stands_for("aaaa", "pose given") == "aaaa"
    assert same_runs.stands_for("cccc", "camera") == "cccc"
    assert same_runs.stands_for("aaaa", "other") == "aaaa"


@pytest.mark.parametrize("kind", ["camera", "pose given", "paper"])
def test_the_reference_runs_are_of_their_kind(kind):
    runs = yaml.safe_load(same_runs.RUNS.read_text())["runs"][kind]
    assert len({*runs}) == len(runs) >= (2 if kind == "paper" else 6)
    for words in runs:
        tracker = load_scenario(words.split()[0]).tracker.kind
        assert (tracker == "camera") == (kind == "camera")


def test_stored_rows_are_of_the_kind_that_their_command_ran():
    for kind, names in {
        "camera": ["dynamic_test_camera", "dynamic_obstacle_camera"],
        "pose given": ["dynamic_test", "static_honest"],
        "paper": ["dynamic_paper"],
        "other": ["bench_control", "tracking", "paper"],
    }.items():
        assert [stored.read(name).kind for name in names] == [kind] * len(names)
