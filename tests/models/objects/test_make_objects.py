"""The committed objects are what their generator makes."""

import json
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import cKDTree

from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.resources import model_path


def oriented_triangles(faces):
    """Faces as a set that ignores which corner comes first, but not the winding."""
    return {tuple(np.roll(face, -int(np.argmin(face)))) for face in faces.tolist()}


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("objects")
    script = model_path("objects", "make_objects.py")
    subprocess.run([sys.executable, str(script), "--out", str(folder)], check=True, timeout=120)
    return folder


def test_catalogues_agree(generated):
    made = json.loads((generated / "objects.json").read_text())
    committed = json.loads(model_path("objects", "objects.json").read_text())
    assert made == committed


@pytest.mark.parametrize("name", builtin_objects())
def test_committed_mesh_is_the_generated_one(generated, name):
    made, committed = load_object(generated / f"{name}.obj"), load_object(name)
    assert len(made.vertices) == len(committed.vertices)
    distance, partner = cKDTree(committed.vertices + committed.p_MO).query(
        made.vertices + made.p_MO
    )
    assert distance.max() < 2e-6  # the last digit written is 1e-6 m
    assert oriented_triangles(partner[made.faces]) == oriented_triangles(committed.faces)


def test_folder_is_small():
    total = sum(p.stat().st_size for p in model_path("objects").glob("*") if p.is_file())
    assert total < 2.5e6
