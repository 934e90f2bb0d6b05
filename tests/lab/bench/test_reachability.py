"""The rows that the command writes, from a small run."""

import argparse
import json

import numpy as np

from feasigrasp.models.reach.reachability import Reachability
from feasigrasp_lab.bench import reachability as bench_reachability


def test_about_half_of_the_grasps_can_be_reached():
    X_WG = bench_reachability.X_WO @ bench_reachability.random_grasps(0).X_OG
    assert X_WG.shape == (1024, 4, 4)
    assert 0.4 < np.mean(Reachability().reachable(X_WG)) < 0.7


def test_rows_of_a_small_run(tmp_path):
    parser = argparse.ArgumentParser()
    bench_reachability.add_arguments(parser)
    args = parser.parse_args(["--quick", "--out", str(tmp_path), "--seed", "3"])
    assert bench_reachability.main(args) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    rows = {(row["name"], row["preset"]): row for row in summary["rows"]}
    names = [f"bench.reachability_filter_ms.{method}" for method in ("ik", "rmm", "both")]
    expected = {(name, preset) for name in names for preset in ("default", "whole filter")}
    assert set(rows) == expected
    assert all(0.0 < row["low"] <= row["value"] <= row["high"] for row in rows.values())
    words = summary["command"].split()
    assert words[:3] == ["feasigrasp", "bench", "reachability"] and words[-1] == "--quick"
    assert words[words.index("--seed") + 1] == "3"
    assert len((tmp_path / "timings.csv").read_text().splitlines()) == 1 + len(rows)
