"""Reading scenarios from files and texts: what they are based on, and what is refused by name."""

from dataclasses import replace

import pytest

from feasigrasp.errors import ScenarioError
from feasigrasp.resources import diagram_path
from feasigrasp.runs.run import run
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.schema import ControlConfig, Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp

FILE = diagram_path("dynamic.scenarios.yaml")


def test_later_overrides_win():
    scenario = load_scenario(FILE, "ReachLinearMocap", "{random_seed: 1}", None, "{random_seed: 2}")
    assert scenario.random_seed == 2
    assert scenario.motion.amplitude == [0.0, 0.18, 0.0]


@pytest.mark.parametrize("file, same", [
    ("Mine: {based_on: ReachLinear, object: {model: mug}}", "{object: {model: mug}}"),
    ("_own: &own {based_on: ReachLinear, random_seed: 4}\nMine: {<<: *own, arm: ur5e}",
     "{random_seed: 4, arm: ur5e}"),
])  # fmt: skip
def test_a_scenario_is_based_on_a_packaged_one(file, same, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(file)
    based = load_scenario(path, "Mine")
    assert dump_scenario(based) == dump_scenario(load_scenario("ReachLinear", same))


def test_what_holds_where_no_value_is_given_holds_below_a_packaged_scenario(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text("Mine: {based_on: ReachLinear}")
    slow = Scenario(control=ControlConfig(speed=0.25))
    assert load_scenario(path, "Mine", base=slow).control.speed == 0.25


def test_an_unknown_base_is_named(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text("Mine: {based_on: ReachLinaer}")
    with pytest.raises(ScenarioError, match="do you mean ReachLinear"):
        load_scenario(path, "Mine")


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("Mine: {based_on: [ReachLinear]}", "based_on is a list; give a word .line 1"),
        ("Mine: {based_on: }", "based_on is empty; give a word"),
        ("object: {model: mug}", "own.yaml is no map of names.*Mine: {object: ...}"),
        ("Mine: {object: {model: mug}}", "cameras has none; give one, or based_on: ReachLinear"),
        ("based_on: ReachLinear", "Mine: {based_on: ...}"),
        (
            "Mine: {based_on: ReachLinear, cameras: {c: {X_PB: {translation: [1, 2]}}}}",
            "cameras.c.X_PB.translation has 2 entries; give 3 .line 1",
        ),
    ],
)
def test_a_file_of_another_form_is_refused_by_its_key(file, message, tmp_path):
    (tmp_path / "own.yaml").write_text(file)
    with pytest.raises(ScenarioError, match=message):
        load_scenario(tmp_path / "own.yaml")


@pytest.mark.parametrize("text", ["{object: {", "object"])
def test_a_text_that_is_no_mapping_is_named(text):
    with pytest.raises(ScenarioError, match=f"'ReachLinear' as changed by {text}: not"):
        load_scenario("ReachLinear", "{random_seed: 1}", text)


@pytest.mark.parametrize("text", [{"random_seed": 1}, 5, b"{}", ["{}"]])
def test_what_is_no_text_is_refused(text):
    with pytest.raises(ScenarioError, match="load_scenario: texts is .*; give a str"):
        load_scenario("ReachLinear", None, text)


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("", "random_seed", 1.5, "random_seed is 1.5; give a whole number"),
        ("", "object", None, "object is None; give a ObjectConfig"),
        ("object", "mass", "heavy", "ObjectConfig.mass is 'heavy'; give a finite number"),
        ("object", "mass", 1e9, "object.mass is 1000000000; it must be from 0.001 to 20 kg"),
    ],
)
def test_what_is_set_after_reading_is_checked_as_well(section, key, value, message):
    scenario = load_scenario("ReachLinear")
    setattr(getattr(scenario, section, scenario), key, value)
    for use in (run, make_dynamic_grasp):
        with pytest.raises(ScenarioError, match=message):
            use(scenario)


