"""The length-scale study and the figures of the distance field: sums, curves, files."""

import csv
import json

import numpy as np
import pytest

from feasigrasp.cli import main
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp_lab.studies import length_scale as study_length_scale
from feasigrasp_lab.studies.figures import shape_figures
from feasigrasp_lab.studies.length_scale import curves, summary_rows
from feasigrasp_lab.training.data.views import ViewedObject


def record(name, view, preset, length_scale, value):
    measured = {key: value for key in study_length_scale.MEASURES}
    return {"object": name, "view": view, "preset": preset, "length_scale": length_scale} | measured


def test_objects_not_views_are_the_repeats():
    """Means 2 and 5 of two objects: 3.5, and the interval of these two figures."""
    records = [record("a", view, "paper", 0.3, value) for view, value in enumerate([1.0, 2.0, 3.0])]
    records += [record("b", 0, "paper", 0.3, 5.0), record("b", 1, "paper", 0.3, None)]
    row = summary_rows(records)[0]
    assert (row.name, row.preset, row.n) == ("length_scale.true_to_completed_mm", "paper/0.3", 2)
    assert row.value == pytest.approx(3.5)
    assert row.high == pytest.approx(3.5 + 12.7062 * 1.5, abs=1e-3)  # Student's t, one degree


def test_curves_are_in_the_order_of_the_length_scale():
    records = [record("a", 0, "paper", scale, 1.0) for scale in (0.6, 0.02, 0.3, 0.1)]
    found = curves(summary_rows(records))["seen_mm", "paper"]
    assert [length_scale for length_scale, _ in found] == [0.02, 0.1, 0.3, 0.6]


def test_the_command_writes_curve_and_summary_and_resumes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study_length_scale, "QUICK_LENGTH_SCALES", (0.03, 0.3))
    arguments = ["evaluate", "length-scale", "--quick", "--objects", "ball", "--jobs", "1"]
    arguments += ["--out", str(tmp_path)]
    assert main(arguments) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    value = {(row["name"], row["preset"]): row["value"] for row in summary["rows"]}
    assert len(value) == 3 * 2 * 2
    # Smaller length scales leave the unseen side out.
    for preset in ("paper", "default"):
        small, large = (value["length_scale.unseen_mm", f"{preset}/{x}"] for x in (0.03, 0.3))
        assert large < small
    with (tmp_path / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(r["preset"], float(r["length_scale_m"])) for r in rows} == {
        (preset, scale) for preset in ("paper", "default") for scale in (0.03, 0.3)
    }
    assert (tmp_path / "curve.png").stat().st_size > 10_000
    assert "l [m]" in capsys.readouterr().out

    monkeypatch.setattr(study_length_scale, "study_object", None)  # would fail if it were called
    assert main(arguments) == 0
    assert json.loads((tmp_path / "summary.json").read_text())["rows"] == summary["rows"]


def test_the_slice_is_right_on_the_seen_side_and_refinement_makes_metres_of_it():
    viewed = ViewedObject(load_object("ball"))
    views = shape_figures.look_round(viewed, np.random.default_rng(0))
    curve = shape_figures.slice_through(viewed, shape_figures.fit_views(views[:1]), views[0])
    radius = load_object("ball").extents.min() / 2
    # The true distance along a line through the middle of a ball.
    np.testing.assert_allclose(curve["true"], np.abs(curve["x"]) - radius, atol=0.15 * radius)
    rows = {row.name: row.value for row in shape_figures.slice_rows({"one": curve})}
    name = "shape_figures.slice_{}_error_mm.before"
    assert rows[name.format("refined")] < 1.5
    assert rows[name.format("raw")] > 3 * rows[name.format("refined")]


def test_the_figures_command_draws_pictures(tmp_path):
    arguments = ["evaluate", "shape-figures", "--quick", "--objects", "ball"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    for name in ("slice.png", "uncertainty.png"):
        assert 10_000 < (tmp_path / name).stat().st_size < 250_000
    with (tmp_path / "slice.csv").open() as file:
        presets = {row["preset"] for row in csv.DictReader(file)}
    assert presets == set(shape_figures.SLICES)
