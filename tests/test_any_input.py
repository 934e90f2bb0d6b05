"""Whatever a file or an option holds, it is read whole or refused."""

import json
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis.extra import numpy as arrays

from feasigrasp import cli
from feasigrasp.errors import (
    FeasigraspError,
    InputError,
    MeshError,
    PointCloudError,
    ReachabilityError,
)
from feasigrasp.inputs import read_arrays, read_json
from feasigrasp.models.clouds.files import read_cloud
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.weights_file import WEIGHTS, WeightsError, WeightsFormat
from feasigrasp.runs.run import crash_record
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab import WEIGHTS as LAB_WEIGHTS
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.report.markdown_report import ReportError, sections
from feasigrasp_lab.results.arguments import names, select_objects
from feasigrasp_lab.results.finished import read_finished
from feasigrasp_lab.runs import isolated
from feasigrasp_lab.runs.plan import PlannedRun
from feasigrasp_lab.runs.summary import summary_rows

QUICK = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@settings(QUICK, max_examples=20)
@given(st.data())
def test_a_damaged_record_is_run_again(tmp_path, data):
    def fake(scenario, name, filename, *, replay=None):
        record = crash_record(scenario, name, "") | {"error": None}
        record["timings"] = dict.fromkeys(record["timings"], 1.0)
        return record

    planned = PlannedRun("Mine", "ball", Scenario())
    whole = fake(planned.scenario, "Mine", None)
    damaged = data.draw(
        st.sampled_from(sorted(whole)).flatmap(lambda key: JSON.map(lambda of: whole | {key: of}))
        | st.sampled_from(sorted(whole)).map(lambda key: {k: whole[k] for k in whole if k != key})
        | JSON
    )
    (tmp_path / f"{planned.id}.json").write_text(json.dumps(damaged))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(isolated, "run_isolated", fake)
        (record,) = isolated.run_all([planned], tmp_path, 1, desc="test")
    assert record.keys() >= whole.keys() and record["metrics"].keys() == whole["metrics"].keys()
    assert summary_rows([record])


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5),
    lambda of: st.lists(of, max_size=3) | st.dictionaries(st.text(max_size=5), of, max_size=3),
    max_leaves=8,
)


@QUICK
@given(st.binary(max_size=200) | JSON.map(lambda of: json.dumps(of).encode()))
def test_any_file_is_json_or_refused(tmp_path, content):
    file = tmp_path / "a.json"
    file.write_bytes(content)
    try:
        read_json(file)
    except InputError as error:
        assert "a.json" in str(error)
    assert read_finished(file, {"key": {"seed": 0}}) is None


ROW = {"name": "a", "preset": "b", "value": 1.0, "low": None, "high": None, "unit": "m", "n": 1}
SUMMARY = {"command": "x", "git": "y", "seed": 0, "versions": {}, "rows": [ROW]}


@QUICK
@given(
    JSON
    | st.tuples(st.sampled_from(sorted(SUMMARY)), JSON).map(lambda kv: SUMMARY | {kv[0]: kv[1]})
    | st.tuples(st.sampled_from(sorted(ROW)), JSON).map(
        lambda kv: SUMMARY | {"rows": [ROW | {kv[0]: kv[1]}]}
    )
)
def test_any_summary_is_reported_or_refused(tmp_path, summary):
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    try:
        assert sections(tmp_path)
    except ReportError as error:
        assert "summary.json is no summary" in str(error)


