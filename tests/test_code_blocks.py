"""README and docs do what they show: blocks of Python run, commands parse, scenarios load."""

import re
import shlex
from importlib import import_module
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest
import trimesh
import yaml
from pydrake.systems.analysis import Simulator

import feasigrasp as fg
from feasigrasp import cli
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.runs.run import run
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_distractor_bodies, make_motion
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from tools.run_readme import blocks, commands

REPOSITORY = Path(__file__).resolve().parent.parent
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]


def python_of(page):
    return [text for language, text in blocks(page) if language == "python"]


@pytest.mark.parametrize("page", [p for p in PAGES if python_of(p)], ids=lambda page: page.stem)
def test_every_block_of_a_page_runs_by_itself(page, tmp_path, monkeypatch):
    """Verbatim, in an empty namespace and a folder with a user's own files.

    Runs are simulated for a second; to their end, those of README by ``tools/run_readme.py``.
    """
    monkeypatch.setattr(fg, "run", first_second)
    monkeypatch.chdir(tmp_path)
    Path("mug.ply").write_bytes(cloud_of_a_mug())
    Path("grasps.json").write_text('{"poses": [[[1, 0, 0, 0]]]}')
    for number, code in enumerate(python_of(page)):
        exec(compile(code, f"{page.name}, block {number}", "exec"), {"__name__": "__main__"})


def first_second(scenario, *arguments, **options):
    scenario.simulation_duration = min(scenario.simulation_duration, 1.0)
    return run(scenario, *arguments, **options)


def cloud_of_a_mug() -> bytes:
    """What a camera sees of a mug, as a file, in the camera's frame [m]."""
    points = load_object("mug").mesh.sample(20_000, seed=0)
    ahead = points[points[:, 1] < 0.0] @ [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    cloud = trimesh.PointCloud(ahead + [0.0, 0.0, 0.45])
    return bytes(cloud.export(file_type="ply"))


def parse(line: str) -> None:
    """Parses a command line as `cli.main` does; a wrong one exits."""
    words = shlex.split(line, comments=True)
    words = words[words.index("feasigrasp") + 1 :]
    chosen, rest = cli._make_parser().parse_known_args(words)
    assert chosen.module is not None, line
    parser = cli.command_parser(chosen.prog, chosen.description)
    import_module(chosen.module).add_arguments(parser)
    parser.parse_args(rest)


def test_every_command_parses():
    """By the parser of the command itself; YAML on the command line is that of a scenario."""
    lines = [
        line
        for page in PAGES
        for language, text in blocks(page)
        if language == ""
        for line in commands(text)
    ]
    assert len(lines) > 30
    for line in lines:
        parse(line)
        words = shlex.split(line, comments=True)
        if "--scenario-text" in words and "my_" not in line:
            load_scenario(words[words.index("run") + 1], words[words.index("--scenario-text") + 1])


def test_every_part_of_the_page_can_be_named_in_a_scenario(tmp_path, monkeypatch):
    """Each class of the page, as the file that its command names."""
    page = REPOSITORY / "docs" / "own_parts.md"
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    named = re.findall(r"\b(my_\w+):(\w+)", page.read_text())
    for module, name in named:
        (code,) = (text for text in python_of(page) if f"class {name}" in text)
        (tmp_path / f"{module}.py").write_text(code)
    assert dict(named).keys() == {"my_grasps", "my_prediction", "my_motions", "my_masks"}
    for language, text in blocks(page):
        for line in commands(text) if language == "" else []:
            words = shlex.split(line)
            make_dynamic_grasp(load_scenario(words[2], words[words.index("--scenario-text") + 1]))
    make_dynamic_grasp(load_scenario("Static", "{parts: {motion: {name: 'my_motions:Bobbing'}}}"))


def test_wrong_commands_do_not_parse():
    for wrong in ("feasigrasp run --sed 3", "feasigrasp evaluate dynamc", "feasigrasp perceiv"):
        with pytest.raises(SystemExit):
            parse(wrong)
    assert commands("feasigrasp run A \\\n  --seed 1\nA=1 feasigrasp doctor\nmake demo\n") == [
        "feasigrasp run A    --seed 1",
        "A=1 feasigrasp doctor",
    ]


@pytest.fixture(scope="module")
def examples():
    """The blocks of YAML on the page about one's own cell, by their first key."""
    page = REPOSITORY / "docs" / "own_cell.md"
    texts = [text for language, text in blocks(page) if language == "yaml"]
    return {next(iter(yaml.load(text, Loader=yaml.BaseLoader))): text for text in texts}


def test_every_scenario_of_the_page_loads(examples, tmp_path):
    file = tmp_path / "own.scenarios.yaml"
    file.write_text(examples["SlowLift"])
    scenario = load_scenario(file, "SlowLift")
    motion = make_motion(scenario)
    p_WO = np.array([motion.pose(t)[:3, 3] for t in np.linspace(0.0, 2.0 * np.pi / 0.3, 101)])
    assert np.ptp(p_WO, axis=0) == pytest.approx([0.0, 0.2, 0.1], abs=1e-3)
    assert 0.5 * (p_WO.max(axis=0) + p_WO.min(axis=0)) == pytest.approx([0.5, 0, 0.55], abs=1e-3)
    assert scenario.object.model == "mug"
    depth = "perception: {segmentation: depth}"
    around = load_scenario(file, "SlowLift", f"{examples['carrier']}\n{depth}")
    seen = make_distractor_bodies(around, load_object("mug"), motion)
    assert [body.name for body in seen] == ["carrier", "distractor"]
    second = load_scenario("ReachLinear", examples["cameras"])
    assert second.perception.second_camera in second.cameras
    assert set(examples) == {"SlowLift", "cell", "carrier", "cameras"}


def test_the_scenario_with_obstacles_runs_as_it_is_printed(examples, tmp_path):
    """A folder with the block as a file and a tray beside it, from another working directory."""
    text = examples["SlowLift"] + indent(examples["cell"], "  ")
    (tmp_path / "shelf.yaml").write_text(text)
    trimesh.creation.box((300, 200, 10)).export(tmp_path / "bin.obj")
    scenario = load_scenario(tmp_path / "shelf.yaml", "SlowLift")
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.0)
    plant, context = diagram.subsystems.station.plant, simulator.get_context()
    where = plant.GetMyContextFromRoot(context)
    for name, height in (("table_top", -0.05), ("shelf", 0.5), ("bin", -0.05)):
        X_WB = plant.GetFrameByName(name).CalcPoseInWorld(where)
        assert X_WB.translation()[2] == pytest.approx(height)
    controller = diagram.subsystems.controller
    static = controller.GetInputPort("static_obstacles")
    grid = static.Eval(controller.GetMyContextFromRoot(context))
    assert grid.distance_and_gradient([0.5, 0.4, 0.5])[0][0] < 0.0
