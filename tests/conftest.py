"""Fixtures that more than one test folder uses."""

import errno
import gc
import os
from contextlib import suppress
from pathlib import Path

# PyTorch for CUDA brings triton, and loads it with the first optimizer. Its LLVM ends the process
# where that of Mesa, which renders, was loaded before.
with suppress(ImportError):
    import triton  # noqa: F401

import hypothesis
import pytest

from feasigrasp import outputs

REPOSITORY = Path(__file__).resolve().parent.parent

os.environ.setdefault("MPLBACKEND", "Agg")
# Tests assert no timings.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What is imported and collected stays: no garbage collection looks for what of it is not."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


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


@pytest.fixture
def full_disk(monkeypatch):
    """A file whose name begins with ``full`` takes half of what is written to it."""

    class Full:
        def __init__(self, file):
            self.file = file

        def __enter__(self):
            return self

        def __exit__(self, *error):
            self.file.close()

        def write(self, content):
            self.file.write(content[: len(content) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    opened = Path.open

    def open_full(self, mode="r", *arguments, **options):
        file = opened(self, mode, *arguments, **options)
        return Full(file) if "w" in mode and self.name.startswith("full") else file

    monkeypatch.setattr(outputs.Path, "open", open_full)
