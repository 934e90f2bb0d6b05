"""What is repaired in a mesh file, and what is refused with a mend."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from feasigrasp.errors import MeshError
from feasigrasp.models.objects import mesh as mesh_module
from feasigrasp.models.objects.mesh import decimate_within
from feasigrasp.models.objects.rigid_object import builtin_objects, find_objects, load_object
from feasigrasp_lab.training.data.raycasting import Raycaster


def box(center=(0, 0, 0), size=0.05):
    mesh = trimesh.creation.box([size] * 3)
    mesh.apply_translation(center)
    return mesh


def save(mesh, path):
    mesh.export(path)
    return path


def with_faces(mesh, faces):
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


# ---------------------------------------------------------------- repaired


def test_inconsistent_winding_is_fixed(tmp_path):
    faces = box().faces.copy()
    faces[::3] = faces[::3, ::-1]
    obj = load_object(save(with_faces(box(), faces), tmp_path / "mixed.ply"))
    assert obj.mesh.is_winding_consistent
    assert obj.mesh.volume == pytest.approx(0.05**3)
    assert "winding made consistent" in obj.notes


def test_inside_out_mesh_is_turned(tmp_path):
    path = save(with_faces(box(), box().faces[:, ::-1]), tmp_path / "inverted.ply")
    obj = load_object(path)
    assert obj.mesh.volume == pytest.approx(0.05**3)
    assert obj.notes == ("normals turned outward",)


def test_split_vertices_are_merged(tmp_path):
    soup = box()
    soup.unmerge_vertices()
    obj = load_object(save(soup, tmp_path / "soup.ply"))
    assert obj.vertices.shape == (8, 3)


def hollow(size):
    """The wall of a cavity, whose normals point into it."""
    wall = box(size=size)
    wall.invert()
    return wall


@pytest.mark.parametrize("inside_out", [False, True])
def test_inner_surface_wound_against_the_outer_one_is_a_cavity(tmp_path, inside_out):
    shell = trimesh.util.concatenate([box(), hollow(0.03)])
    if inside_out:
        shell.invert()
    obj = load_object(save(shell, tmp_path / "shell.ply"), density=1000.0)
    assert obj.notes == (("normals turned outward",) if inside_out else ())
    assert obj.mass == pytest.approx(1000 * (0.05**3 - 0.03**3))
    expected = 1000 * (0.05**5 - 0.03**5) / 6 * np.eye(3)
    np.testing.assert_allclose(obj.inertia, expected, atol=1e-9)


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_solid_core_is_dropped_and_said(tmp_path, inside_out):
    both = trimesh.util.concatenate([box(), box(size=0.03)])
    if inside_out:
        both.invert()
    obj = load_object(save(both, tmp_path / "core.obj"), density=1000.0)
    assert obj.mass == pytest.approx(1000 * 0.05**3)
    assert obj.notes[-1].startswith("dropped a solid core inside the object")
    assert ("normals turned outward" in obj.notes) == inside_out


def test_large_mesh_is_decimated_and_stays_closed(tmp_path):
    fine = trimesh.creation.icosphere(subdivisions=5, radius=0.04)  # 20480 faces
    obj = load_object(save(fine, tmp_path / "fine.ply"), mass=0.1)
    assert len(obj.faces) <= 4000
    assert obj.mesh.is_watertight
    assert obj.notes == (f"decimated from 20480 faces to {len(obj.faces)}",)
    radius = np.linalg.norm(obj.vertices, axis=1)
    np.testing.assert_allclose(radius, 0.04, rtol=0.01)


def test_mesh_that_decimation_would_ruin_is_kept(tmp_path):
    rng = np.random.default_rng(1)
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.04)
    spikes = 1 - 0.9 * rng.random(len(sphere.vertices)) ** 2  # no 4000 faces can follow this
    rough = trimesh.Trimesh(sphere.vertices * spikes[:, None], sphere.faces, process=False)
    obj = load_object(save(rough, tmp_path / "rough.ply"))
    assert len(obj.faces) == 20480
    assert obj.notes[0].startswith("kept all 20480 faces")


@pytest.mark.parametrize(
    ("offset", "volume"),
    [
        ((0.02, 0.01, 0.01), 2 * 0.05**3 - 0.03 * 0.04 * 0.04),
        ((0.05, 0.01, 0.01), 2 * 0.05**3),
        ((0.05, 0.0, 0.0), 2 * 0.05**3),
    ],
    ids=["overlapping", "touching", "sharing a face"],
)
def test_bodies_that_meet_are_united(tmp_path, offset, volume):
    two = trimesh.util.concatenate([box(), box(offset)])
    obj = load_object(save(two, tmp_path / "two.ply"), density=1000.0)
    assert obj.notes == ("united bodies that touch or overlap",)
    assert obj.mesh.is_watertight and obj.mesh.body_count == 1
    assert obj.mass == pytest.approx(1000.0 * volume)
    np.testing.assert_allclose(obj.p_MO, np.array(offset) / 2, atol=1e-12)
    if offset == (0.05, 0.0, 0.0):  # a box of 10 x 5 x 5 cm
        a, b = obj.mass / 12 * (0.1**2 + 0.05**2), obj.mass / 12 * (2 * 0.05**2)
        np.testing.assert_allclose(obj.inertia, np.diag([b, a, a]), atol=1e-12)


def test_a_cavity_stays_one_when_its_body_is_united(tmp_path):
    three = trimesh.util.concatenate([box(), box((0.04, 0.0, 0.0)), hollow(0.01)])
    obj = load_object(save(three, tmp_path / "three.ply"), density=1000.0)
    assert obj.mass == pytest.approx(1000.0 * (0.09 * 0.05**2 - 0.01**3))


def test_crumbs_of_a_scan_are_dropped(tmp_path):
    crumbs = [box(), box((0.06, 0, 0), 0.004), box((0, 0.06, 0), 0.006), box((0, 0.06, 0), 0.003)]
    obj = load_object(save(trimesh.util.concatenate(crumbs), tmp_path / "scan.ply"), mass=0.2)
    assert obj.notes[-1] == "dropped 2 crumbs beside the object, 0.28 cm^3"
    np.testing.assert_allclose(obj.extents, 0.05)
    np.testing.assert_allclose(obj.inertia, 0.2 * 0.05**2 / 6 * np.eye(3), atol=1e-12)


# ---------------------------------------------------------------- refused


def test_unknown_name_lists_the_builtin_objects():
    with pytest.raises(MeshError, match="'teapot' is neither a built-in") as error:
        load_object("teapot")
    assert all(name in str(error.value) for name in builtin_objects())


def test_missing_file(tmp_path):
    with pytest.raises(MeshError, match=r"gone\.obj: no such file"):
        load_object(tmp_path / "gone.obj")


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb", "xyzzy"])
def test_unreadable_file(tmp_path, suffix):
    path = tmp_path / f"noise.{suffix}"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(MeshError, match="noise.*(not readable|no faces)"):
        load_object(path)


def test_points_without_faces(tmp_path):
    path = save(trimesh.PointCloud(box().vertices), tmp_path / "points.ply")
    with pytest.raises(MeshError, match="points.ply: no faces, at most points; give a surface"):
        load_object(path)


def test_a_folder_is_no_mesh(tmp_path):
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(MeshError, match="folder.stl: a folder; give the path of a mesh"):
        load_object(tmp_path / "folder.stl")
    with pytest.raises(MeshError, match="is a folder.*FOLDER/NAME"):
        load_object(tmp_path)


def test_a_package_that_a_format_needs_is_named(tmp_path, monkeypatch):
    def load_mesh(*_, **__):
        raise ModuleNotFoundError("No module named 'lxml'", name="lxml")

    monkeypatch.setattr(trimesh, "load_mesh", load_mesh)
    (tmp_path / "a.3mf").touch()
    with pytest.raises(MeshError, match="a.3mf: .*named .lxml.*install what it needs, or"):
        load_object(tmp_path / "a.3mf")


def test_open_mesh_counts_its_open_edges(tmp_path):
    path = save(with_faces(box(), box().faces[1:]), tmp_path / "open.ply")
    with pytest.raises(MeshError, match=r"open\.ply: not watertight, 3 open edges.*fill_holes"):
        load_object(path)


def test_bodies_joined_at_an_edge_are_refused(tmp_path):
    joined = trimesh.util.concatenate([box(), box((0.05, 0.05, 0))])
    with pytest.raises(MeshError, match="0 open edges and 1 edges shared by more than two"):
        load_object(save(joined, tmp_path / "joined.ply"))


@pytest.mark.parametrize(
    ("size", "mend"),
    [
        (50.0, r"scale=0\.001 \(millimetres\).*object: \{scale"),
        (5.0, r"scale=0\.01 \(centimetres\)"),
        (1e-4, "0.1 m"),
    ],
)
def test_other_units_get_a_scale_suggested(tmp_path, size, mend):
    path = save(box(size=size), tmp_path / "units.ply")
    with pytest.raises(MeshError, match=f"units.ply: the largest side is.*{mend}"):
        load_object(path)


def test_suggested_scale_mends_a_file_in_millimetres(tmp_path):
    obj = load_object(save(box(size=50.0), tmp_path / "mm.stl"), scale=0.001)
    np.testing.assert_allclose(obj.extents, 0.05)
    assert obj.mass == pytest.approx(300 * 0.05**3)


def test_bodies_apart_are_refused(tmp_path):
    two = trimesh.util.concatenate([box(), box((0.1, 0.01, 0.01))])
    with pytest.raises(MeshError, match="2 separate bodies .*do not touch"):
        load_object(save(two, tmp_path / "two.ply"))
    # Boxes around them meet, the bodies do not.
    ring = trimesh.creation.annulus(0.04, 0.05, 0.02)
    two = trimesh.util.concatenate([ring, trimesh.creation.icosphere(radius=0.02)])
    with pytest.raises(MeshError, match="2 separate bodies .*do not touch"):
        load_object(save(two, tmp_path / "two.ply"))


def test_body_inside_a_cavity_is_a_second_body(tmp_path):
    nested = trimesh.util.concatenate([box(), hollow(0.03), box(size=0.015)])
    with pytest.raises(MeshError, match="2 separate bodies"):
        load_object(save(nested, tmp_path / "nested.ply"))


def test_folded_sheet_has_no_volume(tmp_path):
    vertices = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], dtype=float)
    sheet = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], process=False)
    with pytest.raises(MeshError, match="encloses no volume"):
        load_object(save(sheet, tmp_path / "sheet.ply"))


def test_nan_vertices(tmp_path):
    path = tmp_path / "nan.obj"
    path.write_text("v 0 0 0\nv nan 0 0\nv 0 0.1 0\nf 1 2 3\n")
    with pytest.raises(MeshError, match=r"nan\.obj: 1 vertices are NaN"):
        load_object(path)


@pytest.mark.parametrize("bad", [{"mass": 0.0}, {"mass": -1.0}, {"density": float("nan")}])
def test_mass_and_density_must_be_positive(bad):
    with pytest.raises(MeshError, match="(mass|density).*; give a finite number"):
        load_object("box", **bad)


def test_mass_and_density_exclude_each_other():
    with pytest.raises(MeshError, match="both mass"):
        load_object("box", mass=1.0, density=1.0)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("inf")])
def test_scale_must_be_positive(scale):
    with pytest.raises(MeshError, match="scale = .*above 0"):
        load_object("box", scale=scale)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass_kg": -1}, "mass_kg = -1; give a finite number of at least 0.001"),
        ({"mass_kg": 200}, "mass_kg = 200; .*at most 20"),
        ({"mass": 1}, "no key 'mass'; do you mean mass_kg?"),
        ({"material": 5}, "material is 5; give a str"),
        ({"mesh": 5}, "mesh is 5; give a str"),
        ({"color": None}, "color is None; give 4 entries"),
        ({"color": [1, 0, 0, 255]}, r"color \[3\] = 255"),
    ],
)
def test_catalogue_with_a_bad_entry(tmp_path, given, message):
    save(box(), tmp_path / "cube.obj")
    entry = {"name": "cube", "mesh": "cube.obj", "description": "a cube"}
    (tmp_path / "objects.json").write_text(json.dumps({"objects": [entry]}), encoding="utf-8-sig")
    assert load_object(tmp_path / "cube").name == "cube"
    (tmp_path / "objects.json").write_text(json.dumps({"objects": [entry | given]}))
    for read in (lambda: load_object(tmp_path / "cube.obj"), lambda: find_objects(tmp_path)):
        with pytest.raises(MeshError, match=f"objects.json: object 'cube': .*{message}"):
            read()


@pytest.mark.parametrize("text", ['{"objects": [],}', "[]", '{"objects": [{"name": "cube"}]}'])
def test_a_broken_catalogue_is_not_passed_over(tmp_path, text):
    save(box(), tmp_path / "cube.obj")
    (tmp_path / "objects.json").write_text(text)
    with pytest.raises(MeshError, match="objects.json lists no objects: .*(line 1|give)"):
        find_objects(tmp_path)


def test_a_catalogue_names_each_object_once(tmp_path):
    save(box(), tmp_path / "cube.obj")
    entry = {"name": "cube", "mesh": "cube.obj"}
    (tmp_path / "objects.json").write_text(json.dumps({"objects": [entry, entry]}))
    with pytest.raises(MeshError, match="objects.json lists two objects named 'cube'; rename one"):
        find_objects(tmp_path)


def test_an_object_has_a_color_that_there_is():
    with pytest.raises(MeshError, match="RigidObject.color"):
        replace(load_object("ball"), color=(0.0, 0.0, 0.0, 2.0))


def test_folder_without_meshes(tmp_path):
    with pytest.raises(MeshError, match="no mesh files"):
        find_objects(tmp_path)
    with pytest.raises(MeshError, match="no such folder"):
        find_objects(tmp_path / "gone")


def test_what_was_made_of_a_large_file_is_kept(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(mesh_module, "LARGE", 1000)
    path = save(trimesh.creation.icosphere(subdivisions=5, radius=0.04), tmp_path / "fine.ply")
    first = load_object(path)
    (kept,) = (tmp_path / "cache" / "feasigrasp").iterdir()
    monkeypatch.setattr(mesh_module, "read_solid", lambda *args: pytest.fail("read again"))
    again = load_object(path)
    assert again.notes == first.notes and again.mass == first.mass
    np.testing.assert_array_equal(again.vertices, first.vertices)
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(mesh_module, "LARGE", 1000)
    kept.write_bytes(kept.read_bytes()[:500])  # cut off: made anew
    np.testing.assert_array_equal(load_object(path).vertices, first.vertices)
    load_object(path, scale=0.5)  # another scale is another object
    assert len(list(kept.parent.iterdir())) == 2
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    np.testing.assert_array_equal(load_object(path).vertices, first.vertices)


@pytest.mark.parametrize("name", ["banana", "mug", "drill", "small_box"])
@pytest.mark.parametrize("tolerance", [2e-4, 5e-4, 2e-3])
def test_a_mesh_with_fewer_faces_stays_within_the_tolerance(name, tolerance):
    fine = load_object(name).mesh
    coarse = decimate_within(fine, tolerance)
    assert coarse.is_watertight and coarse.is_winding_consistent
    assert len(coarse.faces) < len(fine.faces)
    for one, other in ((coarse, fine), (fine, coarse)):
        everywhere = np.vstack([other.vertices, other.triangles_center])
        assert Raycaster(one.vertices, one.faces).distance(everywhere).max() < tolerance
