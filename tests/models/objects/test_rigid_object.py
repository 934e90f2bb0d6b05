"""Rigid objects: mass properties against closed forms, the built-in set, the YCB layout."""

import copy
import json

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from feasigrasp.models.objects.rigid_object import (
    DEFAULT_DENSITY,
    builtin_objects,
    find_objects,
    load_object,
    write_mesh,
)


def export(mesh, path):
    mesh.export(path)
    return path


def ray_crossings(obj, xy):
    """Heights at which vertical lines cross the surface, per line: an integrator of its own."""
    a, b, c = (obj.vertices[obj.faces][:, k] for k in range(3))
    crossings = [[] for _ in xy]
    for p0, p1, p2 in zip(a, b, c, strict=True):
        area = (p1[0] - p0[0]) * (p2[1] - p0[1]) - (p1[1] - p0[1]) * (p2[0] - p0[0])
        if area == 0:
            continue
        s = ((xy[:, 0] - p0[0]) * (p2[1] - p0[1]) - (xy[:, 1] - p0[1]) * (p2[0] - p0[0])) / area
        t = ((p1[0] - p0[0]) * (xy[:, 1] - p0[1]) - (p1[1] - p0[1]) * (xy[:, 0] - p0[0])) / area
        for i in np.flatnonzero((s >= 0) & (t >= 0) & (s + t <= 1)):
            crossings[i].append(p0[2] + s[i] * (p1[2] - p0[2]) + t[i] * (p2[2] - p0[2]))
    return [np.sort(z) for z in crossings]


# ---------------------------------------------------------------- mass, centre of mass, inertia


def test_box_anywhere_has_the_closed_form(tmp_path):
    size, mass, center = np.array([0.06, 0.04, 0.1]), 0.7, np.array([0.3, -0.2, 0.05])
    R = Rotation.from_euler("xyz", [0.3, -0.8, 1.1]).as_matrix()
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, center
    path = export(trimesh.creation.box(size, X), tmp_path / "box.ply")
    obj = load_object(path, mass=mass)
    principal = mass / 12 * ((size**2).sum() - size**2)
    np.testing.assert_allclose(obj.p_MO, center, atol=1e-7)
    np.testing.assert_allclose(obj.inertia, R @ np.diag(principal) @ R.T, rtol=1e-5, atol=1e-9)


def test_cylinder_and_sphere_have_their_closed_forms(tmp_path):
    r, h, n = 0.03, 0.11, 256
    path = export(trimesh.creation.cylinder(r, h, sections=n), tmp_path / "cylinder.stl")
    obj = load_object(path, density=800.0)
    volume = np.pi * r**2 * h
    axial, lateral = r**2 / 2, (3 * r**2 + h**2) / 12
    assert obj.mass == pytest.approx(800 * volume, rel=2e-4)
    expected = obj.mass * np.diag([lateral, lateral, axial])
    np.testing.assert_allclose(obj.inertia, expected, rtol=5e-4, atol=1e-9)

    path = export(trimesh.creation.icosphere(subdivisions=3, radius=r), tmp_path / "sphere.obj")
    obj = load_object(path)
    assert obj.mass == pytest.approx(DEFAULT_DENSITY * 4 / 3 * np.pi * r**3, rel=0.01)
    np.testing.assert_allclose(obj.inertia, 0.4 * obj.mass * r**2 * np.eye(3), rtol=0.01, atol=1e-9)


@pytest.mark.parametrize("name", ["mug", "hammer"])
def test_hollow_and_compound_bodies_match_integration_along_lines(name):
    obj = load_object(name)
    low, high, n = obj.vertices.min(axis=0), obj.vertices.max(axis=0), 150
    step = (high - low)[:2] / n
    axes = [low[k] + (np.arange(n) + 0.5) * step[k] for k in range(2)]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for (x, y), z in zip(xy, ray_crossings(obj, xy), strict=True):
        if len(z) % 2:
            continue  # a line through an edge; rare
        for z0, z1 in zip(z[::2], z[1::2], strict=True):
            m0, m1, m2 = z1 - z0, (z1**2 - z0**2) / 2, (z1**3 - z0**3) / 3
            volume += m0
            first += [x * m0, y * m0, m1]
            second += [
                [x * x * m0, x * y * m0, x * m1],
                [x * y * m0, y * y * m0, y * m1],
                [x * m1, y * m1, m2],
            ]
    second += np.diag([*step**2 / 12, 0]) * volume  # the columns' own spread
    expected = (np.trace(second) * np.eye(3) - second) * obj.mass / volume
    assert obj.mesh.volume == pytest.approx(volume * step.prod(), rel=0.01)
    np.testing.assert_allclose(first / volume, 0, atol=2e-4)  # O is the centre of mass
    np.testing.assert_allclose(obj.inertia, expected, atol=0.01 * np.trace(expected))


def test_mass_comes_from_the_argument_then_density_then_catalogue():
    known = load_object("box")
    assert known.mass == pytest.approx(0.45)
    assert load_object("box", mass=0.2).mass == 0.2
    by_density = load_object("box", density=500.0)
    assert by_density.mass == pytest.approx(500 * known.mesh.volume)
    np.testing.assert_allclose(by_density.inertia / by_density.mass, known.inertia / known.mass)


