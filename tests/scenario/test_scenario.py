"""Scenario files: their meaning, and that a written one reads the same."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from feasigrasp.errors import ScenarioError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.resources import diagram_path
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
from feasigrasp.scenario.schema import Scenario, SensorsConfig
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
