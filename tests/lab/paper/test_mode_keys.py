"""What the modes of the paper mean for the keys that a scenario leaves open."""

import pytest
import yaml

from feasigrasp.errors import FeasigraspError, ScenarioError
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp_lab.paper.judge import no_judge

FILE = diagram_path("dynamic.scenarios.yaml")


def load(control, more=""):
    return load_scenario(FILE, "PaperLinear", f"{{control: {{{control}}}{more}}}")


@pytest.mark.parametrize("mode", ["safe", "corrected", "paper"])
@pytest.mark.parametrize("controller", ["task", "joint"])
def test_what_is_written_says_what_was_in_force(mode, controller):
    scenario = load(f"mode: {mode}, controller: {controller}")
    text = dump_scenario(scenario)
    assert parse_scenario(text) == scenario or dump_scenario(parse_scenario(text)) == text
    written = yaml.load(text, Loader=yaml.BaseLoader)["control"]["options"]
    assert set(written) == set(scenario.control.options)
    assert len(written) == (8 if mode == "paper" else 0)


def test_corrected_differs_from_safe_in_nothing_but_what_is_enforced():
    safe, corrected = load("mode: safe"), load("mode: corrected")
    assert safe.control.safe and not corrected.control.safe
    corrected.control.mode = "safe"
    assert dump_scenario(corrected) == dump_scenario(safe)


def test_paper_is_the_papers():
    """Section IV of the paper, and its formulas as printed."""
    scenario = load("mode: paper, controller: joint")
    control = scenario.control
    assert not control.safe
    assert control.options == {
        "law": "gradient",
        "feed_forward": False,
        "source": "flow",
        "n_solutions": 100,
        "targets": "means",
        "damping": 0.0,
        "length_scale": 0.3,
        "resample": True,
    }
    perception, reachability = scenario.perception, scenario.reachability
    assert (perception.preset, perception.sampler) == ("paper", "paper")
    assert (perception.views, perception.latency) == (1, 0.0)
    assert (reachability.method, reachability.options) == (
        "rmm",
        {"space": "paper", "horizon": 0.0},
    )
    assert (reachability.symmetric_grasps, reachability.options["horizon"]) == (False, 0.0)


def test_a_key_that_is_given_wins():
    given = load("mode: paper, feed_forward: true, gain: 0.7", ", perception: {latency: 0.2}")
    options = given.control.options
    assert (options["feed_forward"], options["gain"]) == (True, 0.7)
    assert given.perception.latency == 0.2
    assert given.control.options["law"] == "gradient"
    # Whichever text comes first.
    late = load_scenario(
        FILE, "PaperLinear", "{control: {options: {damping: 0.1}}}", "{control: {mode: paper}}"
    )
    assert (late.control.options["damping"], late.control.options["targets"]) == (0.1, "means")


def test_keys_of_older_releases_keep_their_meaning():
    """``law`` and its like were keys of ``control`` itself, ``space`` of ``reachability``."""
    old = load(
        "mode: paper, law: preconditioned, damping: 0.02, resample: false, source: closed_form",
        ", reachability: {space: default}",
    )
    new = load(
        "mode: paper, "
        "options: {law: preconditioned, damping: 0.02, resample: false, source: closed_form}",
        ", reachability: {options: {space: default}}",
    )
    assert dump_scenario(old) == dump_scenario(new)
    both = load("mode: paper, damping: 0.3, options: {damping: 0.4, targets: medoids}")
    assert (both.control.options["damping"], both.control.options["law"]) == (0.4, "gradient")
    # Recorded scenarios hold them all, with what safe mode does anyway.
    recorded = (
        "law: preconditioned, damping: 0.02, targets: medoids, length_scale: 0.0, resample: false"
    )
    others = "gain: null, feed_forward: true, n_solutions: 64, source: closed_form"
    assert load(f"{recorded}, {others}").control.options == {}


def test_keys_of_older_releases_are_found_where_mappings_are_merged(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(
        "_base: &base {control: &control {mode: paper, law: preconditioned, damping: 0.1}}\n"
        "Mine:\n  <<: *base\n  control: {<<: *control, damping: 0.2}\n"
        "  cameras: {wrist_camera: {depth: true, label: true}}\n"
    )
    options = load_scenario(file, "Mine").control.options
    assert (options["law"], options["damping"], options["resample"]) == (
        "preconditioned",
        0.2,
        True,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{control: {mode: paper, law: newton}}", "law is 'newton'; .* preconditioned, gradient"),
        ("{control: {mode: paper, targets: modes}}", "targets is 'modes'; .* medoids, means"),
        ("{control: {mode: paper, damping: -0.1}}", "control.options.damping is -0.1; .*0 to 1"),
        ("{control: {mode: paper, length_scale: .nan}}", "control.options.length_scale is nan"),
        ("{control: {mode: paper, options: {lw: gradient}}}", "no key 'lw'; do you mean law"),
        ("{control: {mode: paper, options: {resample: 3}}}", "resample is 3; give a bool"),
        ("{control: {mode: paper, source: magic}}", "source is 'magic'; .* closed_form, flow"),
        ("{control: {mode: paper, gain: -1.0}}", "control.options.gain is -1; .*0 to 1000 1/s"),
        ("{control: {mode: paper, n_solutions: 0}}", "control.options.n_solutions is 0; .*1 to"),
        (
            "{control: {mode: corrected, resample: true}}",
            "control.options.resample .* closed_form .* flow",
        ),
        ("{control: {law: gradient}}", "control.options has law, .*mode: corrected or paper"),
        ("{control: {feed_forward: false}}", "control.options has feed_forward, .*mode: corrected"),
        ("{reachability: {space: paper}}", "reachability.options has space, .*method: both or"),
        (
            "{control: {mode: corrected, density: false}}",
            "control.density is False, but only safe mode plans",
        ),
        (
            "{control: {mode: paper, prediction: none}}",
            "control.prediction is none, but only safe mode plans",
        ),
        (
            "{grasp: {standoff: 0.1, close: false}, control: {mode: corrected}}",
            "grasp.standoff is 0.1 m, .*mode: safe",
        ),
    ],
)
def test_wrong_values_are_refused(text, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario(FILE, "ReachLinearMocap", text)


@pytest.mark.parametrize(
    ("options", "message"),
    [("spcae: default", "options is 'spcae'; .*mean space"), ("horizon: far", "horizon is 'far'")],
)
def test_a_wrong_option_of_a_judge_is_named(options, message):
    text = f"{{reachability: {{method: none, options: {{{options}}}}}}}"
    with pytest.raises(FeasigraspError, match=message):
        no_judge(load_scenario("ReachLinear", text), Reachability())