def test_scale_keeps_the_density():
    full, half = load_object("hammer"), load_object("hammer", scale=0.5)
    np.testing.assert_allclose(half.vertices, full.vertices / 2, atol=1e-12)
    np.testing.assert_allclose(half.p_MO, full.p_MO / 2, atol=1e-12)
    assert half.mass == pytest.approx(full.mass / 8)
    np.testing.assert_allclose(half.inertia, full.inertia / 32)


# ---------------------------------------------------------------- the value itself


def test_is_read_only_and_copies_to_itself():
    obj = load_object("ball")
    assert copy.deepcopy(obj) is obj
    for array in (obj.vertices, obj.faces, obj.p_MO, obj.inertia):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_written_mesh_is_centred_closed_and_has_outward_unit_normals(tmp_path):
    obj = load_object("mug")
    write_mesh(obj, tmp_path / "mug.obj")
    again = load_object(tmp_path / "mug.obj", mass=obj.mass)
    np.testing.assert_allclose(again.p_MO, 0, atol=1e-6)
    np.testing.assert_allclose(again.vertices, obj.vertices, atol=2e-6)
    assert again.notes == ()
    words = [line.split() for line in (tmp_path / "mug.obj").read_text().splitlines()]
    normals = np.array([w[1:] for w in words if w[0] == "vn"], dtype=float)
    corners = [[c.split("//") for c in w[1:]] for w in words if w[0] == "f"]
    used = normals[np.array([[int(n) - 1 for _, n in face] for face in corners])]
    np.testing.assert_allclose(np.linalg.norm(used, axis=-1), 1, atol=2e-3)
    along = np.einsum("ijk,ik->ij", used, obj.mesh.face_normals)
    assert along.min() > 0.5  # smooth within a face, never across a crease


# ---------------------------------------------------------------- the built-in objects


def test_there_are_enough_builtin_objects_in_a_small_folder():
    assert len(builtin_objects()) >= 14
    assert {"box", "mug", "bowl", "banana", "hammer", "drill", "duck"} <= set(builtin_objects())


@pytest.mark.parametrize("name", builtin_objects())
def test_builtin_object_is_one_closed_graspable_solid(name):
    obj = load_object(name)
    mesh = obj.mesh
    assert obj.name == name
    assert obj.notes == ()  # nothing to repair
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert 500 <= len(obj.faces) <= 3500
    assert 0.03 <= pdist(obj.vertices[ConvexHull(obj.vertices).vertices]).max() <= 0.30
    assert np.sort(obj.extents)[0] <= 0.08  # at least one side fits an 85 mm gripper
    assert 0.05 <= obj.mass <= 0.6
    assert 200 < obj.mass / mesh.volume < 8000
    np.testing.assert_allclose(mesh.center_mass, 0, atol=1e-7)


@pytest.mark.parametrize(("name", "cup"), [("mug", 0.5), ("bowl", 0.4), ("cup", 0.4)])
def test_hollow_objects_are_hollow(name, cup):
    mesh = load_object(name).mesh
    assert mesh.volume < cup * mesh.convex_hull.volume


def test_duck_has_the_size_of_the_papers():
    np.testing.assert_allclose(load_object("duck").extents, [0.058, 0.041, 0.054], atol=2e-6)


# ---------------------------------------------------------------- folders


def test_folder_of_meshes_is_loaded_in_order(tmp_path):
    export(trimesh.creation.box([0.05] * 3), tmp_path / "b.stl")
    export(trimesh.creation.icosphere(radius=0.03), tmp_path / "a.ply")
    (tmp_path / "readme.txt").write_text("not a mesh")
    assert [o.name for o in map(load_object, find_objects(tmp_path).values())] == ["a", "b"]


def test_catalogue_beside_the_meshes_folder_gives_the_masses(tmp_path):
    (tmp_path / "meshes").mkdir()
    path = export(trimesh.creation.box([0.05] * 3), tmp_path / "meshes" / "cube.obj")
    entry = {"name": "cube", "mesh": "meshes/cube.obj", "mass_kg": 0.321}
    (tmp_path / "any.json").write_text(json.dumps({"objects": [entry]}))
    (tmp_path / "a_broken.json").write_text("{")
    for obj in (
        load_object(path),
        load_object(tmp_path / "cube"),
        *map(load_object, find_objects(tmp_path).values()),
    ):
        assert (obj.name, obj.mass) == ("cube", 0.321)


def test_ycb_objects_load_with_their_masses_and_inertias(shared_data):
    ycb = shared_data / "ycb"
    listed = {e["name"]: e for e in json.loads((ycb / "ycb.json").read_text())["objects"]}
    objects = [load_object(path) for path in find_objects(ycb).values()]
    assert [o.name for o in objects] == sorted(listed)
    for obj in objects:
        entry = listed[obj.name]
        assert obj.mass == entry["mass_kg"], obj.name
        assert obj.mesh.is_watertight, obj.name
        assert len(obj.faces) <= 4000, obj.name
        np.testing.assert_allclose(obj.p_MO, entry["com_m"], atol=1e-4, err_msg=obj.name)
        expected = np.array(entry["inertia_com_kgm2"])
        np.testing.assert_allclose(
            obj.inertia, expected, atol=1e-3 * np.trace(expected), err_msg=obj.name
        )
