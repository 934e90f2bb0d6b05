"""What is finished is not done again, unless code or settings have changed."""

import json
import math

import pytest

from feasigrasp.outputs import write_json
from feasigrasp_lab.results.finished import finish_all, read_finished


def test_finished_work_is_kept_while_nothing_changed(tmp_path):
    made = []

    def measure(name, item, seed):
        made.append(1)
        return [{"name": name, "value": 1.5, "missing": math.nan}]

    def finish(seed):
        return finish_all({"a": 0}, tmp_path, {"seed": seed}, measure, jobs=1, desc="items")

    first = finish(0)
    assert first == [{"name": "a", "value": 1.5, "missing": None}]
    assert finish(0) == first and len(made) == 1
    finish(1)
    assert len(made) == 2
    (tmp_path / "a.json").write_text("{")
    assert finish(1) == first and len(made) == 3


def test_every_item_is_measured_once(tmp_path, capsys):
    def measure(name, item, seed):
        (tmp_path / "asked.txt").open("a").write(f"{name} {item} {seed}\n")
        return [{"name": name, "value": item}]

    items = {"a": 1, "b": 2}
    options = {"jobs": 1, "desc": "items"}
    first = finish_all(items, tmp_path, {"seed": 3}, measure, **options)
    assert first == [{"name": "a", "value": 1}, {"name": "b", "value": 2}]
    assert finish_all(items, tmp_path, {"seed": 3}, measure, **options) == first
    assert "2 of 2 are finished already" in capsys.readouterr().out
    finish_all(items | {"b": 4}, tmp_path, {"seed": 3}, measure, **options)
    assert (tmp_path / "asked.txt").read_text().splitlines() == ["a 1 3", "b 2 3", "b 4 3"]


def test_finished_records_are_those_of_the_same_code_and_settings(tmp_path):
    filename, records = tmp_path / "a.json", [{"object": "ball", "error_mm": 0.5, "held": None}]
    key = {"git": "abc", "seed": 0, "range": (0, 1)}  # JSON makes a list of the tuple
    assert read_finished(filename, {"key": key}) is None
    write_json({"key": key, "records": records}, filename)
    assert read_finished(filename, {"key": key})["records"] == records
    assert read_finished(filename, {"key": key | {"seed": 1}}) is None
    assert read_finished(filename, {"key": key | {"more": 1}}) is None
    assert read_finished(filename, json.loads(filename.read_text())) is not None


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "{}", '{"key": {"seed": 1}}'])
def test_files_that_are_not_ours_hold_nothing_finished(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    assert read_finished(tmp_path / "a.json", {"key": {"seed": 0}}) is None