def test_a_wrong_value_is_blamed_on_what_gave_it(tmp_path):
    """Not on what was applied after it, nor on a text for what the file says."""
    wrong, harmless = "{object: {friction: -1.0}}", "{random_seed: 3}"
    with pytest.raises(ScenarioError, match=r"as changed by \{object: .*friction is -1"):
        load_scenario(FILE, "ReachLinear", harmless, wrong, harmless)
    own = tmp_path / "own.yaml"
    own.write_text("Own:\n  object: {friction: -1.0}\n")
    with pytest.raises(ScenarioError, match=r"'Own' in .*own\.yaml: object\.friction is -1"):
        load_scenario(own, "Own", harmless)


def test_the_step_that_is_proposed_is_accepted():
    with pytest.raises(ScenarioError, match="does not divide") as refused:
        load_scenario(FILE, "ReachLinear", "{plant_config: {time_step: 0.002}}")
    step = str(refused.value).rpartition("give ")[2]
    load_scenario(FILE, "ReachLinear", f"{{plant_config: {{time_step: {step}}}}}")


def test_unknown_scenario_names_the_known_ones():
    with pytest.raises(ScenarioError, match="'ReachSquare'.*ReachCircularMocap, ReachLinearMocap"):
        load_scenario(FILE, "ReachSquare")
    with pytest.raises(ScenarioError, match="'my.yaml'.*give a file by --scenario-file"):
        load_scenario(FILE, "my.yaml")


def test_missing_and_broken_files_are_named(tmp_path):
    with pytest.raises(ScenarioError, match="nowhere.yaml; check --scenario-file"):
        load_scenario(tmp_path / "nowhere.yaml", "ReachLinearMocap")
    broken = tmp_path / "broken.yaml"
    broken.write_text("ReachLinearMocap: {motion: [")
    with pytest.raises(ScenarioError, match="broken.yaml is not valid YAML"):
        load_scenario(broken, "ReachLinearMocap")


