"""Scenario files: what they mean, what comes back when they are written, what they refuse."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from feasigrasp.errors import ScenarioError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.resources import diagram_path
from feasigrasp.runs.run import run
from feasigrasp.scenario.cell import CellConfig
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario, scenario_names
from feasigrasp.scenario.parts import PartConfig
from feasigrasp.scenario.sampling import (
    load_scenario_object,
    make_camera_noise,
    make_friction,
    make_hand_eye,
    make_motion,
)
from feasigrasp.scenario.schema import ControlConfig, Scenario, SensorsConfig
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.from_scenario import make_camera, station_config

FILE = diagram_path("dynamic.scenarios.yaml")
NAMES = (
    "ReachCircular",
    "ReachLinear",
    "ReachSinusoidal",
    "ReachBezier",
    "ReachObstacle",
    "ReachLinearCarried",
    "ReachLinearBelt",
    "ReachLinearBeside",
    "ReachLinearAlong",
    "ReachCircularMocap",
    "ReachLinearMocap",
    "ReachSinusoidalMocap",
    "ReachBezierMocap",
    "ReachObstacleMocap",
    "Static",
    "StaticCamera",
    "PaperCircular",
    "PaperLinear",
    "PaperSinusoidal",
    "PaperCircularFast",
    "PaperLinearFast",
    "PaperSinusoidalFast",
)
PAPER = [name for name in NAMES if name.startswith("Paper")]
TIMES = np.linspace(0.0, 20.9, 53)


def poses(scenario):
    motion = make_motion(scenario)
    return np.array([motion.pose(t) for t in TIMES])


def test_the_file_holds_the_documented_scenarios():
    assert tuple(scenario_names(FILE)) == NAMES


# ------------------------------------------------------------------------------------- motions


def test_paper_motions_are_the_authors():
    """At 0.3 rad/s, and four times as fast: either is a reading of the authors' loop."""
    for suffix, rate in (("", 0.3), ("Fast", 1.2)):
        assert_motions_of_the_authors(suffix, rate * TIMES)


