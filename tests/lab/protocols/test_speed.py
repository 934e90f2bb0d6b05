"""Speeds of the studies against the motions that come of them."""

import numpy as np
import pytest

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion
from feasigrasp_lab.protocols.changes import (
    AT_SPEEDS,
    AT_SPINS,
    MOTIONS,
    SPEEDS,
    SPINS,
    at_speed,
    curve_point,
)

FILE = diagram_path("dynamic.scenarios.yaml")
TIMES = np.linspace(0.0, 40.0, 4001)


def speeds_of(scenario):
    motion = make_motion(scenario)
    return np.array([np.linalg.norm(motion.velocity(t)[3:]) for t in TIMES])


@pytest.mark.parametrize("name", MOTIONS.values())
@pytest.mark.parametrize("speed", [SPEEDS[0], SPEEDS[-1]])
def test_the_largest_speed_is_the_one_asked_for(name, speed):
    scenario = load_scenario(FILE, name)
    at_speed(speed)(scenario)
    speeds = speeds_of(scenario)
    assert speeds.max() == pytest.approx(speed, rel=5e-3)
    if name == "ReachCircularMocap":
        assert speeds.min() == pytest.approx(speed, rel=1e-6)


@pytest.mark.parametrize(("spin", "change"), [*zip(SPINS, AT_SPINS.values(), strict=True)])
def test_the_object_turns_as_fast_as_asked_for(spin, change):
    scenario = load_scenario(FILE, "ReachCircularMocap")
    change(scenario)
    V = make_motion(scenario).velocity(1.0)
    np.testing.assert_allclose(np.linalg.norm(V.reshape(2, 3), axis=1), [spin, 0.15])


def test_runs_are_points_of_curves():
    ends = list(AT_SPEEDS), list(AT_SPINS)
    assert curve_point(f"ReachCircularMocap{ends[0][1]}") == "circle/0.15"
    assert curve_point(f"ReachBezierMocap{ends[0][4]}") == "bezier/0.6"
    assert curve_point(f"ReachBezier{ends[0][4]}") == "bezier-camera/0.6"
    assert curve_point(f"ReachCircularMocap{ends[1][1]}") == "spin/0.5"
    assert (
        curve_point("ReachCircularMocap") is None and curve_point("ReachLinearMocap-ideal") is None
    )
