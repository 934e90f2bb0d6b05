"""A kernel that calls one of another file is compiled anew when that file changes."""

import subprocess
import sys

import pytest

from feasigrasp.kernel_cache import forget_stale

CALLEE = "from numba import njit\n\n@njit(cache=True)\ndef f(x):\n    return x + {}\n"
CALLER = (
    "from numba import njit\nfrom arms.inner import f\n\n"
    "@njit(cache=True)\ndef g(x):\n    return 10 * f(x)\n"
)
OTHER = "from numba import njit\n\n@njit(cache=True)\ndef h(x):\n    return -x\n"


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "arms"
    folder.mkdir()
    for name, text in {
        "__init__": "",
        "inner": CALLEE.format(1),
        "outer": CALLER,
        "other": OTHER,
    }.items():
        (folder / f"{name}.py").write_text(text)
    return folder


def called(package):
    """g(1) and h(1) in a process of their own, as after an edit."""
    code = "from arms.outer import g; from arms.other import h; print(g(1), h(1))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=package.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def names(folder):
    return sorted({file.name.split(".")[0] for file in folder.rglob("*.nbi")})


def test_an_edit_of_a_callee_counts(package):
    forget_stale(package)
    assert called(package) == ["20", "-1"]
    assert forget_stale(package) == []
    (package / "inner.py").write_text(CALLEE.format(2))
    assert called(package) == ["20", "-1"], "numba has learnt it: this module is not needed now"
    assert forget_stale(package) == ["arms/inner.py", "arms/outer.py"]
    assert names(package) == ["other"]
    assert called(package) == ["30", "-1"]
    assert forget_stale(package) == []


def test_caches_of_nobody_knows_which_sources_are_forgotten(package):
    called(package)
    assert names(package) == ["inner", "other", "outer"]
    forget_stale(package)
    assert names(package) == []


def test_a_cache_elsewhere_is_found(package, tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    forget_stale(package)
    called(package)
    assert names(cache) == ["inner", "other", "outer"] and names(package) == []
    (package / "inner.py").write_text(CALLEE.format(2))
    assert forget_stale(package) == ["arms/inner.py", "arms/outer.py"]
    assert names(cache) == ["other"]


def test_a_cache_elsewhere_leaves_the_one_beside_the_sources_alone(package, tmp_path, monkeypatch):
    forget_stale(package)
    called(package)
    beside = names(package)
    assert beside == ["inner", "other", "outer"]
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    forget_stale(package)
    assert names(package) == beside


def test_a_record_that_was_cut_off_is_no_record(package):
    forget_stale(package)
    called(package)
    record = package / "__pycache__" / "feasigrasp-sources.json"
    record.write_text(record.read_text()[:20])
    assert len(forget_stale(package)) == 4
    assert names(package) == []


def test_a_source_that_is_gone_takes_its_users_along(package):
    forget_stale(package)
    called(package)
    (package / "inner.py").unlink()
    assert forget_stale(package) == ["arms/outer.py"]
