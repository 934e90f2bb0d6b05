"""No value passes that nothing can be run with, whatever it is, and whatever text it comes in."""

import typing
from types import UnionType

import hypothesis.strategies as st
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from pydrake.multibody.parsing import ModelDirective

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import metadata_of
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.sensors.camera_errors import HandEyeError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.checks import check_scenario, numbers, words
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario, scenario_names
from feasigrasp.scenario.keys import SPANS, general, members
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import make_station

FILE = diagram_path("dynamic.scenarios.yaml")

#: Keys and values, each of which was accepted once, failed late, or ended in a raw traceback.
BAD = {
    "tracker.position_noise": (".nan", "-0.01", "5.0"),
    "tracker.rotation_noise": (".inf", "-1"),
    "tracker.dropout": ("1.5", "-0.1", ".nan"),
    "tracker.jerk": ("0", "-1", ".nan"),
    "tracker.angular_jerk": ("-0.3",),
    "tracker.latency": ("-0.1", ".nan", "1000"),
    "tracker.period": ("1e-9", "100", "true", "null"),
    "tracker.seed": ("-1", "1.5"),
    "reachability.period": ("1e-9", "1000"),
    "scene.margin": ("-0.5", ".nan", "3"),
    "scene.resolution": ("5",),
    "perception.latency": ("-0.1", ".nan"),
    "perception.voxel_size": ("0", "-0.003", ".nan", "1.0"),
    "perception.max_points": ("0", "-5", "100000000", "3.7", "many"),
    "perception.length_scale": ("-1", ".nan"),
    "perception.n_candidates": ("0",),
    "perception.n_grasps": ("-1",),
    "perception.period": ("1e-12",),
    "perception.sampler": ("magic",),
    "object.mass": ("-1", "0", ".nan", "1e6", "[1]"),
    "object.scale": ("1e9", "-1"),
    "object.friction": ("1e9", "-0.1"),
    "object.rotation.deg": ("!Rpy {deg: [.nan, 0, 0]}",),
    "object.rotation.axis": ("!AngleAxis {angle_deg: 10, axis: [0, 0, 0]}",),
    "q_start[6]": ("[0, 0, 0, 0, 0, 0, 900]",),
    "q_start[1]": ("[0, 130, 0, 0, 0, 0, 0]", "[0, .nan, 0, 0, 0, 0, 0]"),
    "plant_config.time_step": ("0", "-0.1", "0.5", ".nan"),
    "plant_config.penetration_allowance": ("-1",),
    "plant_config.stiction_tolerance": ("0",),
    "plant_config.contact_model": ("magic",),
    "plant_config.discrete_contact_approximation": ("magic",),
    "simulator_config.max_step_size": ("0", ".nan"),
    "simulator_config.accuracy": ("-1",),
    "simulator_config.integration_scheme": ("magic",),
    "simulator_config.target_realtime_rate": ("-1",),
    "simulator_config.start_time": ("1",),
    "cameras.wrist_camera.width": ("0", "-5", "100000"),
    "cameras.wrist_camera.z_near": ("6.0", "-1"),
    "cameras.wrist_camera.clipping_near": ("0", "0.2"),
    "cameras.wrist_camera.fps": ("0",),
    "cameras.wrist_camera.focal.x": ("!FovDegrees {x: 0, y: 58}", "!FovDegrees {x: 180}"),
    "cameras.wrist_camera.renderer_class": ("Magic",),
    "control.period": ("0.5", "1e-9"),
    "control.speed": ("0", "-0.2", "1.5", "20", ".nan", "20%"),
    "cell.table_height": ("5", ".nan", "high"),
    "cell.table_clearance": ("-0.01", "1"),
    "cell.boxes.a.size": ("[1, 2]", "0.1"),
    "cell.boxes.a.size[1]": ("[1, 0, 1]", "[1, -1, 1]", "[1, .nan, 1]"),
    "cell.boxes.a.position[0]": ("[50, 0, 0]",),
    "cell.boxes.a.rpy_deg[2]": ("[0, 0, 1e5]",),
    "cell.meshes.a.scale": ("0", "-1"),
    "grasp.position_tolerance": ("-1",),
    "grasp.standoff": ("-1", "1"),
    "grasp.angle_tolerance": (".nan",),
    "grasp.dwell": ("-1",),
    "grasp.closing_speed": ("0", ".nan"),
    "grasp.closing_time": ("0",),
    "grasp.squeeze_time": ("-1",),
    "grasp.min_width": ("-1",),
    "grasp.lift_time": ("0",),
    "grasp.hold_time": ("-1",),
    "grasp.lift[2]": ("[0, 0, 50]",),
    "grasp.close": ("7", "'yes'"),
    "motion.center[0]": ("[50, 0, 0]",),
    "motion.center[2]": ("[0.5, 0, -3]",),
    "motion.amplitude[0]": ("[1000, 0, 0]",),
    "motion.harmonic[0]": ("[1e9, 1, 1]",),
    "motion.rate": ("1e9",),
    "motion.spin": ("1e5",),
    "motion.start_phase": (".nan", "!Uniform {min: 3, max: 1}", "!Uniform {min: .nan}"),
    "simulation_duration": ("1e12", "0", ".nan"),
    "random_seed": ("-1", "1.5"),
    "carrier.kind": ("glove", "3"),
    "carrier.hue": ("400", "-1", ".nan", "pink"),
    "distractor.offset": ("[0.1, 0.2]", "0.1"),
    "distractor.offset[1]": ("[0, 7, 0]", "[0, .nan, 0]"),
    "distractor.moving": ("7",),
    "camera_noise.wrist_camera": ("{subpixel: .nan}", "{flying: 2}", "{subpixel: 1e9}"),
    "object": ("null", "3", "[1]"),
    "motion": ("null", "!Foo {rate: 1}"),
    "cameras": ("null", "7"),
}
CASES = [(key, value) for key, values in BAD.items() for value in values]


