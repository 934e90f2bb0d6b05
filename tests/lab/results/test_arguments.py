"""Objects that an option names."""

import pytest

from feasigrasp.errors import MeshError
from feasigrasp.models.objects.rigid_object import builtin_objects
from feasigrasp.resources import model_path
from feasigrasp_lab.results.arguments import names, select_objects


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


def test_two_files_of_one_name_are_refused_and_repeats_count_once():
    with pytest.raises(MeshError, match="a/mug.obj and mug have the same name"):
        select_objects("a/mug.obj,mug")
    assert select_objects("mug, mug") == {"mug": "mug"}
    assert names("task,joint,task") == ["task", "joint"]
