"""``feasigrasp train sampler`` on made-up shards: what it leaves, how it goes on, what it learns.

Losses and measures are held against closed forms.
"""

import csv
import json

import numpy as np
import pytest
import torch

from feasigrasp import cli
from feasigrasp.errors import InputError
from feasigrasp_lab.networks import Heads
from feasigrasp_lab.paper.grasp_network import NETWORKS
from feasigrasp_lab.training import train_sampler
from feasigrasp_lab.training.data.household_shapes import HELD_OUT
from feasigrasp_lab.training.grasp_batches import Labels, free_share, load_examples, loss
from feasigrasp_lab.training.loop import TrainingError
from feasigrasp_lab.training.train_sampler import (
    Training,
    average_precision,
    held_out_metrics,
    measures,
)

POINTS, TURNS = 40, 36


def example(rng, family):
    """An ellipsoid; a grasp starts where the chord is short, and the hand comes from above."""
    direction = rng.normal(size=(POINTS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    sides = rng.uniform(0.015, 0.05, 3)
    points, normals = direction * sides, direction / sides
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    chord = 2.0 * np.einsum("ni,ni->n", points, normals / sides**2)
    chord /= np.einsum("ni,ni->n", normals, normals / sides**2)
    contact = chord < 0.06
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    turn = 2.0 * np.pi * np.arange(TURNS) / TURNS
    side = np.cross(-normals, across)
    turned = np.cos(turn)[:, None] * across[:, None] + np.sin(turn)[:, None] * side[:, None]
    away = np.einsum("nki,ni->nk", turned, -points) > 0.0
    return {
        "points": points,
        "normals": normals,
        "scalars": np.stack([np.full(POINTS, 1e-3), chord, -np.ones(POINTS), chord * 0.0], 1),
        "contact": contact,
        "width": np.where(contact, chord, 0.0),
        "closing": -normals * contact[:, None],
        "across": across * contact[:, None],
        "free": away & contact[:, None],
        "family": family,
        "true_surface": bool(rng.integers(2)),
    }


def write_shard(path, families, seed=0):
    rng = np.random.default_rng(seed)
    examples = [example(rng, family) for family in families]
    stacked = {name: np.array([e[name] for e in examples]) for name in examples[0]}
    floats = {k: v.astype(np.float32) for k, v in stacked.items() if v.dtype == np.float64}
    np.savez(path, **{**stacked, **floats})


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shards")
    write_shard(folder / "a.npz", ["box"] * 6 + [HELD_OUT[0]] * 2, seed=1)
    write_shard(folder / "b.npz", ["bowl"] * 6 + [HELD_OUT[1]] * 2, seed=2)
    return folder


def options(data, out):
    sizes = ["--batch", "4", "--points", "20", "--device", "cpu", "--every", "2"]
    return ["--data", str(data), "--out", str(out), *sizes]


def train(data, out, *arguments):
    return cli.main(["train", "sampler", *options(data, out), *arguments])


def made(data, out, *arguments):
    parser = train_sampler.argparse.ArgumentParser()
    train_sampler.add_arguments(parser)
    args = parser.parse_args([*options(data, out), *arguments])
    return Training(args, *load_examples(data, args.seed, args.held_out))


def curve(out):
    with (out / "curve.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("preset", NETWORKS)
def test_two_steps_and_two_more(data, tmp_path, capsys, preset):
    assert train(data, tmp_path, "--steps", "2", "--preset", preset) == 0
    assert [float(row["step"]) for row in curve(tmp_path)] == [2]
    assert NETWORKS[preset].load(tmp_path / "grasp_network.npz").preset == preset
    run = json.loads((tmp_path / "run.json").read_text())
    assert run["seed"] == 0
    assert (run["examples"], run["held_out"]) == (12, 4)

    assert train(data, tmp_path, "--steps", "4", "--preset", preset) == 0
    rows = curve(tmp_path)
    assert [float(row["step"]) for row in rows] == [2, 4]
    assert all(np.isfinite(float(row["held_out_loss"])) for row in rows)
    assert float(rows[1]["minutes"]) > float(rows[0]["minutes"])

    capsys.readouterr()
    assert train(data, tmp_path, "--steps", "4", "--preset", preset) == 0
    assert "is finished" in capsys.readouterr().out
    assert len(curve(tmp_path)) == 2


def test_a_resumed_run_ends_where_an_uninterrupted_one_does(data, tmp_path):
    whole = made(data, tmp_path / "whole", "--steps", "4")
    losses = [whole.advance()["loss"] for _ in range(4)]
    part = made(data, tmp_path / "parts", "--steps", "4")
    first = [part.advance()["loss"] for _ in range(2)]
    part.evaluate({})
    resumed = made(data, tmp_path / "parts", "--steps", "4")
    assert resumed.step == 2
    assert [*first, *(resumed.advance()["loss"] for _ in range(2))] == losses
    for name in ("network", "averaged"):
        pairs = zip(
            getattr(whole, name).parameters(), getattr(resumed, name).parameters(), strict=True
        )
        assert all(torch.equal(a, b) for a, b in pairs)


@pytest.mark.parametrize("preset", NETWORKS)
def test_training_learns(data, tmp_path, preset):
    """Against the network before training, and against guessing the base rate."""
    rate = ["--learning-rate", "1e-2"]
    training = made(data, tmp_path, "--steps", "80", "--preset", preset, *rate)
    before = held_out_metrics(preset, training.network, training.examples)
    parts = [training.advance() for _ in range(80)]
    after = held_out_metrics(preset, training.network, training.examples)
    assert after["loss"] < before["loss"] - 0.3
    positive = training.examples.labels.contact.double().mean().item()
    entropy = -positive * np.log(positive) - (1 - positive) * np.log(1 - positive)
    assert np.mean([part["contact"] for part in parts[-10:]]) < entropy


def test_a_folder_of_another_run_is_refused(data, tmp_path, capsys):
    assert train(data, tmp_path, "--steps", "2") == 0
    assert train(data, tmp_path, "--steps", "4", "--seed", "1") == 2
    assert "choose another --out" in capsys.readouterr().err


def test_quick_takes_a_sample(data, tmp_path, monkeypatch):
    monkeypatch.setattr(train_sampler, "QUICK_EXAMPLES", 6)
    assert train(data, tmp_path, "--steps", "2", "--quick") == 0
    run = json.loads((tmp_path / "run.json").read_text())
    assert (run["examples"], run["held_out"]) == (6, 3)


def test_held_out_families_are_never_trained_on(data):
    examples, held_out = load_examples(data, 0, 3)
    assert set(examples.family) == {"box", "bowl"}
    assert set(held_out.family) <= set(HELD_OUT)
    assert (len(examples), len(held_out)) == (12, 3)


def test_data_that_cannot_be_used_are_refused(tmp_path, capsys):
    assert train(tmp_path, tmp_path / "out", "--steps", "2") == 2
    assert "no shards in" in capsys.readouterr().err
    write_shard(tmp_path / "a.npz", ["box"])
    with pytest.raises(TrainingError, match="families box; .* held out are needed"):
        load_examples(tmp_path, 0, 3)
    np.savez(tmp_path / "b.npz", points=np.zeros((1, 4, 3)))
    with pytest.raises(InputError, match="b.npz is no shard"):
        load_examples(tmp_path, 0, 3)


def perfect(n=4):
    """Labels of n contacts, and heads that hit them."""
    rng = np.random.default_rng(3)
    b, u = np.linalg.qr(rng.normal(size=(n, 3, 2)))[0].transpose(2, 0, 1)
    free = np.zeros((n, TURNS))
    free[:, :10] = 1.0
    tensors = [torch.tensor(x)[None] for x in (np.ones(n, bool), np.full(n, 0.03), b, u, free)]
    labels = Labels(*tensors, ring=torch.ones(1, n, 2, dtype=torch.float64))
    v = np.cross(b, u)
    turn = np.deg2rad(40.0)
    good, bad = np.cos(turn) * u + np.sin(turn) * v, -u
    heads = Heads(
        contact=torch.full((1, n), 9.0, dtype=torch.float64),
        closing=labels.closing,
        width=torch.stack((labels.width, labels.width + 0.03), -1),
        spread=torch.full((1, n, 2), 1e-3, dtype=torch.float64),
        weight=torch.tensor([[[9.0, -9.0]] * n], dtype=torch.float64),
        approach=torch.tensor(np.stack([bad, good], 1))[None],
        free=torch.tensor([[[-9.0, 9.0]] * n], dtype=torch.float64),
    )
    return heads, labels


def test_a_perfect_prediction_has_no_errors():
    heads, labels = perfect()
    _, parts = loss("default", heads, labels)
    assert parts["closing"] == 0.0
    assert parts["width"] == pytest.approx(0.0, abs=1e-7)  # log of a spread of 1 mm
    assert parts["contact"] < 1e-3
    found = measures(heads, labels)
    assert found["width_mm"].max() == 0.0
    assert found["closing_deg"].max() < 1e-5
    assert found["approach_valid"].all()
    one = heads._replace(approach=heads.approach[:, :, 1:], free=heads.free[:, :, 1:])
    assert loss("paper", one, labels)[1]["approach"] == pytest.approx(0.0, abs=1e-9)


def test_errors_are_measured():
    heads, labels = perfect()
    wrong = heads._replace(
        width=heads.width + 0.004, free=-heads.free, closing=-labels.across, contact=-heads.contact
    )
    found = measures(wrong, labels)
    other = measures(heads._replace(weight=-heads.weight), labels)  # it believes the wrong width
    np.testing.assert_allclose(other["width_mm"], 30.0)
    np.testing.assert_allclose(found["width_mm"], 4.0)
    np.testing.assert_allclose(found["closing_deg"], 90.0)
    assert not found["approach_valid"].any()
    assert not found["reliable"].any()
    _, parts = loss("default", wrong, labels)
    assert parts["width"] == pytest.approx(4.0, abs=1e-6)
    assert parts["contact"] == pytest.approx(9.0, abs=1e-3)
    # The nearest valid approach to -u is turn 9, 90 degrees away.
    one = heads._replace(approach=heads.approach[:, :, :1], free=heads.free[:, :, :1])
    assert loss("paper", one, labels)[1]["approach"] == pytest.approx(1.0, abs=1e-9)


def test_no_contact_at_all_still_trains():
    heads, labels = perfect()
    nothing = Labels(torch.zeros_like(labels.contact), *labels[1:])
    for preset in NETWORKS:
        total, _ = loss(preset, heads._replace(contact=heads.contact.requires_grad_()), nothing)
        assert torch.isfinite(total)


def test_free_turns_are_interpolated():
    b, u = torch.eye(3, dtype=torch.float64)[None, 0], torch.eye(3, dtype=torch.float64)[None, 1]
    free = torch.zeros(1, 4, dtype=torch.float64)
    free[0, 1] = 1.0  # along b x u = z
    angle = torch.deg2rad(torch.tensor([90.0, 45.0, 112.5, 270.0, -0.0], dtype=torch.float64))
    approach = torch.stack([0.3 + 0.0 * angle, angle.cos(), angle.sin()], -1)
    share = free_share(approach[None], b, u, free)
    torch.testing.assert_close(share[0], torch.tensor([1.0, 0.5, 0.75, 0.0, 0.0]).double())


def test_average_precision_against_hand_made_curves():
    score = np.array([4.0, 3.0, 2.0, 1.0])
    assert average_precision(score, np.array([1.0, 1.0, 0.0, 0.0])) == pytest.approx(1.0)
    assert average_precision(score, np.array([0.0, 1.0, 0.0, 1.0])) == pytest.approx(0.5)
    assert average_precision(np.ones(4), np.array([0.0, 1.0, 0.0, 0.0])) == pytest.approx(0.25)