def text_of(key, value):
    """The YAML that gives a key this value; of a vector or a tagged part, the whole of it."""
    *sections, last = key.split("[")[0].split(".")
    if value.startswith("!") and last not in ("start_phase", "motion"):
        *sections, last = sections
    return "{" + ": {".join(sections + [last]) + f": {value}" + "}" * (len(sections) + 1)


@pytest.mark.parametrize(("key", "value"), CASES)
def test_bad_values_are_refused_by_name_when_they_are_read(small_file, key, value):
    with pytest.raises(ScenarioError) as error:
        load_scenario(small_file, "Mine", text_of(key, value))
    assert f": {key}" in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "{tracker: {latncy: 0.1}}",
            "tracker has no key 'latncy'.*do you mean latency",
        ),
        ("{objct: {model: mug}}", "the scenario has no key 'objct'.*do you mean object"),
        ("{cameras: {wrist_camera: {widht: 3}}}", "cameras.wrist_camera has.*do you mean width"),
        ("{control: {mode: saef}}", "do you mean safe"),
        ("{perception: {camera: wrst_camera}}", "do you mean wrist_camera"),
        ("random_seed: 1\nrandom_seed: 2", "'random_seed' is given twice, in line 1 and in line 2"),
        ("{object: {mass: 1, mass: 2}}", "'mass' is given twice"),
        ("[1, 2]", "not a mapping"),
        ("{}: 3", "a key in line 1 is no word"),
        (
            "{plant_config: {time_step: 0.002}}",
            r"time_step: 0.002 s does not divide control.period, 0.005 s; give 0.00166666667",
        ),
        ("{carrier: {kind: hnd}}", "carrier.kind is 'hnd'; choose one of none, hand, belt.*hand"),
        ("{carrier: {kind: hand, hue: 315}}", "carrier.hue is 315.*segmentation: depth"),
        (
            "{distractor: {model: mug, offset: [0, 0, 0], moving: true}}",
            "distractor.offset is zero, so that it would be in the object",
        ),
        ("{cell: {boxes: {a: {sise: [1, 1, 1]}}}}", "cell.boxes.a has no key 'sise'.*mean size"),
        ("{cell: {boxes: {table: {}}}}", "the obstacle 'table'; that name is taken"),
        ("{cell: {boxes: {a b: {}}}}", "the obstacle 'a b'; give letters"),
        ("{cell: {boxes: {1: {}}}}", "the obstacle 1; give letters"),
        ("{cell: {boxes: {yes: {}}}}", "the obstacle True; give letters"),
        ("{cell: {meshes: {a: {}}}}", "cell.meshes.a.file is empty"),
        (
            "{cell: {meshes: {a: {file: no.obj}}}}",
            "cell.meshes.a.file is 'no.obj', but there is no",
        ),
        (
            "{directives: [{add_model: {name: a, file: no.sdf}}]}",
            r"directives\[0\].add_model.file is",
        ),
        (
            "{control: {mode: paper, speed: 0.5}}",
            "control.speed is 0.5, but mode paper enforces no",
        ),
        ("{control: {mode: corrected, speed: 0.5}}", "control.speed is 0.5, but mode corrected"),
        ("{perception: {views: -1}}", "perception.views is -1"),
        ("{control: {prediction: far}}", "control.prediction is 'far'; .* predicted, twist, none"),
        (
            "{control: {controller: nearest, density: false}}",
            "control.density .*controller: task or joint",
        ),
        ("{grasp: {standoff: 0.1}}", "grasp.standoff is 0.1 m, but grasp.close .*close: false"),
        ("{tracker: {period: -1}}", "tracker.period is -1; it must be from 0.0001 to 1 s"),
    ],
)
def test_messages_say_what_to_do(text, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario(FILE, "ReachLinearMocap", text)


def test_a_file_is_checked_like_what_is_applied_on_top(tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text("_shared: &shared\n  random_seed: 1\nMine:\n  <<: *shared\n  object: {mas: 1}\n")
    with pytest.raises(ScenarioError, match=r"own.yaml: object has no key 'mas' \(line 5\)"):
        load_scenario(own, "Mine")
    own.write_text("Mine: {random_seed: 1}\nMine: {random_seed: 2}\n")
    with pytest.raises(ScenarioError, match="'Mine' is given twice"):
        load_scenario(own, "Mine")
    for content in (b"\xff\xfe\x00", b"- 1\n", b"", b"[" * 5000):
        own.write_bytes(content)
        with pytest.raises(ScenarioError, match="own.yaml"):
            load_scenario(own, "Mine")
    with pytest.raises(ScenarioError, match="cannot be read"):
        scenario_names(tmp_path)


def test_what_drake_alone_can_tell_is_told_as_well():
    text = "{cameras: {wrist_camera: {X_PB: {base_frame: nowhere}}}}"
    with pytest.raises(ScenarioError, match="no Frame named 'nowhere'"):
        make_station(load_scenario(FILE, "ReachLinearMocap", text))


# ------------------------------------------------------------------------- spans beside the fields


def numeric_keys(kind, path=(), span=None):
    """The keys of all numbers that a type can hold, and whether a span is stated for each."""
    if kind in (float, int):
        yield general(path), span is not None or general(path) in SPANS
    elif typing.get_origin(kind) in (typing.Union, UnionType):
        for each in typing.get_args(kind):
            yield from numeric_keys(each, path, span)
    elif typing.get_origin(kind) is dict:
        name, entry = "any", typing.get_args(kind)[1]
        if path == ("camera_noise",):
            yield from numeric_keys(DepthNoise, (*path, name))
            yield from numeric_keys(HandEyeError, (*path, name))
        else:
            yield from numeric_keys(entry, (*path, name))
    elif typing.get_origin(kind) is list:
        yield from numeric_keys(typing.get_args(kind)[0], path, span)
    elif kind is np.ndarray or getattr(kind, "__origin__", None) is np.ndarray:
        yield general(path), span is not None or general(path) in SPANS
    elif kind is not ModelDirective and not getattr(kind, "__name__", "").startswith("RenderEng"):
        stated = metadata_of(kind)
        for name, of in members(kind).items():
            yield from numeric_keys(of, (*path, name), stated.get(name, {}).get("span", span))


def test_every_number_of_the_schema_has_a_span():
    # Faults have tables of their own, and parts of one's own know what they take.
    keys = {
        key: stated
        for key, stated in numeric_keys(Scenario)
        if not key.startswith(("faults.", "parts.")) and ".options." not in key
    }
    assert len(keys) > 80
    assert [key for key, stated in keys.items() if not stated] == []
    assert sorted(set(SPANS) - set(keys)) == []  # no line is about a key that there is not
    found = list(numbers(load_scenario(FILE, "ReachLinearMocap")))
    assert {general(path) for path, *_ in found} <= set(keys)
    assert all(span.low <= span.high for *_, span in found)


def test_the_shipped_scenarios_and_defaults_lie_inside():
    for name in scenario_names(FILE):
        check_scenario(load_scenario(FILE, name))
    q = (np.rad2deg(IIWA_7.driver.upper) * [1, 1, 1, -1, 1, 1, 1]).tolist()  # clear of itself
    assert load_scenario(FILE, "ReachLinearMocap", f"{{q_start: {q}}}").q_start == q


# -------------------------------------------------- random values and texts

VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.floats(0.001, 2.0),
    st.text(max_size=8),
    st.sampled_from(["safe", "paper", "network", "1e-3", "0x10", "nan", "wrist_camera"]),
)
TREES = st.recursive(
    VALUES,
    lambda of: st.lists(of, max_size=4) | st.dictionaries(st.text(max_size=6) | VALUES, of),
    max_leaves=6,
)


def keys_of(kind, path=()):
    """All keys of the schema, sections and leaves."""
    for name, of in members(kind).items():
        yield (*path, name)
        if of is not kind:
            yield from keys_of(of, (*path, name))


KEYS = [*keys_of(Scenario), ("cameras", "wrist_camera"), ("camera_noise", "wrist_camera")]
KEYS += [("cameras", "wrist_camera", key) for key in ("width", "focal", "X_PB", "background")]
KEYS += [("camera_noise", "wrist_camera", key) for key in members(DepthNoise)]


@pytest.fixture(scope="module")
def small_file(tmp_path_factory):
    """A file with little in it, which reads more quickly."""
    file = tmp_path_factory.mktemp("scenarios") / "small.yaml"
    file.write_text("Mine: {cameras: {wrist_camera: {depth: true, label: true}}}")
    return file


def check_reads_or_refuses(file, text):
    try:
        scenario = load_scenario(file, "Mine", text)
    except ScenarioError:
        return
    written = dump_scenario(scenario)
    assert dump_scenario(parse_scenario(written)) == written


@settings(max_examples=250, deadline=None)
@given(st.sampled_from(KEYS), TREES | st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=7))
def test_any_value_of_any_key_is_read_or_refused(small_file, key, value):
    for name in reversed(key):
        value = {name: value}
    check_reads_or_refuses(small_file, yaml.safe_dump(value, allow_unicode=True))


