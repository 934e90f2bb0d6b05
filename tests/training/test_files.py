"""The files of a training run: whole, resumable, and never mixed with those of another run."""

import csv
import math

import pytest
import torch

from feasigrasp.training.files import (
    TrainingError,
    append_curve,
    read_checkpoint,
    without_denormals,
    write_checkpoint,
)

IDENTITY = {"seed": 3, "shape": {"hidden": [16, 16]}}


def lines(folder):
    with (folder / "curve.csv").open(newline="") as file:
        return list(csv.reader(file))


def test_denormal_numbers_come_back_after_a_training():
    smallest = torch.tensor([1e-30])
    with pytest.raises(KeyError), without_denormals():
        assert (smallest * 1e-10).item() == 0.0
        raise KeyError
    assert (smallest * 1e-10).item() > 0.0


def test_what_was_written_is_read(tmp_path):
    weights = torch.nn.Linear(3, 2).state_dict()
    write_checkpoint(tmp_path, IDENTITY, network=weights, progress=[7, 1.5, math.inf, 0])
    state = read_checkpoint(tmp_path, IDENTITY, "cpu")
    assert state.keys() == {"network", "progress"}
    assert all(torch.equal(state["network"][name], weights[name]) for name in weights)
    assert state["progress"] == [7, 1.5, math.inf, 0]
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_the_layout_of_a_checkpoint_stays(tmp_path):
    """One flat dictionary: so a run that was begun with an earlier version goes on."""
    torch.save({"identity": IDENTITY, "progress": [1, 2.0, 3.0, 4]}, tmp_path / "checkpoint.pt")
    assert read_checkpoint(tmp_path, IDENTITY, "cpu") == {"progress": [1, 2.0, 3.0, 4]}


def test_an_interrupted_write_keeps_the_checkpoint_before(tmp_path, monkeypatch):
    write_checkpoint(tmp_path, IDENTITY, progress=[1])

    def full_disk(state, filename):
        filename.write_bytes(b"PK")
        raise OSError("no space left on device")

    monkeypatch.setattr(torch, "save", full_disk)
    with pytest.raises(OSError, match="no space"):
        write_checkpoint(tmp_path, IDENTITY, progress=[2])
    assert read_checkpoint(tmp_path, IDENTITY, "cpu") == {"progress": [1]}


def test_another_run_is_refused_and_left_alone(tmp_path):
    write_checkpoint(tmp_path, IDENTITY, progress=[1])
    append_curve(tmp_path, ("step",), {"step": 1.0})
    with pytest.raises(TrainingError, match=r"'seed': 3.*'seed': 4.*choose another --out"):
        read_checkpoint(tmp_path, IDENTITY | {"seed": 4}, "cpu")
    assert lines(tmp_path) == [["step"], ["1"]]
    assert read_checkpoint(tmp_path, IDENTITY, "cpu") is not None


def test_a_new_run_makes_its_folder_and_begins_the_curve_anew(tmp_path):
    folder = tmp_path / "a" / "b"
    assert read_checkpoint(folder, IDENTITY, "cpu") is None
    append_curve(folder, ("step", "loss"), {"step": 100.0, "loss": 1.0})
    # Killed before its first checkpoint: the line belongs to no run that goes on.
    assert read_checkpoint(folder, IDENTITY, "cpu") is None
    append_curve(folder, ("step", "loss"), {"loss": 2 / 3, "step": 200.0, "more": 1.0})
    append_curve(folder, ("step", "loss"), {"step": 300.0})
    assert lines(folder) == [["step", "loss"], ["200", "0.666667"], ["300", "nan"]]
