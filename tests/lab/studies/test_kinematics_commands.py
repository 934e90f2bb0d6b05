"""``feasigrasp evaluate kinematics`` and ``feasigrasp bench kinematics``."""

import argparse
import json

import numpy as np
import pytest

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.bench import kinematics as bench
from feasigrasp_lab.peers import DrakeArm
from feasigrasp_lab.results import timing
from feasigrasp_lab.studies import kinematics as evaluate


def value(rows, name, preset="default"):
    (row,) = (row for row in rows if (row.name, row.preset) == (name, preset))
    return row.value


def arguments(module, folder):
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    return parser.parse_args(["--quick", "--out", str(folder)])


def test_forward_kinematics_equal_drake(tmp_path):
    rows = evaluate.forward_rows(200, 0, tmp_path)
    assert value(rows, "kinematics.fk_error_max") < 1e-12
    assert value(rows, "kinematics.jacobian_error_max") < 1e-12
    assert len((tmp_path / "forward.csv").read_text().splitlines()) == 201


def test_an_error_of_forward_kinematics_is_seen(tmp_path, monkeypatch):
    def wrong(Q):
        X, J = DrakeArm().pose_and_jacobian(Q)
        X[7, 0, 3] += 3e-6
        J[9, 2, 4] -= 2e-5
        return X, J

    monkeypatch.setattr(evaluate, "pose_and_jacobian", wrong)
    rows = evaluate.forward_rows(20, 0, tmp_path)
    assert value(rows, "kinematics.fk_error_max") == pytest.approx(3e-6)
    assert value(rows, "kinematics.jacobian_error_max") == pytest.approx(2e-5)


def test_inverse_kinematics_close_the_circle(tmp_path):
    rows = evaluate.inverse_rows(300, 0, tmp_path)
    assert value(rows, "kinematics.ik_residual_max") < 1e-9
    assert value(rows, "kinematics.ik_recovered_percent") == 100.0


def test_wrong_and_missing_solutions_are_seen(tmp_path, monkeypatch):
    right = evaluate.closed_form
    calls = []

    def wrong(X_WF, psi):
        calls.append(psi)
        solutions = right(X_WF, psi)
        if len(calls) == 2:  # the search of the first configuration for itself
            solutions[:, 0] += 1e-5
        return np.full_like(solutions, np.nan) if len(calls) == 4 else solutions

    monkeypatch.setattr(evaluate, "closed_form", wrong)
    rows = evaluate.inverse_rows(10, 0, tmp_path)
    assert value(rows, "kinematics.ik_recovered_percent") == 80.0
    calls.clear()
    monkeypatch.setattr(evaluate, "closed_form", lambda X, psi: right(X, psi) + 1e-4)
    rows = evaluate.inverse_rows(10, 0, tmp_path)
    assert 1e-5 < value(rows, "kinematics.ik_residual_max") < 1e-3


def test_verdicts_equal_drakes():
    rows = evaluate.collision_rows(500, 0)
    assert value(rows, "kinematics.collision_mismatches") == 0
    assert value(rows, "kinematics.collision_mismatches", "folded") == 0
    assert value(rows, "kinematics.collision_hits", "folded") > 50


def test_wrong_verdicts_are_seen(monkeypatch):
    right = evaluate.in_collision

    def wrong(Q, margin=0.0):
        verdicts = right(Q, margin=margin)
        if len(Q) == 100:
            verdicts[[3, 5]] ^= True
        return verdicts

    monkeypatch.setattr(evaluate, "in_collision", wrong)
    rows = evaluate.collision_rows(100, 0)
    assert value(rows, "kinematics.collision_mismatches") == 2


def test_folded_configurations_are_inside_limits_and_often_collide():
    Q = evaluate.folded_configurations(2000, np.random.default_rng(0))
    assert (np.abs(Q) <= IIWA_7.upper).all()
    assert 0.1 < evaluate.in_collision(Q).mean() < 0.4


def test_evaluate_writes_all_rows(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(evaluate, "inverse_rows", lambda n, seed, folder: [])
    monkeypatch.setattr(evaluate, "collision_rows", lambda n, seed: [])
    assert evaluate.main(arguments(evaluate, tmp_path)) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert "kinematics.fk_error_max" in {row["name"] for row in summary["rows"]}
    assert "fk_error_max" in capsys.readouterr().out


def test_bench_times_every_case(tmp_path, monkeypatch):
    monkeypatch.setattr(
        timing, "cpu_time", lambda f, s: (f(), timing.Timing(2e-6, 1e-6, 3e-6, 5))[1]
    )
    assert bench.main(arguments(bench, tmp_path)) == 0
    rows = json.loads((tmp_path / "summary.json").read_text())["rows"]
    found = {(row["name"], row["preset"]): row for row in rows}
    for name in ("bench.fk_jacobian_us.100", "bench.self_collision_us"):
        assert {(name, "default"), (name, "peer:drake")} <= set(found)
    assert found["bench.fk_jacobian_us.100", "default"]["value"] == pytest.approx(2.0)
    per_configuration = found["bench.self_collision_us", "default"]["value"]
    assert per_configuration == pytest.approx(2.0 / 4096)
    assert found["bench.ik_100x16_ms", "default"]["low"] == pytest.approx(1e-3)
    assert len((tmp_path / "timings.csv").read_text().splitlines()) == 1 + len(rows)


def test_processor_time_of_one_call(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(timing.time, "process_time", lambda: clock[0])

    def call():
        clock[0] += 3e-4

    measured = timing.cpu_time(call, seconds=0.1)
    assert measured.value == pytest.approx(3e-4)
    assert measured.low <= measured.value <= measured.high
    assert measured.n >= 5
