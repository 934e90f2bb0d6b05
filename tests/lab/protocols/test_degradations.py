"""Degradations: each changes its own thing, all together change everything."""

import pytest

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.checks import check_scenario
from feasigrasp.scenario.files import dump_scenario, load_scenario
from feasigrasp_lab.protocols.changes import DEGRADATIONS

FILE = diagram_path("dynamic.scenarios.yaml")


def degraded(name, seed=0, model="mug"):
    text = f"{{random_seed: {seed}, object: {{model: {model}}}}}"
    scenario = load_scenario(FILE, "ReachCircular", text)
    DEGRADATIONS[name](scenario)
    check_scenario(scenario)
    return scenario


def changed_keys(name):
    plain = dump_scenario(degraded("none")).splitlines()
    return sorted({*dump_scenario(degraded(name)).splitlines()} - {*plain})


@pytest.mark.parametrize(
    ("name", "keys"),
    {
        "none": [],
        "latency-0": ["output_delay: 0.0"],
        "latency-0.12": ["output_delay: 0.12"],
        "errors-2": ["error_factor: 2.0"],
        "smear": ["smear: 3.0"],
        "hand-eye": ["hand_eye_angle_deg: 1.0", "hand_eye_position: 0.005"],
        "carrier-soft": ["stiffness: soft"],
        "carrier-rigid": ["stiffness: rigid"],
        "friction-0.3": ["friction: 0.3"],
        "friction-0.8": ["friction: 0.8"],
        "mass-0.5": ["mass_factor: 0.5"],
        "mass-2": ["mass_factor: 2.0"],
    }.items(),
)
def test_each_changes_its_own_keys(name, keys):
    assert [line.strip() for line in changed_keys(name)] == keys


def test_no_two_are_the_same():
    assert len({dump_scenario(degraded(name)) for name in DEGRADATIONS}) == len(DEGRADATIONS)


def test_all_together_are_drawn_from_their_ranges_by_seed_and_object():
    drawn = [degraded("all", seed) for seed in range(40)]
    delays = [scenario.cameras["wrist_camera"].output_delay for scenario in drawn]
    assert 0.0 <= min(delays) < 0.03 and 0.09 < max(delays) <= 0.12
    for scenario in drawn:
        assert 0.3 <= scenario.object.friction <= 0.8
        assert 0.5 <= scenario.object.mass_factor <= 2.0
        assert scenario.sensors.error_factor == 2.0
        assert scenario.camera_noise["wrist_camera"]["hand_eye_position"] == 0.005
    factors = [scenario.object.mass_factor for scenario in drawn]
    assert min(factors) < 0.8 and max(factors) > 1.4
    assert dump_scenario(degraded("all", 7)) == dump_scenario(drawn[7])
    # A study of one seed and many objects draws as many times.
    drawn = [degraded("all", 0, model) for model in ("mug", "box", "drill")]
    assert len({scenario.object.friction for scenario in drawn}) == 3
