"""The reader for ACRONYM: a file made here, and the examples of the data set where present."""

import numpy as np
import pytest
import trimesh

from feasigrasp.errors import MeshError
from feasigrasp_lab.training.data.acronym import acronym_labels, read_acronym
from feasigrasp_lab.training.data.grasp_examples import object_examples

h5py = pytest.importorskip("h5py", reason="the format is h5 (train extra)")

COM, SCALE = np.array([0.02, -0.01, 0.03]), 0.001


def hand(x, z, at):
    """Pose of the hand whose pads meet 10 cm in front of it."""
    X = np.eye(4)
    X[:3, 0], X[:3, 2] = x, z
    X[:3, 1] = np.cross(z, x)
    X[:3, 3] = np.asarray(at) - 0.1 * np.asarray(z)
    return X


def write_file(folder, transforms, success):
    """A box of 4 x 6 x 10 cm, in millimetres, centre of mass at COM."""
    (folder / "grasps").mkdir()
    (folder / "meshes").mkdir()
    box = trimesh.creation.box(np.array([0.04, 0.06, 0.10]) / SCALE)
    box.apply_translation(COM / SCALE)
    box.export(folder / "meshes" / "box.obj")
    path = folder / "grasps" / "Box_1.h5"
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = np.array(transforms)
        file["grasps/qualities/flex/object_in_gripper"] = np.array(success, dtype=int)
        file["object/file"] = "meshes/box.obj"
        file["object/scale"] = SCALE
        file["object/com"] = COM
        file["object/mass"] = 0.2
        file["object/inertia"] = 1e-4 * np.eye(3)
    return path


@pytest.fixture
def recorded(tmp_path):
    down = [0, 0, -1]
    grasps = [
        hand([1, 0, 0], down, COM + [0, 0.01, 0.04]),  # across 4 cm, held
        hand([0, 1, 0], down, COM + [0, 0, 0.04]),  # across 6 cm, slipped
        hand([1, 0, 0], down, COM + [0, 0, 0.2]),  # past the box
    ]
    return read_acronym(write_file(tmp_path, grasps, [1, 0, 0]))


def test_grasps_meet_the_object(recorded):
    assert recorded.success.tolist() == [True, False, False]
    np.testing.assert_allclose(recorded.width[:2], [0.04, 0.06], atol=1e-5)
    assert np.isnan(recorded.width[2])
    np.testing.assert_allclose(recorded.X_OG[0, :3, :3] @ [0, 0, 1], [0, 0, -1])
    np.testing.assert_allclose(recorded.X_OG[0, :2, 3], [0, 0.01], atol=1e-6)
    assert 0.02 < recorded.X_OG[0, 2, 3] < 0.05
    np.testing.assert_allclose(recorded.obj.extents, [0.04, 0.06, 0.10], atol=1e-6)
    assert recorded.obj.mass == 0.2


def test_labels_come_from_grasps_that_succeeded(recorded):
    center = recorded.X_OG[0, :3, 3]
    points = np.array(
        [
            center + [0.02, 0, 0],  # one contact
            center - [0.02, 0, 0],  # the other one
            center + [0.02, 0.003, 0],  # near it
            center + [0.02, -0.02, 0],  # not near
            [0.0, 0.03, 0.035],  # contact of the grasp that slipped
        ]
    )
    normals = np.array([[1, 0, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    labels = acronym_labels(recorded, points, normals)
    assert labels.contact.tolist() == [True, True, True, False, False]
    np.testing.assert_allclose(labels.closing[:2], [[-1, 0, 0], [1, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(labels.width[:3], 0.04, atol=1e-5)
    np.testing.assert_allclose(labels.approach[0, 0], [0, 0, -1], atol=1e-9)
    assert labels.n_approaches[0] == 1
    wrong_side = acronym_labels(recorded, points[:1], -normals[:1])
    assert not wrong_side.contact.any()


def test_same_examples_as_our_own(recorded):
    made = object_examples(
        recorded.obj,
        "acronym Box",
        0,
        1,
        np.random.default_rng(0),
        lambda points, normals: acronym_labels(recorded, points, normals),
    )
    own = object_examples(recorded.obj, "box", 0, 1, np.random.default_rng(0))
    assert {k: np.shape(v) for k, v in made[0].items()} == {
        k: np.shape(v) for k, v in own[0].items()
    }
    np.testing.assert_array_equal(made[0]["points"], own[0]["points"])


def test_what_cannot_be_read_is_named(tmp_path):
    with pytest.raises(MeshError, match="no such file"):
        read_acronym(tmp_path / "none.h5")
    broken = tmp_path / "broken.h5"
    with h5py.File(broken, "w") as file:
        file["something"] = 1
    with pytest.raises(MeshError, match="not an h5 file of ACRONYM"):
        read_acronym(broken)
    path = write_file(tmp_path, [np.eye(4)], [1])
    (tmp_path / "meshes" / "box.obj").unlink()
    with pytest.raises(MeshError, match="is missing"):
        read_acronym(path)


def test_examples_of_the_data_set(shared_data):
    folder = shared_data / "acronym_examples"
    if not folder.is_dir():
        pytest.skip(f"needs ACRONYM's examples in {folder}")
    recorded = read_acronym(next((folder / "grasps").glob("Mug*.h5")))
    assert len(recorded.success) == 2000
    assert recorded.success.mean() == pytest.approx(0.645)
    # A hand that holds something has it between its pads.
    assert np.isfinite(recorded.width[recorded.success]).mean() > 0.99
    assert recorded.width[recorded.success].max() < 0.08
    volume = recorded.obj.mesh.volume
    assert volume == pytest.approx(recorded.obj.mass / 150.0, rel=1e-3)  # its density
