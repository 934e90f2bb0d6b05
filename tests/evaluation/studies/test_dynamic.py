"""``feasigrasp evaluate dynamic``: what it runs, and that it goes on where it was."""

import argparse
import csv
import json

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.evaluation.protocols.ablations import ABLATIONS
from feasigrasp.evaluation.runs import isolated
from feasigrasp.evaluation.runs import run as run_module
from feasigrasp.evaluation.runs.plan import plan
from feasigrasp.evaluation.runs.run import crash_record
from feasigrasp.evaluation.runs.studies import STUDIES
from feasigrasp.evaluation.studies import dynamic
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.resources import diagram_path, model_path
from feasigrasp.results import finished, rows
from feasigrasp.results.arguments import select_objects
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.training import fit_certainty
from feasigrasp.training.data.household_shapes import HELD_OUT, make_shape
from feasigrasp.training.data.unseen_objects import FIRST_SEED, FIRST_TEST_SEED

#: Where the revision is asked for.
REVISION = (dynamic, finished, rows, run_module)


@pytest.fixture
def fake_runs(monkeypatch):
    """Replaces the simulation; gives the list of what ran."""
    ran = []

    def run(scenario, name, filename, *, replay=None):
        ran.append(filename.stem)
        made = crash_record(scenario, name, "") | {"error": None}
        made["metrics"]["grasp_held"] = scenario.random_seed % 2 == 0
        made["timings"]["wall_s"] = 1.0
        filename.write_text(json.dumps(made))
        return made

    monkeypatch.setattr(isolated, "run_isolated", run)
    # A commit while the tests run must not change what they see.
    for module in REVISION:
        monkeypatch.setattr(module, "git_revision", lambda: "57f3f21b0c4e")
    return ran


def evaluate(out, *arguments):
    arguments = ("--jobs", "1", "--objects", "mug,ball", *arguments)
    return cli.main(["evaluate", "dynamic", "--out", str(out), *arguments])


def rows_of(out):
    summary = json.loads((out / "summary.json").read_text())
    return {(row["preset"], row["name"]): row for row in summary["rows"]}


