"""``feasigrasp bench safety``: the ticks are hard ones, and the judge sees what is broken."""

import argparse
import json

import numpy as np
import pytest

from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp_lab.bench import safety as bench
from feasigrasp_lab.bench.safety import solve_daqp, solvers
from feasigrasp_lab.measures.timing import cpu_time
from feasigrasp_lab.peers import safety_laws as laws

OPTIONS = SafetyOptions()


@pytest.fixture(scope="module")
def safety():
    return SafetyFilter(OPTIONS)


@pytest.fixture(scope="module")
def states(safety):
    return bench.ticks(30, 1, safety)


def test_half_of_the_ticks_have_a_clearance_in_the_way(states):
    assert len(states) == 30
    assert sum(len(s.rows) > 0 for s in states) == 15


def test_the_package_breaks_nothing_and_a_pseudo_inverse_does(states, safety):
    outcome = bench.judge(states, [laws.package(safety)(s) for s in states], safety)
    for kind in bench.KINDS:
        assert outcome[kind].max() < 1e-9
    free = bench.judge(states, [np.linalg.pinv(s.J) @ s.V for s in states], safety)
    assert (free["acceleration"] > bench.TOLERANCE).any()
    assert (free["clearance"] > bench.TOLERANCE).any()
    assert np.median(free["error"]) < 1e-9 < np.median(outcome["error"])


def test_a_broken_limit_and_a_missing_answer_are_seen(states, safety):
    commands = [s.qd_last for s in states]
    commands[0] = safety.problem(states[0].q, np.zeros(7))[1][1, :7] + 0.5
    commands[1] = None
    outcome = bench.judge(states, commands, safety)
    assert outcome["limits"][0] == pytest.approx(0.5)
    assert np.isnan(outcome["error"][1])
    rows = {row.name: row.value for row in bench.rows_of("x", "default", outcome)}
    assert rows["x_no_answer_percent"] == pytest.approx(100 / 30)
    assert rows["x_limits_broken_percent"] >= 100 / 29


def test_all_solvers_agree_with_each_other_and_with_the_package(states, safety):
    found = {
        name: np.array([bench.solve_law(solver, OPTIONS)(s) for s in states])
        for name, solver in solvers().items()
    }
    ours = np.array([laws.package(safety)(s) for s in states])
    for solutions in found.values():
        np.testing.assert_allclose(solutions, ours, atol=2e-3)
    np.testing.assert_allclose(found["default"], ours, atol=1e-9)


def test_daqp_says_when_there_is_no_solution():
    A, bound = np.array([[1.0, 0, 0, 0, 0, 0, 0]]), np.ones(7)
    lower, upper = np.append(-bound, 2.0), np.append(bound, 1e30)
    assert solve_daqp(np.eye(7), np.zeros(7), A, lower, upper) is None


def test_saturation_in_the_null_space_keeps_bounds_and_follows_what_it_can(states):
    for s in states:
        qd = laws.saturation_in_the_null_space(s)
        assert (s.lower[:7] <= qd).all() and (qd <= s.upper[:7]).all()
        wide = laws.State(
            s.q, s.qd_last, s.J, s.V, s.qd_preferred, s.lower - 99, s.upper + 99, s.rows
        )
        if np.linalg.cond(s.J) < 50:
            qd = laws.saturation_in_the_null_space(wide)
            np.testing.assert_allclose(s.J @ qd, s.V, atol=1e-9)


def test_drake_follows_a_twist_where_nothing_is_in_the_way(safety):
    """At home at rest with a small twist: Drake's ways and ours agree on what the hand does."""
    q, J = bench.HOME, bench.pose_and_jacobian(bench.HOME)[1]
    V = np.array([0.01, 0.0, -0.01, 0.005, 0.005, 0.0])
    lower, upper = safety.problem(q, np.zeros(7), qd_last=np.zeros(7))[1][:2, :7]
    s = laws.State(q, np.zeros(7), J, V, np.zeros(7), lower, upper, np.empty((0, 7)))
    for law in (laws.drake_function(OPTIONS), laws.drake_system(OPTIONS)):
        np.testing.assert_allclose(J @ law(s), V, atol=1e-4)


def test_the_command_writes_its_files(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(bench, "QUICK_TICKS", 12)
    monkeypatch.setattr(bench, "cpu_time", lambda function, seconds: cpu_time(function, 0.01))
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    assert bench.main(parser.parse_args(["--quick", "--out", str(tmp_path)])) == 0
    rows = json.loads((tmp_path / "summary.json").read_text())["rows"]
    ours = {row["name"]: row["value"] for row in rows if row["preset"] == "default"}
    assert ours["bench.safety_us"] > 0 and ours["bench.safety_clearance_broken_percent"] == 0
    presets = {row["preset"] for row in rows}
    assert {"peer:drake-system", "peer:saturation-in-null-space", "peer:drake-osqp"} <= presets
    timed = sum(row["name"].endswith("_us") for row in rows)
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) == 1 + 12 * timed
    assert "Polishing" not in capfd.readouterr().out
