"""The fit of the certainties: coefficients that were put in come out, and the command runs."""

import json

import numpy as np
import pytest

from feasigrasp.cli import main
from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.success_probability import probability
from feasigrasp_lab.training.data.held_out_objects import held_out_objects
from feasigrasp_lab.training.fit_certainty import FIRST_SEED, NAMES, fit, shape_names, stages


def test_coefficients_that_made_the_verdicts_are_found():
    rng = np.random.default_rng(0)
    evidence = np.column_stack([rng.uniform(0.0, 1.0, 40000), rng.uniform(0.0, 0.02, 40000)])
    truth = (2.0, -3.0, -120.0)
    verdict = rng.random(40000) < probability(truth, *evidence.T)
    found, loss = fit(evidence, verdict)
    assert found == pytest.approx(truth, rel=0.1)
    p = probability(truth, *evidence.T)
    assert loss == pytest.approx(-np.mean(np.log(np.where(verdict, p, 1.0 - p))), rel=0.01)


def test_no_evaluation_uses_its_shapes():
    ours = {f"{family}_{number}" for family, number in shape_names(200, 3)}
    assert len(ours) == 200
    assert not ours & set(held_out_objects("held-out", 1000, 0))
    assert min(number for _, number in shape_names(200, 0)) == FIRST_SEED


def test_a_stage_without_cases_asks_for_more_objects():
    cases = {name: (np.zeros((0, 1)), np.zeros(0, dtype=bool)) for name in NAMES}
    with pytest.raises(GraspError, match="CONTACT; give more --objects"):
        next(stages(cases))


def test_the_command_fits_every_stage(tmp_path, capsys):
    assert main(["fit", "certainty", "--objects", "10", "--jobs", "1", "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "certainty.json").read_text())
    printed = capsys.readouterr().out
    for name in NAMES:
        assert f"{name} = (" in printed
        assert written[name]["n"] > 0
        assert np.isfinite(written[name]["coefficients"]).all()
    assert written["CLEARANCE"]["coefficients"][1] > 0.0, "more room is better"