def test_a_cut_off_summary_is_refused_in_one_line(tmp_path, capsys):
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY)[:-20])
    assert cli.main(["report", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error:") and said.count("\n") == 1 and "repeat the command" in said


@QUICK
@given(st.data())
def test_any_damage_of_an_npz_file_is_refused(tmp_path, data):
    file, whole = tmp_path / "a.npz", tmp_path / "whole.npz"
    np.savez_compressed(whole, points=np.arange(60.0).reshape(20, 3), header=np.array("{}"))
    content = bytearray(whole.read_bytes())
    cut = data.draw(st.integers(0, len(content)))
    where = data.draw(st.lists(st.integers(0, max(cut - 1, 0)), max_size=4))
    content = content[:cut]
    for i in where if cut else ():
        content[i] = data.draw(st.integers(0, 255))
    file.write_bytes(content)
    format_ = WeightsFormat("test", "test-1", "feasigrasp train test")
    for read, error in (
        (read_arrays, InputError),
        (read_cloud, PointCloudError),
        (ReachableSpace.load, ReachabilityError),
        (lambda path: format_.load(path, lambda header, of: of), WeightsError),
    ):
        try:
            read(file)
        except error as refused:
            assert "a.npz" in str(refused)


@pytest.mark.parametrize("path", [*WEIGHTS.glob("*.npz"), *LAB_WEIGHTS.glob("*.npz")])
def test_shipped_files_that_are_cut_off_are_refused(path, tmp_path):
    content = path.read_bytes()
    for size in (0, 10, len(content) // 2, len(content) - 1):
        (tmp_path / path.name).write_bytes(content[:size])
        with pytest.raises(InputError, match="no whole npz"):
            read_arrays(tmp_path / path.name)


CLOUD_ARRAYS = arrays.arrays(
    st.sampled_from([np.float64, np.float32, np.int16, np.bool_, np.complex128, "U3"]),
    arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=7),
)


@QUICK
@given(st.sampled_from([".npy", ".npz", ".ply", ".pcd", ".xyz"]), st.binary(max_size=80))
def test_any_bytes_are_a_cloud_or_refused(tmp_path, suffix, content):
    file = tmp_path / f"a{suffix}"
    heads = {
        ".ply": b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n",
        ".pcd": b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nDATA ascii\n",
        ".npy": b"\x93NUMPY\x01\x00",
    }
    file.write_bytes(heads.get(suffix, b"") * (len(content) % 2) + content)
    check_cloud(file)


@QUICK
@given(CLOUD_ARRAYS, st.booleans())
def test_any_array_is_a_cloud_or_refused(tmp_path, array, named):
    file = tmp_path / ("a.npz" if named else "a.npy")
    (np.savez(file, points=array) if named else np.save(file, array))
    check_cloud(file)


def check_cloud(file):
    try:
        points = read_cloud(file)
    except PointCloudError as error:
        assert file.name in str(error)
    else:
        assert points.ndim == 2 and points.shape[1] == 3 and np.isfinite(points).all()


@QUICK
@given(
    st.sampled_from([".obj", ".ply", ".stl", ".off", ".glb", ".3mf", ".dae"]),
    st.binary(max_size=99),
)
def test_any_bytes_are_a_mesh_or_refused(tmp_path, suffix, content):
    file = tmp_path / f"a{suffix}"
    heads = {
        ".obj": b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n",
        ".off": b"OFF\n3 1 0\n0 0 0\n0.1 0 0\n0 0.1 0\n3 0 1 2\n",
        ".ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n",
        ".stl": b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n",
    }
    file.write_bytes(heads.get(suffix, b"") * (len(content) % 2) + content)
    with pytest.raises(MeshError, match="a" + suffix):
        load_object(file)


COORDINATES = st.sampled_from([0.0, 0.05, -0.05, 0.1, 1e-9, 0.03, np.nan])


@QUICK
@given(
    arrays.arrays(float, (6, 3), elements=COORDINATES),
    arrays.arrays(int, st.integers(1, 12).map(lambda n: (n, 3)), elements=st.integers(0, 5)),
)
def test_any_triangles_are_a_solid_or_refused(tmp_path, vertices, faces):
    file = tmp_path / "a.off"
    trimesh.Trimesh(vertices, faces, process=False).export(file)
    try:
        obj = load_object(file)
    except MeshError as error:
        assert "a.off" in str(error)
    else:
        assert obj.mesh.is_watertight and obj.mass > 0.0
        assert (np.linalg.eigvalsh(obj.inertia) > 0.0).all()


@QUICK
@given(
    st.text(max_size=30) | st.lists(st.sampled_from(["mug", "ball", "", " ", "."])).map(",".join)
)
def test_any_selection_of_objects_is_one_or_refused(selection):
    try:
        selected = select_objects(selection)
    except FeasigraspError:
        return
    assert selected and list(selected) == list(dict.fromkeys(selected))
    assert set(names(selection)) >= set(selected.values()) or Path(selection).is_dir()
