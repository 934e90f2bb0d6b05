"""The model files are found in a checkout and in a wheel's layout."""

import pytest

from feasigrasp import resources
from feasigrasp.resources import ResourceError, diagram_path, model_path


def test_finds_an_object_and_the_folder():
    assert model_path("objects", "mug.obj").is_file()
    assert model_path().is_dir()
    assert diagram_path("dynamic.scenarios.yaml").is_file()


def test_the_wheels_folder_comes_first(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "feasigrasp"
    (package / "_models" / "objects").mkdir(parents=True)
    (package.parent / "models" / "objects").mkdir(parents=True)
    monkeypatch.setattr(resources, "_PACKAGE", package)
    assert model_path("objects") == package / "_models" / "objects"
    (package / "_diagrams").mkdir()
    assert diagram_path() == package / "_diagrams"


def test_missing_file_names_its_neighbours():
    with pytest.raises(ResourceError, match=r"objects/teapot\.obj is not in .*mug\.obj"):
        model_path("objects", "teapot.obj")


def test_installation_without_models_says_where_it_looked(tmp_path, monkeypatch):
    monkeypatch.setattr(resources, "_PACKAGE", tmp_path / "feasigrasp")
    with pytest.raises(ResourceError, match="neither at .*_models .* nor at .*models .*reinstall"):
        model_path("objects")