def test_it_runs_every_combination_and_sums_up(fake_runs, tmp_path):
    scenarios = ("--scenarios", "ReachLinear,PaperLinear", "--mode", "safe", "--seeds", "3")
    assert evaluate(tmp_path, *scenarios) == 0
    assert len(set(fake_runs)) == len(fake_runs) == 2 * 2 * 2 * 3
    assert "PaperLinear-ball-joint-safe-2" in fake_runs

    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {"command", "git", "seed", "versions", "machine", "rows"} <= set(summary)
    assert "--objects mug,ball" in summary["command"]
    row = rows_of(tmp_path)["all/all/safe", "dynamic.held_percent"]
    assert set(row) == {"name", "preset", "value", "low", "high", "unit", "n"}
    assert row["value"] == pytest.approx(200.0 / 3.0) and row["n"] == 24

    with (tmp_path / "runs.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 24
    assert {line["object"] for line in lines} == {"mug", "ball"}
    assert {line["grasp_held"] for line in lines} == {"True", "False"}


def test_the_seed_option_shifts_the_repeats(fake_runs, tmp_path):
    evaluate(tmp_path, "--scenarios", "ReachLinear", "--controllers", "task", "--seed", "10")
    assert sorted(fake_runs) == [
        f"ReachLinear-{o}-task-safe-{k}" for o in ("ball", "mug") for k in (10, 11, 12)
    ]


def test_quick_is_one_object_and_one_seed(fake_runs, tmp_path):
    evaluate(tmp_path, "--quick", "--study", "reach")
    assert len(fake_runs) == 3 * 2
    assert all("-mug-" in name and name.endswith("-0") for name in fake_runs)
    assert json.loads((tmp_path / "summary.json").read_text())["quick"] is True


def plan_of(*arguments):
    parser = argparse.ArgumentParser()
    dynamic.add_arguments(parser)
    return plan(parser.parse_args(arguments))


def planned(*arguments):
    return plan_of(*arguments).runs


def test_the_headline_is_all_objects_under_the_conditions_of_the_scenarios():
    """{Circular, Linear, Sinusoidal} x {task, joint} x 18 objects x 3 seeds."""
    runs = planned()
    assert len({run.id for run in runs}) == len(runs) == 3 * 2 * 18 * 3
    assert {run.object_name for run in runs} == set(builtin_objects())
    assert {run.scenario.control.mode for run in runs} == {"safe"}
    file = diagram_path("dynamic.scenarios.yaml")
    given = {name: load_scenario(file, name) for name in STUDIES["reach"].scenarios}
    for run in runs:
        own = given[run.name]
        assert run.scenario.camera_noise == own.camera_noise
        assert run.scenario.perception == own.perception
        assert run.scenario.object.friction == own.object.friction


NOISY = "{camera_noise: {wrist_camera: {}}, perception: {latency: 0.1}}"


def test_ideal_runs_have_perfect_sensors_and_names_of_their_own():
    headline = planned("--scenario_text", NOISY)
    ideal = planned("--study", "ideal", "--scenario_text", NOISY)
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


def test_every_ablation_changes_what_it_names_and_nothing_else():
    runs = planned("--study", "ablation", "--objects", "mug", "--scenarios", "ReachLinear")
    assert len({run.id for run in runs}) == len(runs) == 2 * len(ABLATIONS) - 1
    by_name = {(run.name, run.scenario.control.controller): run.scenario for run in runs}
    for controller in ("task", "joint"):
        full = vars_of(by_name["ReachLinear-full", controller])
        headline = planned("--objects", "mug", "--scenarios", "ReachLinear", "--seeds", "1",
                           "--controllers", controller)  # fmt: skip
        assert vars_of(headline[0].scenario) == full
        for suffix, key in (
            ("no-density", {"control.density"}),
            ("no-score", {"control.score"}),
            ("no-look-ahead", {"control.look_ahead", "reachability.horizon"}),
            ("no-prediction", {"control.look_ahead"}),
            ("no-feed-forward", {"control.feed_forward"}),
            ("no-hidden-side", {"perception.hidden_side"}),
            ("one-view", {"perception.views"}),
            ("paper-network", {"perception.sampler"}),
            ("antipodal", {"perception.sampler"}),
        ):
            scenario = by_name.get((f"ReachLinear-{suffix}", controller))
            if (suffix, controller) == ("no-density", "joint"):  # it has none
                assert scenario is None
                continue
            assert {k for k, value in vars_of(scenario).items() if value != full[k]} == key


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
    runs = planned("--scenarios", "PaperLinear,ReachLinear", "--mode", "paper", "--seeds", "1",
                   "--objects", "mug", "--controllers", "joint")  # fmt: skip
    assert [run.id for run in runs] == [
        "PaperLinear-mug-joint-paper-0",
        "ReachLinear-mug-joint-paper-0",
    ]
    runs = planned("--study", "ideal", "--scenarios", "ReachLinear", "--objects", "mug")
    assert [run.id for run in runs] == [
        "ReachLinear-ideal-mug-task-safe-0",
        "ReachLinear-ideal-mug-joint-safe-0",
    ]


def test_a_quick_study_is_short():
    assert len(planned("--quick")) == 3 * 2
    follows = planned("--quick", "--scenarios", "PaperLinear", "--mode", "safe")
    assert len(follows) == 2
    assert all(run.scenario.simulation_duration <= 10.0 for run in follows)


def test_the_test_split_has_objects_and_seeds_that_nothing_was_tuned_on(tmp_path):
    out = ("--out", str(tmp_path))
    runs = planned("--split", "test", "--scenarios", "ReachLinear", *out)
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
        (("--seed", "498"), "seed 500 belongs to the test split"),
        (("--seed", "700", "--split", "development"), "belongs to the test split"),
    ],
)
def test_what_does_not_belong_to_a_split_is_refused(arguments, told, tmp_path, capsys):
    assert cli.main(["evaluate", "dynamic", "--out", str(tmp_path), *arguments]) == 2
    assert told in capsys.readouterr().err


def test_a_mesh_that_cannot_be_used_is_left_out_with_the_reason(fake_runs, tmp_path, capsys):
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "good.obj").write_bytes(model_path("objects", "ball.obj").read_bytes())
    (meshes / "open.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n")
    out, scenario = tmp_path / "out", ("--scenarios", "ReachLinear", "--seeds", "1")
    assert evaluate(out, "--objects", str(meshes), *scenario) == 0
    assert {name.split("-")[1] for name in fake_runs} == {"good"}
    found = json.loads((out / "summary.json").read_text())["conditions"]
    assert found["objects"] == ["good"] and list(found["left_out"]) == ["open"]
    assert f"left out: open ({found['left_out']['open']})" in capsys.readouterr().out
    # Asked for by name, it is an error.
    assert evaluate(out, "--objects", str(meshes / "open.obj"), *scenario) == 2


def test_conditions_are_printed_and_stored(fake_runs, tmp_path, capsys):
    evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "1")
    found = json.loads((tmp_path / "summary.json").read_text())["conditions"]
    assert found["objects"] == ["mug", "ball"] and found["seeds"] == [0]
    assert "Conditions: development split" in capsys.readouterr().out


