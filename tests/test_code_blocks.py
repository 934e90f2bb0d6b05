"""Every block of Python in README and docs runs, in an empty folder."""

import re
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import yaml
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_company, make_motion
from feasigrasp.systems.rmm_task_controller import RMMTaskController

REPOSITORY = Path(__file__).resolve().parent.parent
PAGES = [
    page
    for page in [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
    # Its blocks are whole scripts, which `test_examples.py` runs.
    if page.name != "examples.md" and "```python" in page.read_text()
]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)


@pytest.fixture
def given(tmp_path, monkeypatch):
    """Names that the pages take as given: a robot's state, a field, a scenario, a cloud's file."""
    monkeypatch.chdir(tmp_path)
    mug = load_object("mug").mesh
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(mug.sample(20_000, seed=0)))
    _, seen = cloud.hidden_point_removal([0.3, -0.35, 0.25], radius=50.0)
    cloud = cloud.select_by_index(seen).translate([-0.3, 0.35, -0.25])  # from the camera
    o3d.io.write_point_cloud("mug.ply", cloud)
    gripper, q = ParallelGripper(), np.array([0.1, -0.8, 0.2, -1.5, 0.1, 1.4, 0.0])
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap")
    scenario.simulation_duration = 0.1
    field = fit_gpdf(mug.sample(400, seed=0))
    return {
        "DiagramBuilder": DiagramBuilder,
        "LogVectorOutput": LogVectorOutput,
        "MyController": RMMTaskController,
        "Reachability": Reachability,
        "Simulator": Simulator,
        "J": pose_and_jacobian(q, gripper.X_FG)[1],
        "V": np.zeros(6),
        "X_WF": forward_kinematics(q)[None],
        "field": field,
        "gpdf": field,
        "grid": None,
        "gripper": gripper,
        "my_sampler": AntipodalSampler(),
        "q": q,
        "qd_last": np.zeros(7),
        "qd_preferred": np.ones(7),
        "reachability": Reachability(gripper),
        "scenario": scenario,
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_the_code_of_a_page_runs(page, given, capsys):
    for number, code in enumerate(blocks(page, "python")):
        exec(compile(code, f"{page.name}, block {number}", "exec"), given)
    if page.name == "README.md":
        assert len(given["grasps"]) > 0
        assert "grasps; dropped" in capsys.readouterr().out
    if page.name == "safety.md":
        assert given["qd"].shape == (7,) and np.any(given["qd"] != 0.0)


def test_scenario_of_the_page_is_valid(tmp_path):
    file = tmp_path / "own.scenarios.yaml"
    text, beside = blocks(REPOSITORY / "docs" / "scenarios.md", "yaml")
    file.write_text(text)
    (name,) = yaml.load(text, Loader=yaml.BaseLoader)
    scenario = load_scenario(file, name)
    motion = make_motion(scenario)
    assert motion.pose(0.0)[:3, 3] == pytest.approx([0.5, 0.0, 0.55])
    assert scenario.object.model == "mug"
    depth = "perception: {segmentation: depth}"
    seen = make_company(load_scenario(file, name, f"{beside}\n{depth}"), load_object("mug"), motion)
    assert [body.name for body in seen] == ["carrier", "distractor"]
