"""Degradations: each changes its own thing, all together change everything."""

import pytest

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.checks import check_scenario
from feasigrasp.scenario.files import dump_scenario, load_scenario
from feasigrasp_lab.protocols.degradations import DEGRADATIONS

FILE = diagram_path("dynamic.scenarios.yaml")


def degraded(name, seed=0, model="mug"):
    text = f"{{random_seed: {seed}, object: {{model: {model}}}}}"
    scenario = load_scenario(FILE, "ReachCircularMocap", text)
    DEGRADATIONS[name](scenario)
    check_scenario(scenario)
    return scenario


@pytest.mark.parametrize("name", [name for name in DEGRADATIONS if name != "none"])
def test_each_is_another_scenario_than_perfect_sensors(name):
    perfect = degraded("none")
    assert perfect.camera_noise == {} and perfect.perception.latency == 0.0
    changed = set(dump_scenario(degraded(name)).splitlines())
    assert changed != set(dump_scenario(perfect).splitlines())


def test_no_two_are_the_same():
    assert len({dump_scenario(degraded(name)) for name in DEGRADATIONS}) == len(DEGRADATIONS)


def test_all_together_are_drawn_from_their_ranges_by_seed_and_object():
    drawn = [degraded("all", seed) for seed in range(40)]
    for scenario in drawn:
        assert 0.0 <= scenario.perception.latency <= 1.0
        assert 0.3 <= scenario.object.friction <= 0.8
        assert 0.5 <= scenario.object.mass_factor <= 2.0
        assert scenario.camera_noise and scenario.tracker.latency > 0.0
        assert len(scenario.faults) == 3
    factors = [scenario.object.mass_factor for scenario in drawn]
    assert min(factors) < 0.8 and max(factors) > 1.4
    assert dump_scenario(degraded("all", 7)) == dump_scenario(drawn[7])
    # A study of one seed and many objects draws as many times.
    latencies = {degraded("all", 0, model).perception.latency for model in ("mug", "box", "drill")}
    assert len(latencies) == 3
