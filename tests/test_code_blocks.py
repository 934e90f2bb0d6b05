"""README and docs do what they show: every block of Python runs by itself, every command parses."""

import shlex
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from pydrake.systems.analysis import Simulator

from feasigrasp import cli
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.runs.results.grasps_file import write_grasps
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_company, make_motion
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from tools.run_readme import blocks, commands

REPOSITORY = Path(__file__).resolve().parent.parent
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
#: Page and number of each block of Python; those of examples.md are what `test_examples.py` runs.
SNIPPETS = [
    pytest.param(text, id=f"{page.name}-{number}")
    for page in PAGES
    if page.name != "examples.md"
    for number, (language, text) in enumerate(blocks(page))
    if language == "python"
]
COMMANDS = [
    pytest.param(line, id=f"{page.name}: {line[:60]}")
    for page in PAGES
    for language, text in blocks(page)
    if language == ""
    for line in commands(text)
]


@pytest.mark.parametrize("code", SNIPPETS)
def test_a_block_runs_by_itself(code, tmp_path, monkeypatch):
    """Verbatim, in an empty namespace and an empty folder but for a user's own files."""
    monkeypatch.chdir(tmp_path)
    if "mug.ply" in code:
        (tmp_path / "mug.ply").write_bytes(cloud_of_a_mug())
    if "grasps.json" in code:
        one = GraspSet(np.eye(4), [0.05], [0.9])
        write_grasps(tmp_path / "grasps.json", one, "camera", Path("mug.ply"))
    exec(compile(code, "block", "exec"), {"__name__": "__main__"})


def cloud_of_a_mug() -> bytes:
    """What a camera sees of a mug, as a file, in the camera's frame [m]."""
    mesh = load_object("mug").mesh
    points = mesh.sample(20_000, seed=0)
    ahead = points[points[:, 1] < 0.0] @ [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    rows = "\n".join(" ".join(f"{x:.5f}" for x in point) for point in ahead + [0.0, 0.0, 0.45])
    head = ["ply", "format ascii 1.0", f"element vertex {len(ahead)}"]
    head += [*(f"property float {axis}" for axis in "xyz"), "end_header", ""]
    return ("\n".join(head) + rows + "\n").encode()


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_parses(line):
    """By the parser of the command itself."""
    parse(line)


def parse(line: str) -> None:
    """Parses a command line as `cli.main` does; a wrong one exits."""
    words = shlex.split(line, comments=True)
    words = words[words.index("feasigrasp") + 1 :]
    chosen, rest = cli._make_parser().parse_known_args(words)
    assert chosen.module is not None, line
    parser = cli.command_parser(chosen.prog, chosen.description)
    import_module(chosen.module).add_arguments(parser)
    parser.parse_args(rest)


def test_the_checks_can_fail():
    for wrong in ("feasigrasp run --sed 3", "feasigrasp evaluate dynamc", "feasigrasp perceiv"):
        with pytest.raises(SystemExit):
            parse(wrong)
    assert commands("feasigrasp run A \\\n  --seed 1\nA=1 feasigrasp doctor\nmake demo\n") == [
        "feasigrasp run A    --seed 1",
        "A=1 feasigrasp doctor",
    ]
    assert len(SNIPPETS) > 10 and len(COMMANDS) > 50


def test_scenario_of_the_page_is_valid(tmp_path):
    file = tmp_path / "own.scenarios.yaml"
    page = REPOSITORY / "docs" / "scenarios.md"
    text, _, beside = (text for language, text in blocks(page) if language == "yaml")
    file.write_text(text)
    (name,) = yaml.load(text, Loader=yaml.BaseLoader)
    scenario = load_scenario(file, name)
    motion = make_motion(scenario)
    assert motion.pose(0.0)[:3, 3] == pytest.approx([0.5, 0.0, 0.55])
    assert scenario.object.model == "mug"
    depth = "perception: {segmentation: depth}"
    seen = make_company(load_scenario(file, name, f"{beside}\n{depth}"), load_object("mug"), motion)
    assert [body.name for body in seen] == ["carrier", "distractor"]


def test_the_scenario_with_obstacles_runs_as_it_is_printed(tmp_path):
    """A folder with the block as a file and a tray beside it, from another working directory."""
    page = REPOSITORY / "docs" / "scenarios.md"
    _, text, _ = (text for language, text in blocks(page) if language == "yaml")
    (tmp_path / "shelf.yaml").write_text(text)
    trimesh.creation.box((300, 200, 10)).export(tmp_path / "bin.obj")
    scenario = load_scenario(tmp_path / "shelf.yaml", "Shelf")
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
