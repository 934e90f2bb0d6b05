"""What a mode means for the keys that a scenario leaves open."""

import pytest

from feasigrasp.errors import ScenarioError
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.presets import PRESETS, resolve
from feasigrasp.scenario.schema import Scenario

FILE = diagram_path("dynamic.scenarios.yaml")


def value(scenario, key):
    section, name = key.split(".")
    return getattr(getattr(scenario, section), name)


def load(control, more=""):
    return load_scenario(FILE, "PaperLinear", f"{{control: {{{control}}}{more}}}")


def test_every_key_of_the_table_is_open_until_it_is_resolved():
    """And no other key is: nothing that is None stays None."""
    scenario = Scenario()
    resolved = resolve(scenario)
    again = resolve(resolved)
    for section in ("perception", "reachability", "control"):
        for name, entry in vars(getattr(scenario, section)).items():
            assert (entry is None) == (f"{section}.{name}" in PRESETS), (section, name)
            assert value(resolved, f"{section}.{name}") is not None
            assert value(again, f"{section}.{name}") == value(resolved, f"{section}.{name}")


@pytest.mark.parametrize("mode", ["safe", "corrected", "paper"])
@pytest.mark.parametrize("controller", ["task", "joint"])
def test_what_is_written_says_what_was_in_force(mode, controller):
    scenario = load(f"mode: {mode}, controller: {controller}")
    text = dump_scenario(scenario)
    again = parse_scenario(text)
    for key in PRESETS:
        assert value(again, key) == value(scenario, key)
        assert f"  {key.split('.')[1]}: " in text


def test_corrected_differs_from_safe_in_nothing_but_what_is_enforced():
    safe, corrected = load("mode: safe"), load("mode: corrected")
    assert {value(safe, key) == value(corrected, key) for key in PRESETS} == {True}
    assert safe.control.safe and not corrected.control.safe


def test_paper_is_the_papers():
    """Section IV of the paper, and its formulas as printed."""
    task, joint = load("mode: paper"), load("mode: paper, controller: joint")
    assert not task.control.safe
    assert (task.control.law, task.control.targets) == ("gradient", "means")
    assert (task.control.feed_forward, task.control.damping) == (False, 0.0)
    assert (joint.control.gain, joint.control.length_scale) == (1.0, 0.3)
    assert (joint.control.source, joint.control.n_solutions) == ("flow", 100)
    assert joint.control.resample
    assert (task.perception.preset, task.perception.sampler) == ("paper", "paper")
    assert (task.perception.views, task.perception.latency) == (1, 0.0)
    assert (task.reachability.method, task.reachability.space) == ("rmm", "paper")
    assert (task.reachability.twins, task.reachability.horizon) == (False, 0.0)


def test_a_key_that_is_given_wins():
    given = load("mode: paper, feed_forward: true, gain: 0.7", ", perception: {latency: 0.2}")
    assert (given.control.feed_forward, given.control.gain) == (True, 0.7)
    assert (given.perception.latency, given.control.law) == (0.2, "gradient")
    # Whichever text comes first.
    late = load_scenario(
        FILE, "PaperLinear", "{control: {damping: 0.1}}", "{control: {mode: paper}}"
    )
    assert (late.control.damping, late.control.targets) == (0.1, "means")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{control: {law: newton}}", "control.law is 'newton'; .* preconditioned, gradient"),
        ("{control: {targets: modes}}", "control.targets is 'modes'; .* medoids, means"),
        ("{reachability: {space: large}}", "reachability.space is 'large'; .* default, paper"),
        ("{control: {gain: 0.0}}", "control.gain is 0;"),
        ("{control: {damping: -0.1}}", "control.damping is -0.1"),
        ("{control: {length_scale: .nan}}", "control.length_scale is nan"),
        ("{control: {n_solutions: 0}}", "control.n_solutions is 0"),
        ("{perception: {views: -1}}", "perception.views is -1"),
        ("{control: {resample: true}}", "control.resample .* closed_form .* flow or dls"),
        ("{control: {law: gradient}}", "control.law is gradient .*corrected or paper"),
        ("{control: {look_ahead: far}}", "control.look_ahead is 'far'; .* predicted, twist, none"),
        (
            "{control: {mode: corrected, density: false}}",
            "control.density is False, but only safe mode plans",
        ),
        (
            "{control: {mode: paper, look_ahead: none}}",
            "control.look_ahead is none, but only safe mode plans",
        ),
        ("{control: {controller: joint, density: false}}", "control.density .*controller: task"),
        ("{grasp: {standoff: 0.1}}", "grasp.standoff is 0.1 m, but grasp.close .*close: false"),
        (
            "{grasp: {standoff: 0.1, close: false}, control: {mode: corrected}}",
            "grasp.standoff is 0.1 m, .*mode: safe",
        ),
    ],
)
def test_wrong_values_are_refused(text, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario(FILE, "ReachLinearMocap", text)