def assert_motions_of_the_authors(suffix, s):
    zero, one = np.zeros_like(s), np.ones_like(s)
    expected = {
        "PaperCircular": [0.45 * np.cos(s), 0.45 * np.sin(s), 0.2 * one],
        "PaperLinear": [0.45 * one, 0.45 * np.sin(s), 0.2 + 0.1 * np.sin(s)],
        "PaperSinusoidal": [0.45 + 0.1 * np.cos(10 * s), 0.35 * np.sin(s), 0.2 + zero],
    }
    roll = Rotation.from_rotvec(np.outer(s, [1.0, 0.0, 0.0])).as_matrix()
    for name, positions in expected.items():
        X = poses(load_scenario(FILE, name + suffix))
        np.testing.assert_allclose(X[:, :3, 3], np.transpose(positions), atol=1e-12, err_msg=name)
        turned = X[:, :3, :3] @ X[0, :3, :3].T
        np.testing.assert_allclose(turned, roll, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("name", PAPER)
def test_the_seed_turns_the_paper_s_object_about_the_vertical(name):
    starts = [
        make_motion(load_scenario(FILE, name, f"{{random_seed: {seed}}}")).pose(0.0)[:3, :3]
        for seed in range(6)
    ]
    for R in starts:
        np.testing.assert_allclose(R[:, 2], [0.0, 0.0, 1.0], atol=1e-12)
    headings = np.array([np.arctan2(R[1, 0], R[0, 0]) for R in starts])
    assert np.ptp(headings) > 1.0 and len(set(headings)) == 6


@pytest.mark.parametrize("name", PAPER)
def test_paper_scenarios_last_three_laps_and_keep_the_gripper_open(name):
    scenario = load_scenario(FILE, name)
    rate = 1.2 if name.endswith("Fast") else 0.3
    assert scenario.simulation_duration == pytest.approx(3 * 2 * np.pi / rate)
    assert scenario.object.model == "duck"
    assert scenario.plant_config.contact_model == "hydroelastic_with_fallback"
    assert scenario.q_start == [0, 30, 0, -60, 0, 90, 0]
    assert not scenario.grasp.close


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_reach_motions_are_in_front_of_the_arm(seed):
    """Circle of radius 0.12 m, line +-0.18 m along y, sinusoid y +-0.2 m and z +-0.08 m; 10 s."""
    p = {}
    for name in NAMES[:3]:
        scenario = load_scenario(FILE, name, f"{{random_seed: {seed}}}")
        motion = make_motion(scenario)
        period = [motion.pose(t)[:3, 3] for t in np.linspace(0.0, 10.0, 2001)]
        p[name] = np.array(period) - [0.5, 0.0, 0.55]
        np.testing.assert_allclose(period[0], period[-1], atol=1e-12)

    circle, line, sine = (p[name] for name in NAMES[:3])
    np.testing.assert_allclose(np.hypot(circle[:, 0], circle[:, 1]), 0.12)
    np.testing.assert_allclose(circle[:, 2], 0.0, atol=1e-12)
    angle = np.unwrap(np.arctan2(circle[:, 1], circle[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(2 * np.pi)

    np.testing.assert_allclose(line[:, [0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose([line[:, 1].min(), line[:, 1].max()], [-0.18, 0.18], atol=1e-5)

    np.testing.assert_allclose(sine[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose([sine[:, 1].min(), sine[:, 1].max()], [-0.2, 0.2], atol=1e-5)
    np.testing.assert_allclose([sine[:, 2].min(), sine[:, 2].max()], [-0.08, 0.08], atol=1e-5)


@pytest.mark.parametrize("name", NAMES[:3])
def test_reach_objects_turn_constantly(name):
    R = poses(load_scenario(FILE, name))[:, :3, :3]
    turned = Rotation.from_matrix(R @ R[0].T).as_rotvec()
    # At most 0.2 rad/s x 20.9 s > pi: compare rotations, not vectors.
    expected = Rotation.from_rotvec(np.outer(0.2 * TIMES, [0.0, 0.0, 1.0]))
    assert (expected.inv() * Rotation.from_rotvec(turned)).magnitude().max() < 1e-9


@pytest.mark.parametrize("name", NAMES[:3])
def test_the_seed_decides_start_and_orientation(name):
    first, again, other = (load_scenario(FILE, name, f"{{random_seed: {k}}}") for k in (5, 5, 6))
    np.testing.assert_array_equal(poses(first), poses(again))
    assert np.linalg.norm(poses(first)[0, :3, 3] - poses(other)[0, :3, 3]) > 1e-3
    assert np.linalg.norm(poses(first)[0, :3, :3] - poses(other)[0, :3, :3]) > 1e-2


# ------------------------------------------------------------------------------ reading, writing


@pytest.mark.parametrize("name", NAMES)
def test_what_is_written_reads_the_same(name):
    scenario = load_scenario(
        FILE, name, "{random_seed: 7, object: {mass: 0.3, model: mug}, control: {mode: paper}}"
    )
    text = dump_scenario(scenario)
    again = parse_scenario(text)
    assert dump_scenario(again) == text
    assert (again.random_seed, again.object.mass, again.object.model) == (7, 0.3, "mug")
    assert again.control.mode == "paper"
    assert list(again.cameras) == ["wrist_camera"]
    np.testing.assert_array_equal(poses(again), poses(scenario))


def test_every_default_is_written():
    text = dump_scenario(Scenario())
    for key in ("simulation_duration: 30.0", "friction: 0.6", "time_step: 0.0025"):
        assert key in text


@pytest.mark.parametrize("name", scenario_names(FILE))
def test_the_conditions_are_those_of_a_real_cell(name):
    """Errors of camera and joints, friction about 0.6, a tenth of a second from view to grasps.

    Late images and planning time, where nothing but the camera tells where the object is.
    """
    scenario = load_scenario(FILE, name)
    noise = make_camera_noise(scenario)["wrist_camera"]
    late = scenario.cameras["wrist_camera"].output_delay, scenario.control.planning_time
    if scenario.tracker.kind == "camera":
        assert (noise.baseline, noise.decimation) == (0.018, 2.0)
        assert late == (0.06, 0.01)
    else:
        assert noise == DepthNoise(decimation=2.0)
        assert late == (0.0, 0.0)
    assert 0.5 <= make_friction(scenario) <= 0.7
    assert scenario.sensors == SensorsConfig()
    assert scenario.perception.latency == 0.1


def test_friction_is_drawn_from_the_seed():
    drawn = [
        make_friction(load_scenario(FILE, "ReachLinear", f"{{random_seed: {seed}}}"))
        for seed in (0, 1, 2, 2)
    ]
    assert len(set(drawn)) == 3 and drawn[2] == drawn[3]
    fixed = load_scenario(FILE, "ReachLinear", "{object: {friction: 0.3}}")
    assert make_friction(fixed) == 0.3


def test_the_error_factor_scales_the_simulated_sensors_and_no_estimator():
    one, two = (
        load_scenario(FILE, "ReachLinear", f"{{sensors: {{error_factor: {factor}}}}}")
        for factor in (1, 2)
    )
    noise = [make_camera_noise(scenario)["wrist_camera"] for scenario in (one, two)]
    assert noise[1].subpixel == 2 * noise[0].subpixel and noise[1].bias == 2 * noise[0].bias
    hand_eye = [make_hand_eye(scenario)["wrist_camera"] for scenario in (one, two)]
    assert hand_eye[1].hand_eye_position == 2 * hand_eye[0].hand_eye_position
    joints = [station_config(scenario).joint_errors for scenario in (one, two)]
    assert joints[1].torque_accuracy == 2 * joints[0].torque_accuracy == 0.04
    assert vars(make_camera(one)) == vars(make_camera(two))  # what estimators take it for
    other = load_scenario(FILE, "ReachLinear", "{camera_noise: {wrist_camera: {subpixel: 0.3}}}")
    assert make_camera(other).depth_noise == make_camera(one).depth_noise


def test_by_default_there_is_nothing_but_a_camera_as_a_d405():
    """Least depth and baseline; calibration and correlated noise as a real camera has them."""
    for name in NAMES[:5]:
        plain, seen = load_scenario(FILE, f"{name}Mocap"), load_scenario(FILE, name)
        moved = [poses(scenario) for scenario in (plain, seen)]
        np.testing.assert_array_equal(*moved)
        assert (plain.perception.segmentation, seen.perception.segmentation) == ("labels", "depth")
        assert (plain.tracker.kind, seen.tracker.kind) == ("mocap", "camera")
        assert seen.cameras["wrist_camera"].z_near == 0.07
        noise = make_camera_noise(seen)["wrist_camera"]
        assert min(noise.correlation, noise.motion_blur, noise.dropped) > 0.0
        error = make_hand_eye(seen)["wrist_camera"]
        assert min(error.hand_eye_position, error.hand_eye_angle_deg) > 0.0
        assert make_hand_eye(plain) == {}


def test_an_empty_map_empties_one_at_any_depth():
    boxes = "{cell: {boxes: {one: {}, two: {}}, table_clearance: 0.02}}"
    part = "{parts: {tracker: {name: 'a:B', options: {x: 1}}}}"
    kept, emptied = "{cell: {boxes: {two: {}}}}", "{cell: {boxes: {}}}"
    options = "{parts: {tracker: {options: {}}}}"
    scenario = load_scenario(FILE, "ReachLinear", boxes, part, kept)
    assert list(scenario.cell.boxes) == ["one", "two"]
    scenario = load_scenario(FILE, "ReachLinear", boxes, part, emptied, options)
    assert scenario.cell == CellConfig(table_clearance=0.02)
    assert scenario.parts == {"tracker": PartConfig("a:B")}


def test_camera_noise_is_off_where_no_camera_is_named():
    assert Scenario().camera_noise == {}
    assert make_camera_noise(load_scenario(FILE, "ReachLinearMocap", "{camera_noise: {}}")) == {}
    text = "{camera_noise: {wrist_camera: {subpixel: 0.1, flying: 0}}}"
    scenario = load_scenario(FILE, "ReachLinearMocap", text)
    noise = DepthNoise(subpixel=0.1, flying=0.0, decimation=2.0)
    assert make_camera_noise(scenario) == {"wrist_camera": noise}
    assert make_camera_noise(parse_scenario(dump_scenario(scenario))) == make_camera_noise(scenario)
    default = load_scenario(FILE, "ReachLinearMocap", "{camera_noise: {wrist_camera: {}}}")
    assert make_camera_noise(default) == {"wrist_camera": DepthNoise(decimation=2.0)}


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ("{head: {}}", "names 'head', but cameras has wrist_camera"),
        ("{wrist_camera: {sigma: 1}}", "has sigma; it may have baseline, subpixel"),
        ("{wrist_camera: {subpixel: -1}}", "wrist_camera: DepthNoise.subpixel = -1"),
        ("{wrist_camera: {hand_eye_position: -1}}", "HandEyeError.hand_eye_position = -1"),
        ("{wrist_camera: {dropped: 2}}", "dropped = 2.* is a share; give 1 at most"),
    ],
)
def test_wrong_camera_noise_is_refused(noise, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario(FILE, "ReachLinearMocap", f"{{camera_noise: {noise}}}")


def test_later_overrides_win():
    scenario = load_scenario(FILE, "ReachLinearMocap", "{random_seed: 1}", None, "{random_seed: 2}")
    assert scenario.random_seed == 2
    assert scenario.motion.amplitude == [0.0, 0.18, 0.0]


# ------------------------------------------------------------------------------------ bad input


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


def test_a_resting_object_lies_in_its_cube_with_any_orientation():
    scenario = load_scenario(FILE, "Static")
    motions = [make_motion(replace(scenario, random_seed=k)) for k in range(40)]
    X = np.array([motion.pose(7.0) for motion in motions])
    np.testing.assert_array_equal(X, [motion.pose(0.0) for motion in motions])
    assert not any(motion.velocity(7.0).any() for motion in motions)
    p = X[:, :3, 3] - [0.4, 0.0, 0.6]
    assert (np.abs(p) <= 0.05).all() and (np.ptp(p, axis=0) > 0.08).all()
    # Of uniform rotations the mean is zero.
    assert np.abs(X[:, :3, :3].mean(axis=0)).max() < 0.4


def test_a_heavier_object_is_heavier_in_all_directions():
    one, two = (
        load_scenario_object(load_scenario(FILE, "Static", f"{{object: {{mass_factor: {f}}}}}"))
        for f in (1.0, 2.0)
    )
    assert two.mass == pytest.approx(2.0 * one.mass)
    np.testing.assert_allclose(two.inertia, 2.0 * one.inertia)


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