def test_finished_runs_are_not_repeated(fake_runs, tmp_path, capsys):
    arguments = ("--scenarios", "ReachLinear", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    first = rows_of(tmp_path)
    fake_runs.clear()
    evaluate(tmp_path, *arguments)
    assert fake_runs == []
    assert "4 of 4 are finished already" in capsys.readouterr().out
    assert rows_of(tmp_path) == first

    evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "2")
    assert sorted(name[-1] for name in fake_runs) == ["1"] * 4


def test_a_commit_in_the_middle_is_told(fake_runs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_module, "git_revision", lambda: "later")
    evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "1")
    assert "some runs are of later, not 57f3f21b0c4e" in capsys.readouterr().out
    assert json.loads((tmp_path / "summary.json").read_text())["git"] == "57f3f21b0c4e"


def test_uncommitted_changes_are_told(fake_runs, tmp_path, monkeypatch, capsys):
    for module in REVISION:
        monkeypatch.setattr(module, "git_revision", lambda: "57f3f21b0c4e-dirty")
    for _ in range(2):
        evaluate(tmp_path, "--scenarios", "ReachLinear", "--seeds", "1")
    assert len(fake_runs) == 4
    assert "uncommitted changes cannot be told apart" in capsys.readouterr().out


@pytest.mark.parametrize(
    "change",
    [
        {"git": "0123456789ab"},
        {"versions": {"drake": "0.1"}},
        {"scenario_yaml": "{}"},
        {"timings": {"wall_s": None}},
        None,
    ],
    ids=["revision", "versions", "scenario", "crashed", "half a file"],
)
def test_runs_of_another_state_are_repeated(fake_runs, tmp_path, capsys, change):
    arguments = ("--scenarios", "ReachLinear", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    file = tmp_path / "runs" / "ReachLinear-mug-task-safe-0.json"
    text = file.read_text()
    file.write_text(text[:40] if change is None else json.dumps(json.loads(text) | change))
    fake_runs.clear()
    evaluate(tmp_path, *arguments)
    assert fake_runs == [file.stem]
    assert "1 results are from another revision or setting, or crashed" in capsys.readouterr().out


def test_a_changed_setting_repeats_its_runs(fake_runs, tmp_path):
    arguments = ("--scenarios", "ReachLinear", "--seeds", "1")
    evaluate(tmp_path, *arguments)
    fake_runs.clear()
    evaluate(tmp_path, *arguments, "--scenario_text", "{object: {friction: 0.3}}")
    assert len(fake_runs) == 4


def test_an_interruption_keeps_what_is_finished(fake_runs, tmp_path, monkeypatch):
    run = isolated.run_isolated

    def interrupted(scenario, name, filename, **options):
        if len(fake_runs) == 3:
            raise KeyboardInterrupt
        return run(scenario, name, filename)

    monkeypatch.setattr(isolated, "run_isolated", interrupted)
    arguments = ("--scenarios", "ReachLinear", "--seeds", "2")
    assert evaluate(tmp_path, *arguments) == 130
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["partial"] is True and summary["rows"][0]["n"] <= 3
    monkeypatch.setattr(isolated, "run_isolated", run)
    assert evaluate(tmp_path, *arguments) == 0
    assert len(fake_runs) == len(set(fake_runs)) == 8
    assert "partial" not in json.loads((tmp_path / "summary.json").read_text())


def test_objects_come_from_names_files_and_folders(tmp_path):
    assert list(select_objects("builtin")) == builtin_objects()
    mug = str(model_path("objects", "mug.obj"))
    assert select_objects(f"ball, {mug}") == {"ball": "ball", "mug": mug}
    (tmp_path / "b.obj").write_bytes(model_path("objects", "ball.obj").read_bytes())
    (tmp_path / "a.obj").write_bytes(model_path("objects", "mug.obj").read_bytes())
    assert select_objects(str(tmp_path)) == {
        "a": str(tmp_path / "a.obj"),
        "b": str(tmp_path / "b.obj"),
    }


def test_objects_of_the_ycb_layout(shared_data):
    assert len(select_objects(str(shared_data / "ycb"))) == 40


def test_real_runs_in_real_processes(tmp_path):
    text = "{simulation_duration: 0.06}"
    status = evaluate(
        tmp_path, "--objects", "soup_can", "--scenarios", "ReachLinear", "--seeds", "1",
        "--jobs", "2", "--scenario_text", text,
    )  # fmt: skip
    assert status == 0
    found = rows_of(tmp_path)
    assert found["all/all/safe", "dynamic.failed_percent"]["value"] == 0.0
    assert found["all/all/safe", "dynamic.joint_limit_violation_percent"]["n"] == 2
    assert found["all/all/safe", "dynamic.held_percent"]["value"] == 0.0
