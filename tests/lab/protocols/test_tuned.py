"""Runs that constants were chosen on are known, and stand in no figure with others."""

from importlib import resources

import pytest
import yaml

from feasigrasp_lab.protocols.tuned import TUNED, is_tuned, rows_apart
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.results.statistics import grouped


@pytest.mark.parametrize(
    ("name", "model", "seed", "tuned"),
    [
        ("ReachCircular", "mug", 0, True),
        ("ReachCircular", "mug", 2, True),
        ("ReachCircular", "mug", 500, False),
        ("ReachCircular", "out/objects/test_mug_0.obj", 3, False),
        ("ReachCircularMocap-at-0.6", "mug", 0, True),
        ("ReachCircularMocap-at-0.6", "mug", 1, False),
        ("ReachCircularMocap-at-0.6", "mug", 103, True),
        ("ReachCircularMocap-spin-0.5", "mug", 1, True),
        ("Static-honest", "../ycb/029_plate", 0, True),
        ("StaticCamera-hard", "../ycb/024_bowl", 0, False),
        ("ReachCircular", "029_plate", 0, False),
    ],
)
def test_the_file_says_what_constants_were_chosen_on(name, model, seed, tuned):
    assert is_tuned(name, model, seed) is tuned


def test_every_entry_has_a_reason_and_the_last_one_is_of_all_runs():
    file = resources.files("feasigrasp_lab.protocols").joinpath("tuned.yaml")
    entries = yaml.safe_load(file.read_text())
    assert all(set(each) == {"runs", "objects", "seeds", "reason"} for each in entries)
    assert entries[-1]["runs"] == "*"


def record(seed):
    return {"scenario": "ReachLinear-at-0.6", "object": "mug", "seed": seed}


def count(records):
    return [Row.plain("seeds", preset, len(records), "1", len(records)) for preset in ("a", "b")]


@pytest.mark.parametrize("seeds", [[0], [1, 2], [0, 1, 2], [2, 0]])
def test_no_row_is_of_both_kinds(seeds):
    rows = rows_apart([record(seed) for seed in seeds], count)
    parts = grouped(rows, lambda row: row.tuned)
    assert {tuned: part[0].n for tuned, part in parts.items()} == {
        tuned: len(part) for tuned, part in grouped(seeds, lambda seed: seed == 0).items()
    }
    mixed = len(parts) > 1
    assert all(row.preset.startswith(TUNED) == (mixed and row.tuned) for row in rows)
    assert len({row.preset for row in rows}) == len(rows)