def test_a_merged_list_is_refused_since_readers_disagree_which_wins(tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text("_a: &a {random_seed: 1}\n_b: &b {random_seed: 2}\nMine: {<<: [*a, *b]}\n")
    with pytest.raises(ScenarioError, match=r"own.yaml is line 3 merges a list.*PyYAML"):
        load_scenario(own, "Mine")
    own.write_text(
        "_a: &a {cameras: {wrist_camera: {}}, random_seed: 1}\n"
        "_b: &b {<<: *a, random_seed: 2}\nMine: {<<: *b}\n"
    )
    assert load_scenario(own, "Mine").random_seed == 2


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{objct: {model: mug}}", "objct"),
        ("{object: {colour: red}}", "colour"),
        ("{control: {strength: 3}}", "strength"),
    ],
)
def test_unknown_keys_are_refused_by_name(text, named, tmp_path):
    with pytest.raises(ScenarioError, match=named):
        load_scenario(FILE, "ReachLinearMocap", text)
    with pytest.raises(ScenarioError, match=named):
        parse_scenario(text)
    own = tmp_path / "own.yaml"
    own.write_text(f"Mine: {text}")
    with pytest.raises(ScenarioError, match=f"'Mine'.*own.yaml(?s:.*){named}"):
        load_scenario(own, "Mine")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{control: {controller: magic}}", "control.controller is 'magic'; .* task, joint"),
        ("{control: {mode: fast}}", "control.mode is 'fast'; .* safe, corrected, paper"),
        ("{control: {period: 0.0}}", "control.period is 0; it must be from 0.0005 to 0.05 s"),
        ("{perception: {period: -0.5}}", "perception.period is -0.5"),
        ("{perception: {camera: ceiling}}", "'ceiling', but cameras has wrist_camera"),
        ("{perception: {preset: magic}}", "perception.preset is 'magic'; .* default, paper"),
        (
            "{reachability: {method: magic}}",
            "reachability.method is 'magic'; .* ik, both, none",
        ),
        ("{simulation_duration: .nan}", "simulation_duration is nan"),
        ("{random_seed: -1}", "random_seed is -1"),
        ("{random_seed: many}", "many"),
        ("{q_start: [0, 0, 0]}", "q_start has 3 entries.*7"),
        ("{motion: {center: [0.5, 0.0]}}", "motion.center has 2 entries; give x, y and z"),
        (
            "{motion: {amplitude: [0.1, .inf, 0.0]}}",
            r"motion.amplitude\[1\] is inf; give a finite",
        ),
        ("{motion: {spin_axis: [0, 0, 0]}}", "motion.spin_axis is zero"),
        ("{motion: {rate: .nan}}", "motion.rate is nan"),
        ("{grasp: {lift: [0.1]}}", "grasp.lift has 1 entries"),
        ("{grasp: {patience: .inf}}", "patience is inf; give a finite number from 0.5 to 100000 s"),
        ("{grasp: {shake: [0.1]}}", "grasp.shake has 1 entries"),
        ("{object: {scale: 0.0}}", "object.scale is 0; "),
        ("{object: {friction: -0.1}}", "object.friction is -0.1"),
        ("{object: {model: mug", "ReachLinearMocap"),
        ("{object: {rotation: Uniform}}", "object.rotation is Uniform; give one of !Ident.*!Unif"),
        ("{object: {rotation: !Uniform }}", "object.rotation is empty; give !Uniform {}"),
        ("{object: {rotation: !Turn {}}}", "object.rotation has the tag !Turn; give !Rpy"),
        ("{object: {rotation: !Rpy {deg: 30}}}", "object.rotation.deg is 30; give a list"),
        ("{object: {rotation: !Rpy {deg: [0, 0, x]}}}", r"rotation.deg\[2\] is x; give a number"),
        ("{object: {rotation: !Rpy {deg: [0, 0]}}}", "object.rotation.deg has 2 entries; give 3"),
    ],
)
def test_wrong_values_are_refused(text, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario(FILE, "ReachLinearMocap", text)


# ------------------------------------------------------------------------------- drawn and scaled


@pytest.mark.parametrize(
    ("section", "former", "key", "value"),
    [
        ("control", "look_ahead", "prediction", "twist"),
        ("reachability", "twins", "symmetric_grasps", False),
    ],
)
def test_a_renamed_key_is_read_with_a_warning_that_names_the_new_one(section, former, key, value):
    text = f"{{{section}: {{{former}: {str(value).lower()}}}}}"
    with pytest.warns(FutureWarning, match=rf"{section}\.{former} is now {section}\.{key}"):
        scenario = load_scenario(FILE, "ReachCircular", text)
    assert getattr(getattr(scenario, section), key) == value


def test_a_key_that_only_older_releases_of_drake_have_is_read_where_it_changes_nothing(tmp_path):
    """Records of older releases hold it; where it asks for something, Drake has to have it."""
    step = "simulator_config: {max_step_size: 0.02, publish_every_time_step: false}"
    former = f"{step}, cameras: {{wrist_camera: {{}}}}"
    own = tmp_path / "own.yaml"
    own.write_text(f"_base: &base {{{former}}}\nMine: {{<<: *base, random_seed: 3}}\n")
    scenario = load_scenario(own, "Mine", "{simulator_config: {publish_every_time_step: false}}")
    assert scenario.random_seed == 3
    for each in (scenario, parse_scenario(f"{{{former}}}")):
        assert each.simulator_config.max_step_size == 0.02
    with pytest.raises(ScenarioError, match="publish_every_time_step"):
        parse_scenario(f"{{{step.replace('false', 'true')}}}")
    with pytest.raises(ScenarioError, match="has no key 'publish_evry_time_step'"):
        parse_scenario(f"{{{step.replace('every', 'evry')}}}")


def test_a_motion_without_a_tag_keeps_the_kind_of_what_it_changes():
    """As a value that is given alone changes nothing else."""
    usual = load_scenario(FILE, "ReachBezier").motion
    faster = load_scenario(FILE, "ReachBezier", "{motion: {speed: 0.6}}").motion
    assert faster == replace(usual, speed=0.6)
    with pytest.raises(ScenarioError, match="motion has no key 'rate'.*It has center, size, speed"):
        load_scenario(FILE, "ReachBezier", "{motion: {rate: 0.6}}")
    assert load_scenario(FILE, "ReachBezier", "{motion: !MotionConfig {rate: 0.6}}").motion.rate
