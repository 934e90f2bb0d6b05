"""What ``feasigrasp evaluate dynamic`` plans: studies, their conditions, the test split."""

import argparse

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.errors import ScenarioError
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp_lab.protocols.ablations import ABLATIONS
from feasigrasp_lab.runs.plan import plan
from feasigrasp_lab.runs.studies import STUDIES
from feasigrasp_lab.studies import dynamic
from feasigrasp_lab.training import fit_certainty
from feasigrasp_lab.training.data.held_out_objects import FIRST_SEED, FIRST_TEST_SEED
from feasigrasp_lab.training.data.household_shapes import HELD_OUT, make_shape


def planned(*arguments):
    parser = argparse.ArgumentParser()
    dynamic.add_arguments(parser)
    return plan(parser.parse_args(arguments)).runs


@pytest.mark.parametrize(("study", "seeds"), [("reach", 2), ("mocap", 3)])
def test_a_headline_is_all_objects_under_the_conditions_of_the_scenarios(study, seeds):
    """{Circular, Linear, Sinusoidal} x {task, joint} x 18 objects x seeds."""
    runs = planned(*([] if study == "reach" else ["--study", study]))
    assert len({run.id for run in runs}) == len(runs) == 3 * 2 * 18 * seeds
    assert {run.object_name for run in runs} == set(builtin_objects())
    assert {run.scenario.control.mode for run in runs} == {"safe"}
    file = diagram_path("dynamic.scenarios.yaml")
    given = {name: load_scenario(file, name) for name in STUDIES[study].scenarios}
    for run in runs:
        own = given[run.name]
        assert run.scenario.camera_noise == own.camera_noise
        assert run.scenario.perception == own.perception
        drawn = [(f.min, f.max) for f in (run.scenario.object.friction, own.object.friction)]
        assert drawn[0] == drawn[1] == (0.5, 0.7)


NOISY = "{camera_noise: {wrist_camera: {}}, perception: {latency: 0.1}}"


def test_a_scenario_is_not_named_like_the_runs_of_a_study(tmp_path):
    file = tmp_path / "own.scenarios.yaml"
    text = diagram_path("dynamic.scenarios.yaml").read_text()
    file.write_text(text.replace("ReachLinearMocap:", "Mine-no-score:", 1))
    own = ("--scenario-file", str(file), "--objects", "mug", "--scenarios", "Mine-no-score")
    with pytest.raises(ScenarioError, match="Mine-no-score ends in -no-score"):
        planned(*own)


def test_ideal_runs_have_perfect_sensors_and_names_of_their_own():
    some = ("--objects", "mug,ball", "--scenario-text", NOISY)
    headline, ideal = planned("--study", "mocap", *some), planned("--study", "ideal", *some)
    assert {run.id for run in ideal}.isdisjoint(run.id for run in headline)
    assert {run.name for run in ideal} == {f"{run.name}-ideal" for run in headline}
    assert {tuple(run.scenario.camera_noise) for run in headline} == {("wrist_camera",)}
    for run in ideal:
        assert run.scenario.camera_noise == {} and run.scenario.perception.latency == 0.0


def test_motion_capture_errs_anew_with_every_seed():
    runs = planned("--study", "tracking", "--objects", "mug", "--seeds", "2")
    trackers = [run.scenario.tracker for run in runs]
    assert {(t.position_noise, t.latency) for t in trackers} == {(0.002, 0.05)}
    np.testing.assert_allclose([t.rotation_noise for t in trackers], np.deg2rad(1.0))
    assert [t.seed for t in trackers] == [run.scenario.random_seed for run in runs]
    assert {t.seed for t in trackers} == {0, 1}


#: What every ablation changes.
CHANGED = {
    "-full": set(),
    "-no-density": {"control.density"},
    "-no-score": {"control.score"},
    "-no-look-ahead": {"control.prediction"},
    "-no-prediction": {"control.prediction"},
    "-no-hidden-side": {"perception.hidden_side"},
    "-one-view": {"perception.views"},
    "-paper-network": {"perception.sampler"},
    "-antipodal": {"perception.sampler"},
}


def test_every_ablation_changes_what_it_names_and_nothing_else():
    assert list(CHANGED) == list(ABLATIONS)
    mug = ("--objects", "mug", "--scenarios", "ReachCircular", "--seeds", "1")
    runs = planned("--study", "ablation", *mug)
    by_name = {(run.name, run.scenario.control.controller): run.scenario for run in runs}
    for controller in ("task", "joint"):
        (headline,) = planned(*mug, "--controllers", controller)
        full = vars_of(headline.scenario)
        for suffix, keys in CHANGED.items():
            scenario = by_name.pop((f"ReachCircular{suffix}", controller))
            assert {k for k, value in vars_of(scenario).items() if value != full[k]} == keys
    assert not by_name
    assert len({run.id for run in runs}) == len(runs)


