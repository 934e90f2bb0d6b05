"""Whole runs in the full diagram: one that holds its object, and ones that cannot."""

import numpy as np
import pytest

from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.resources import diagram_path
from feasigrasp.runs.run import run
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.metrics import SAMPLE_NAMES

FILE = diagram_path("dynamic.scenarios.yaml")


def whole_run(friction):
    text = f"{{random_seed: 1, object: {{model: soup_can, friction: {friction}}}}}"
    return run(load_scenario(FILE, "ReachLinearMocap", text), "ReachLinearMocap")


@pytest.fixture(scope="module")
def held():
    return whole_run(0.6)


def test_an_object_is_followed_grasped_lifted_shaken_and_held(held):
    metrics = held.record["metrics"]
    assert held.record["error"] is None
    assert metrics["grasp_held"] is True and metrics["cause"] is None
    x = dict(zip(SAMPLE_NAMES, held.samples, strict=True))
    assert set(x["phase"]) == set(map(float, Phase))
    assert x["phase"][-1] == Phase.DONE
    assert metrics["pushed_mm"] < 0.5 and metrics["pushed_deg"] < 0.5
    assert metrics["contact_force_peak_n"] == metrics["contact_time_percent"] == 0.0
    assert metrics["slip_mm"] < 10.0 and metrics["turn_deg"] < 15.0
    assert metrics["lift_cm"] == pytest.approx(10.0, abs=1.0)


def test_it_is_held_by_where_it_is_too(held):
    """By where the object is, not by what the sequencer says."""
    height = held.samples[SAMPLE_NAMES.index("p_WO_z")]
    last = height[-int(1.0 / 0.02) :]
    assert last.min() > height[0] + 0.05  # it was let go of two seconds ago
    assert np.ptp(last) < 0.01


def test_the_shake_shakes_the_object(held):
    """It goes to and fro in the world, by about the amplitude that the arm is asked for."""
    x = dict(zip(SAMPLE_NAMES, held.samples, strict=True))
    p_WO = np.array([x[f"p_WO_{axis}"] for axis in "xyz"]).T
    shaken, kept = (p_WO[x["phase"] == phase] for phase in (Phase.SHAKE, Phase.HOLD))
    assert np.all(np.ptp(shaken, axis=0) > 0.015)  # from -1 cm to 1 cm along every axis
    assert np.all(np.ptp(shaken, axis=0) < 0.045)
    assert np.all(np.ptp(kept[len(kept) // 2 :], axis=0) < 0.004)  # it rings down


def test_grasps_are_as_old_as_views_and_holds_make_them(held):
    """A view every 0.5 s, 0.1 s of latency, and up to 0.1 s until the controller reads them."""
    x = dict(zip(SAMPLE_NAMES, held.samples, strict=True))
    first = np.flatnonzero(x["reachable_grasps"] > 0)[0]
    assert held.times[first] == pytest.approx(0.22) == x["view_age"][first]
    early = (held.times > 0.21) & (held.times < 1.09)  # before it has seen enough of a side
    assert 0.5 < x["view_age"][early].max() < 0.71
    newer = held.times[early][1:][np.diff(x["view_age"][early]) < 0.0]
    assert len(newer) == 1 and 0.6 < newer[0] < 0.73
    metrics = held.record["metrics"]
    assert 0.2 < metrics["grasp_age_s_mean"] < metrics["grasp_age_s_max"] < 6.0


def test_an_object_too_slippery_to_hold_is_not_held():
    slippery = whole_run(0.01).record
    metrics = slippery["metrics"]
    assert slippery["error"] is None
    assert metrics["grasp_held"] is False
    assert metrics["cause"] in ("dropped", "missed", "slipped")  # or is squeezed out
    assert metrics["friction"] < 0.03
