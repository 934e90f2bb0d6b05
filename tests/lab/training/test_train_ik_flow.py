"""``feasigrasp train ik-flow``: a short run, what it leaves behind, and how it goes on."""

import csv
import json

import numpy as np
import pytest
import torch

from feasigrasp import cli
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.arm import in_collision
from feasigrasp_lab.paper.ik_flow import IkFlow
from feasigrasp_lab.paper.ik_flow_layers import FlowShape
from feasigrasp_lab.training import train_ik_flow
from feasigrasp_lab.training.train_ik_flow import Training, training_batch

SMALL = FlowShape(components=(4, 3, 2, 2, 2, 2, 2), hidden=((16,),) * 7, narrowest=0.01)


@pytest.fixture(autouse=True)
def small_network(monkeypatch):
    monkeypatch.setattr(train_ik_flow, "FlowShape", lambda: SMALL)


def train(out, *arguments):
    options = ["--batch", "64", "--held-out", "100", "--device", "cpu", "--every", "2"]
    return cli.main(["train", "ik-flow", "--out", str(out), *options, *arguments])


def parsed(out, *arguments):
    parser = train_ik_flow.argparse.ArgumentParser()
    train_ik_flow.add_arguments(parser)
    options = ["--batch", "64", "--held-out", "100", "--device", "cpu"]
    return parser.parse_args(["--out", str(out), *options, *arguments])


def curve(out):
    with (out / "curve.csv").open() as file:
        return list(csv.DictReader(file))


def test_two_steps_and_two_more(tmp_path, capsys):
    assert train(tmp_path, "--steps", "2") == 0
    assert [float(row["step"]) for row in curve(tmp_path)] == [2]
    flow = IkFlow.load(tmp_path / "ik_flow.npz")
    assert flow.shape == SMALL
    assert json.loads((tmp_path / "run.json").read_text())["seed"] == 0

    assert train(tmp_path, "--steps", "4") == 0
    rows = curve(tmp_path)
    assert [float(row["step"]) for row in rows] == [2, 4]
    assert all(np.isfinite(float(value)) for row in rows for value in row.values())
    assert float(rows[1]["minutes"]) > float(rows[0]["minutes"])

    capsys.readouterr()
    assert train(tmp_path, "--steps", "4") == 0
    assert "is finished" in capsys.readouterr().out
    assert len(curve(tmp_path)) == 2


def test_minutes_end_a_run(tmp_path):
    assert train(tmp_path, "--minutes", "0.001") == 0
    assert float(curve(tmp_path)[-1]["minutes"]) >= 0.001


def test_a_resumed_run_ends_where_an_uninterrupted_one_does(tmp_path):
    whole = Training(parsed(tmp_path / "whole", "--steps", "4"), SMALL)
    losses = [whole.advance() for _ in range(4)]

    arguments = parsed(tmp_path / "parts", "--steps", "4")
    part = Training(arguments, SMALL)
    first = [part.advance() for _ in range(2)]
    part.evaluate({})
    resumed = Training(arguments, SMALL)
    assert resumed.step == 2
    assert [*first, resumed.advance(), resumed.advance()] == losses
    for a, b in zip(whole.network.parameters(), resumed.network.parameters(), strict=True):
        assert torch.equal(a, b)


def test_training_makes_the_data_likelier(tmp_path):
    training = Training(parsed(tmp_path, "--steps", "60", "--learning-rate", "1e-2"), SMALL)
    before = training.evaluate({})["held_out_nll"]
    for _ in range(60):
        training.advance()
    assert training.evaluate({})["held_out_nll"] < before - 2.0


def test_a_folder_of_another_run_is_refused(tmp_path, capsys):
    assert train(tmp_path, "--steps", "2") == 0
    assert train(tmp_path, "--steps", "4", "--seed", "1") == 2
    assert "choose another --out" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--minutes", "0"], ["--steps", "1", "--minutes", "1"]])
def test_wrong_lengths_are_refused(tmp_path, arguments):
    with pytest.raises(SystemExit):
        train(tmp_path, *arguments)


def test_samples_are_free_and_fit_their_poses():
    q, X = training_batch(np.random.default_rng(0), 2000)
    assert 1900 < len(q) < 2000  # some are in self-collision
    assert not in_collision(q).any()
    assert (np.abs(q) <= IIWA_7.upper).all()
    assert np.abs(q / IIWA_7.upper).max(axis=0).min() > 0.99
    np.testing.assert_array_equal(X, forward_kinematics(q))
