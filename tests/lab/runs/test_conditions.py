"""Conditions of a table against the scenarios they are read from."""

import json
import math

import pytest

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp_lab.runs.plan import Plan, PlannedRun
from feasigrasp_lab.runs.run_plan import conditions, conditions_text


def planned(name, text="{}", model="duck"):
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), name, text)
    return PlannedRun(name, model, scenario)


def test_speeds_are_those_of_the_motion():
    """Circle of radius 0.12 m, line of half-length 0.18 m, at 2 pi / 10 s."""
    rate = "{motion: {rate: 0.6283185307179586, spin: 0.2}}"
    runs = [planned(name, rate) for name in ("ReachCircularMocap", "ReachLinearMocap")]
    speeds = conditions(Plan(runs), "development")["speeds"]
    omega = 2 * math.pi / 10
    assert speeds["ReachCircularMocap"]["path_m_s"] == pytest.approx(0.12 * omega, abs=1e-4)
    assert speeds["ReachLinearMocap"]["path_m_s"] == pytest.approx(0.18 * omega, abs=1e-4)
    assert speeds["ReachLinearMocap"]["spin_rad_s"] == 0.2
    still = conditions(Plan([planned("ReachLinearMocap", "{motion: {rate: 0.0}}")]), "test")
    assert still["speeds"]["ReachLinearMocap"]["path_m_s"] == 0.0


def test_entries_follow_the_scenarios():
    noisy = "{camera_noise: {wrist_camera: {flying: 0.1}}, perception: {latency: 0.2}}"
    tracked = "{tracker: {latency: 0.05, position_noise: 0.002, period: 0.01}, random_seed: 7}"
    runs = [
        planned("ReachLinearMocap", "{object: {friction: 0.4}, perception: {latency: 0.0}}", "mug"),
        planned("ReachLinearMocap", noisy, "cup"),
        planned("ReachLinearMocap", tracked, "cup"),
    ]
    runs[0].scenario.camera_noise = {}
    first = conditions(Plan(runs[:1]), "development")
    assert first["camera"] == "wrist_camera, 424 x 240, without noise"
    assert first["tracking"] == "true pose, 200 Hz, no latency"
    assert (first["friction"], first["perception_latency_s"]) == (0.4, 0.0)
    second = conditions(Plan(runs[1:2]), "development")
    assert (
        second["camera"] == "wrist_camera, 424 x 240, noise of a D435 with decimation 2, flying 0.1"
    )
    assert second["friction"] == "0.5 to 0.7"
    plain = planned("ReachLinearMocap", "{camera_noise: {wrist_camera: {}}}")
    plain.scenario.camera_noise = {"wrist_camera": {}}
    third = conditions(Plan([plain]), "development")
    assert third["camera"] == "wrist_camera, 424 x 240, noise of a D435"
    camera = conditions(Plan([planned("ReachLinearMocap", "{tracker: {kind: camera}}")]), "test")
    assert camera["tracking"] == "in the camera's depth images, 30 Hz"
    assert camera["object_frame"] == "that of the first view"
    everything = conditions(Plan(runs, {"vase": "has a hole"}), "test")
    assert everything["objects"] == ["mug", "cup"] and everything["seeds"] == [0, 7]
    assert everything["tracking"] == [
        "true pose, 200 Hz, no latency",
        "measured pose, 100 Hz, 0.05 s late, noise 0.002 m, 0 rad, 0% lost",
    ]
    assert json.loads(json.dumps(everything)) == everything
    text = conditions_text(everything)
    for part in ("test split", "friction 0.4 or ", "2 objects: mug, cup", "seeds 0, 7",
                 "left out: vase (has a hole)", "or 0.2 s"):  # fmt: skip
        assert part in text
    assert "no object left out" in conditions_text(first) and "1 object: mug" in conditions_text(
        first
    )


def test_seeds_are_drawn_together():
    runs = [planned("ReachLinearMocap", f"{{random_seed: {seed}}}") for seed in (2, 0, 1, 9)]
    assert "seeds 0 to 2, 9;" in conditions_text(conditions(Plan(runs), "development"))
