"""Fixtures that more than one test folder uses."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent

os.environ.setdefault("MPLBACKEND", "Agg")


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real meshes and clouds, which the repository does not carry.

    It lies at ``../shared/data`` beside the checkout, or where FEASIGRASP_DATA says.
    """
    folder = Path(os.environ.get("FEASIGRASP_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"needs real data in {folder}; point FEASIGRASP_DATA to it to run this test")
    return folder
