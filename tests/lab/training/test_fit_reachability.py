"""The commands about the reachable space: fit, evaluate, draw."""

import argparse
import csv
import json
from pathlib import Path

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.results.statistics import area_under_curve
from feasigrasp_lab.training.fit_reachability import (
    component_counts,
    manipulability_reference,
    sample_reachable_poses,
)

FIT = ["fit", "reachability", "--samples", "30000"]


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("fit")
    assert cli.main([*FIT, "--out", str(out), "--components", "4,12"]) == 0
    return out


def test_fit_leaves_spaces_and_the_bic_curve(fitted):
    spaces = [ReachableSpace.load(fitted / f"reachable_space_{k}.npz") for k in (4, 12)]
    assert [len(space.mixture) for space in spaces] == [4, 12]
    counts = spaces[1].metadata["counts"]
    assert counts["drawn"] == 30_000
    assert counts["fitted"] + counts["held_out"] == counts["reached"]
    assert "--components 4,12" in spaces[1].metadata["command"]
    with (fitted / "bic.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["components"]) for row in rows] == [4, 12]
    assert float(rows[1]["bic"]) < float(rows[0]["bic"])
    summary = json.loads((fitted / "summary.json").read_text())
    names = [row["name"] for row in summary["rows"]]
    assert names.count("reachability.bic") == 2
    last = ReachableSpace.load(fitted / "reachable_space.npz")
    np.testing.assert_array_equal(last.mixture.means, spaces[1].mixture.means)


def test_bic_is_that_of_the_poses(fitted):
    space = ReachableSpace.load(fitted / "reachable_space_12.npz")
    rng, thin = np.random.default_rng(0), manipulability_reference()
    X, _ = sample_reachable_poses(30_000, rng, thin=thin)
    n = space.metadata["counts"]["fitted"]
    with (fitted / "bic.csv").open() as file:
        bic = float(list(csv.DictReader(file))[1]["bic"])
    # All poses stand for those that were fitted.
    expected = (28 * 12 - 1) * np.log(n) - 2 * n * space.mixture.log_density(X).mean()
    np.testing.assert_allclose(bic, expected, rtol=5e-3)


def test_a_finished_fit_is_not_done_again(fitted, monkeypatch):
    def fail(*args, **options):
        raise AssertionError("fitted again")

    monkeypatch.setattr("feasigrasp_lab.training.fit_reachability._fit", fail)
    assert cli.main([*FIT, "--out", str(fitted), "--components", "4,12"]) == 0


def test_a_folder_of_other_settings_is_refused(fitted, capsys):
    assert cli.main([*FIT, "--out", str(fitted), "--seed", "5"]) == 2
    assert "other settings" in capsys.readouterr().err


def test_evaluation_reports_every_judge(fitted, tmp_path):
    command = ["evaluate", "reachability", "--out", str(tmp_path), "--poses", "400"]
    assert cli.main([*command, "--file", str(fitted / "reachable_space.npz")]) == 0
    rows = json.loads((tmp_path / "summary.json").read_text())["rows"]
    auc = {(row["name"], row["preset"]): row for row in rows if ".auc." in row["name"]}
    assert auc["reachability.auc.rmm", "default"]["value"] > 0.8
    assert set(auc) == {
        ("reachability.auc.rmm", "default"),
        ("reachability.auc.rmm", "paper"),
    }
    figures = {row["name"] for row in rows if row["preset"] == "rmm"}
    assert figures == {
        f"reachability.{name}"
        for name in ("accuracy", "precision", "recall", "false_positive_percent")
    }
    with (tmp_path / "poses.csv").open() as file:
        poses = list(csv.DictReader(file))
    assert len(poses) == 400
    row = auc["reachability.auc.rmm", "default"]
    score = np.array([float(pose["rmm"]) for pose in poses])
    truth = np.array([pose["reachable"] == "1" for pose in poses])
    np.testing.assert_allclose(area_under_curve(score, truth).value, row["value"], atol=1e-3)


def test_too_few_samples_are_named(tmp_path, capsys):
    arguments = ["--out", str(tmp_path), "--samples", "100"]
    assert cli.main(["fit", "reachability", *arguments]) == 2
    assert "raise --samples" in capsys.readouterr().err


def test_numbers_of_components():
    assert component_counts("8,16") == [8, 16]
    with pytest.raises(argparse.ArgumentTypeError, match="less than 1"):
        component_counts("0")
    with pytest.raises(ValueError, match="none"):
        component_counts("8,none")
