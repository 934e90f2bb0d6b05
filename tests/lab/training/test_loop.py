"""What all trainings share: schedule and order of the examples; files, whole and of one run."""

import argparse
import csv

import numpy as np
import pytest
import torch

from feasigrasp_lab.training.loop import (
    TrainingError,
    TrainingRun,
    learning_rate,
    rows_of_step,
    without_denormals,
)


class LinearRun(TrainingRun[torch.nn.Linear]):
    weights = "linear.npz"
    columns = ("step", "third", "nothing")
    shown = "a third: {third}"
    criterion, less_is_better = "size", True

    def losses(self):
        return {"loss": self.network(torch.ones(1, 3)).square().sum()}

    def measure(self):
        size = sum(float(p.detach().square().sum()) for p in self.averaged.parameters())
        return {"third": 1.0 / 3.0, "size": size}

    def export(self):
        torch.save(self.averaged.state_dict(), self.folder / self.weights)


def begun(folder, seed=3, device="cpu"):
    args = argparse.Namespace(
        **{"out": folder, "device": device, "steps": 4, "every": 2, "patience": 2},
        **{"learning_rate": 0.1, "minutes": None},
    )
    sgd = torch.optim.SGD, {"lr": 0.1}
    return LinearRun(args, torch.nn.Linear(3, 2), sgd, {"seed": seed, "hidden": [16]})


def lines(folder):
    with (folder / "curve.csv").open(newline="") as file:
        return list(csv.reader(file))


@pytest.mark.parametrize("least", [1e-2, 1e-3])
def test_the_learning_rate_rises_and_falls(least):
    def rate(step, done):
        return learning_rate(1.0, step, done, 100, least)

    assert rate(0, 0.0) < 0.02
    assert rate(1000, 0.0) == pytest.approx(1.0)
    assert rate(1000, 0.5) == pytest.approx(0.5, abs=least)
    assert rate(1000, 1.0) == pytest.approx(least)


def test_every_epoch_passes_over_all_examples_in_another_order():
    epochs = [
        np.concatenate([rows_of_step(12, 4, 5, 3 * epoch + step) for step in range(3)])
        for epoch in range(2)
    ]
    for rows in epochs:
        assert sorted(rows) == list(range(12))
    assert (epochs[0] != epochs[1]).any()
    assert len(rows_of_step(3, 8, 5, 0)) == 3


def test_denormal_numbers_come_back_after_a_training():
    smallest = torch.tensor([1e-30])
    with pytest.raises(KeyError), without_denormals():
        assert (smallest * 1e-10).item() == 0.0
        raise KeyError
    assert (smallest * 1e-10).item() > 0.0


def test_what_was_written_is_read(tmp_path):
    run = begun(tmp_path)
    run.advance()
    run.best, run.worse = 0.5, 2
    run.save()
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
    resumed = begun(tmp_path)
    for name in ("network", "averaged"):
        written, read = (getattr(r, name).state_dict() for r in (run, resumed))
        assert all(torch.equal(written[key], read[key]) for key in written)
    assert (resumed.step, resumed.seconds, resumed.best) == (1, run.seconds, 0.5)
    assert resumed.worse == 2


def test_the_layout_of_a_checkpoint_stays(tmp_path):
    """One flat dictionary: so a run that was begun with an earlier version goes on."""
    begun(tmp_path).save()
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert set(state) == {"identity", "network", "optimizer", "averaged", "progress"}
    assert len(state["progress"]) == 4
    del state["averaged"]
    torch.save({**state, "progress": [1, 2.0]}, tmp_path / "checkpoint.pt")
    run = begun(tmp_path)
    assert torch.equal(run.averaged.weight, run.network.weight)
    assert (run.step, run.seconds, run.worse) == (1, 2.0, 0)


def test_an_interrupted_write_keeps_the_checkpoint_before(tmp_path, monkeypatch):
    run = begun(tmp_path)
    run.save()
    run.advance()

    def full_disk(state, file):
        file.write(b"PK")
        raise OSError("no space left on device")

    monkeypatch.setattr(torch, "save", full_disk)
    with pytest.raises(OSError, match="no space"):
        run.save()
    assert begun(tmp_path).step == 0


def test_a_checkpoint_that_is_cut_off_is_refused_with_the_mend(tmp_path):
    begun(tmp_path).save()
    file = tmp_path / "checkpoint.pt"
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(TrainingError, match="checkpoint.pt is no whole checkpoint.*delete it"):
        begun(tmp_path)


def test_another_run_is_refused_and_left_alone(tmp_path):
    begun(tmp_path).evaluate({})
    before = lines(tmp_path)
    with pytest.raises(TrainingError, match=r"'seed': 3.*'seed': 4.*choose another --out"):
        begun(tmp_path, seed=4)
    assert lines(tmp_path) == before
    begun(tmp_path)


def test_a_new_run_makes_its_folder_and_begins_the_curve_anew(tmp_path):
    folder = tmp_path / "a" / "b"
    begun(folder).evaluate({})
    # Killed before its first checkpoint: the line belongs to no run that goes on.
    (folder / "checkpoint.pt").unlink()
    run = begun(folder)
    run.advance()
    run.evaluate({})
    run.evaluate({})
    line = ["1", "0.333333", "nan"]
    assert lines(folder) == [["step", "third", "nothing"], line, line]


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    losses = LinearRun.losses

    def interrupted(run):
        if run.step == 3:
            raise KeyboardInterrupt
        return losses(run)

    monkeypatch.setattr(LinearRun, "losses", interrupted)
    assert begun(tmp_path).run() == 130
    assert "interrupted at step 3" in capsys.readouterr().out
    monkeypatch.setattr(LinearRun, "losses", losses)
    run = begun(tmp_path)
    assert run.step == 3
    assert run.run() == 0
    assert [line[0] for line in lines(tmp_path)] == ["step", "2", "4"]


@pytest.mark.parametrize(("less", "scale"), [(True, 2.0), (False, 0.5)])
def test_the_best_weights_are_kept_and_patience_ends(tmp_path, monkeypatch, less, scale):
    monkeypatch.setattr(LinearRun, "less_is_better", less)
    run = begun(tmp_path)
    run.evaluate({})
    best = (tmp_path / "linear.npz").read_bytes()
    with torch.no_grad():
        for parameter in run.averaged.parameters():
            parameter.mul_(scale)
    run.evaluate({})
    assert not run.finished
    run.evaluate({})
    assert run.finished
    assert (tmp_path / "linear.npz").read_bytes() == best


def test_an_unknown_device_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="--device abacus"):
        begun(tmp_path, device="abacus")
