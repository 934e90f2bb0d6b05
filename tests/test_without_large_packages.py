"""What works where torch and open3d are not installed, and what says that it needs them."""

import subprocess
import sys
from pathlib import Path

import pytest

from feasigrasp.errors import LARGE_PACKAGES, MissingPackageError, needed_by

#: Runs a program as if the packages were not there.
BLOCKED = f"""
import importlib.abc, sys

class Blocked(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {LARGE_PACKAGES}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked())
"""


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", BLOCKED + code]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=200)


def feasigrasp(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return run(f"from feasigrasp.cli import main; sys.exit(main({list(arguments)}))", folder)


@pytest.mark.parametrize("sampler", ["antipodal", "network"])
def test_a_run_needs_neither(tmp_path, sampler):
    text = f"{{perception: {{sampler: {sampler}}}}}"
    done = feasigrasp(tmp_path, "run", "ReachLinear", "--duration", "0.25", "--scenario-text", text)
    assert done.returncode == 0, done.stderr


def test_grasps_are_perceived_in_a_cloud_on_a_table_without_either(tmp_path):
    code = """
import numpy as np, trimesh
from feasigrasp.cli import main

ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03).vertices + [0.0, 0.0, 0.5]
table = np.random.default_rng(0).uniform([-0.3, -0.3, 0.53], [0.3, 0.3, 0.531], (30000, 3))
points = np.concatenate([ball[ball[:, 2] < 0.5], table]).astype("<f4")
header = "FIELDS x y z\\nSIZE 4 4 4\\nTYPE F F F\\nPOINTS %d\\nDATA binary\\n" % len(points)
open("cloud.pcd", "wb").write(b"# .PCD v0.7\\n" + header.encode() + points.tobytes())
sys.exit(main(["perceive", "--cloud", "cloud.pcd", "--on-table", "--sampler", "antipodal"]))
"""
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "grasps kept" in done.stdout and (tmp_path / "out/perceive/cloud.png").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["train", "sampler"], "error: 'feasigrasp train sampler' needs torch, which is not"),
        (["perceive", "--sample", "--sampler", "paper"], "sampler 'paper' needs torch"),
        (["perceive", "--sample", "--sampler", "diffusion"], "sampler 'diffusion' needs torch"),
    ],
)
def test_what_needs_torch_says_so_in_one_line(arguments, says, tmp_path):
    done = feasigrasp(tmp_path, *arguments)
    assert done.returncode == 2
    assert says in done.stderr and "pip install torch" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_large_mesh_says_that_it_needs_open3d(tmp_path):
    code = """
import trimesh
from feasigrasp.cli import exit_status
from feasigrasp.models.objects.rigid_object import load_object

trimesh.creation.icosphere(subdivisions=5, radius=0.05).export("ball.ply")
sys.exit(exit_status(lambda: len(load_object("ball.ply").faces)))
"""
    done = run(code, tmp_path)
    assert done.returncode == 2
    assert "of 20480 faces to 4000 needs open3d" in done.stderr


def test_another_package_that_is_missing_is_no_matter_of_these():
    with pytest.raises(ModuleNotFoundError, match="no_such_package"), needed_by("something"):
        __import__("no_such_package")
    assert issubclass(MissingPackageError, ImportError)