@settings(max_examples=150, deadline=None)
@given(TREES)
def test_any_tree_is_read_or_refused(small_file, tree):
    check_reads_or_refuses(small_file, yaml.safe_dump(tree, allow_unicode=True))


@settings(max_examples=150, deadline=None)
@given(st.text(alphabet="{}[]:,&*!<-#|>'\"%@ \n\tab1.", max_size=30) | st.text(max_size=30))
def test_any_text_is_read_or_refused(small_file, text):
    check_reads_or_refuses(small_file, text)


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.sampled_from([*members(DepthNoise), "sigma"]), VALUES, max_size=3))
def test_any_camera_noise_is_read_or_refused(small_file, changes):
    noise = {"camera_noise": {"wrist_camera": changes}}
    check_reads_or_refuses(small_file, yaml.safe_dump(noise, allow_unicode=True))


def test_every_choice_is_one_of_the_schema():
    scenario = Scenario()
    for key, allowed in words(scenario).items():
        section, name = key.split(".")
        assert getattr(getattr(scenario, section), name) in allowed


@pytest.mark.parametrize("text", ["010", "1:30", "0x10"])
def test_a_number_that_yaml_reads_as_another_one_is_refused(text):
    """YAML 1.1 reads 010 as 8 and 1:30 as 90."""
    with pytest.raises(ScenarioError, match=f"line 1 has {text}, which YAML reads as"):
        load_scenario("ReachLinear", f"{{object: {{mass: {text}}}}}")