def vars_of(scenario):
    sections = ("control", "perception", "reachability", "tracker", "grasp")
    return {
        f"{section}.{name}": value
        for section in sections
        for name, value in vars(getattr(scenario, section)).items()
    }


def test_beside_the_wall_the_scene_is_looked_at():
    runs = planned("--study", "obstacle")
    assert len(runs) == 2 * 3 * 3 and all(run.scenario.scene.enabled for run in runs)


def test_the_papers_test_is_slow_and_fast_in_three_modes_on_the_papers_object():
    """6 scenarios x {task, joint} x 3 modes x 5 seeds, three laps each."""
    runs = planned("--study", "paper")
    assert len({run.id for run in runs}) == len(runs) == 6 * 2 * 3 * 5
    assert {run.object_name for run in runs} == {"duck"}
    for run in runs:
        rate = 1.2 if run.name.endswith("Fast") else 0.3
        assert run.scenario.motion.rate == pytest.approx(rate)
        assert run.scenario.simulation_duration == pytest.approx(3 * 2 * np.pi / rate)


def test_the_papers_object_has_the_papers_size():
    (name,) = STUDIES["paper"].objects.split(",")
    size = np.ptp(load_object(name).vertices, axis=0)
    np.testing.assert_allclose(np.sort(size), [0.041, 0.054, 0.058], atol=0.0015)


def test_options_change_every_study():
    runs = planned("--scenarios", "PaperLinear,ReachLinearMocap", "--mode", "paper", "--seeds", "1",
                   "--objects", "mug", "--controllers", "joint")  # fmt: skip
    assert [run.id for run in runs] == [
        "PaperLinear-mug-joint-paper-0",
        "ReachLinearMocap-mug-joint-paper-0",
    ]
    runs = planned("--study", "ideal", "--scenarios", "ReachLinearMocap", "--objects", "mug")
    assert [run.id for run in runs] == [
        "ReachLinearMocap-ideal-mug-task-safe-0",
        "ReachLinearMocap-ideal-mug-joint-safe-0",
    ]


def test_a_quick_study_is_short():
    assert len(planned("--quick")) == 3 * 2
    follows = planned("--quick", "--scenarios", "PaperLinear", "--mode", "safe")
    assert len(follows) == 2
    assert all(run.scenario.simulation_duration <= 10.0 for run in follows)


def test_the_test_split_has_objects_and_seeds_that_nothing_was_tuned_on(tmp_path):
    out = ("--out", str(tmp_path))
    runs = planned("--split", "test", "--scenarios", "ReachLinearMocap", *out)
    names = list(dict.fromkeys(run.object_name for run in runs))
    assert len(names) == 24 and len({run.id for run in runs}) == len(runs) == 24 * 2
    assert {name.split("_")[1] for name in names} == set(HELD_OUT)
    # Every object has its own seed, the same for both controllers.
    seeds = {run.object_name: run.scenario.random_seed for run in runs}
    assert sorted(seeds.values()) == list(range(500, 524))
    # What is loaded is what the generator makes, its mass included.
    run = runs[2]
    made = make_shape("mug", FIRST_TEST_SEED)
    assert run.object_name == "test_mug_0"
    loaded = load_scenario_object(run.scenario)
    assert loaded.mass == pytest.approx(made.mass)
    np.testing.assert_allclose(loaded.extents, made.extents, atol=1e-4)
    # No seed that trains, validates, calibrates or develops comes near.
    assert FIRST_TEST_SEED > fit_certainty.FIRST_SEED + 1_000_000 > FIRST_SEED


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--split", "test", "--objects", "builtin"), "leave --objects away"),
        (("--split", "test", "--seed", "3"), "those from 500 on"),
        (("--split", "test", "--study", "paper"), "paper's object"),
        (("--seed", "499"), "seed 500 belongs to the test split"),
        (("--seed", "700", "--split", "development"), "belongs to the test split"),
    ],
)
def test_what_does_not_belong_to_a_split_is_refused(arguments, told, tmp_path, capsys):
    assert cli.main(["evaluate", "dynamic", "--out", str(tmp_path), *arguments]) == 2
    assert told in capsys.readouterr().err
