"""A kernel that calls one of another file is compiled anew when that file changes."""

import ast
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

import feasigrasp
from feasigrasp.models.compiled import _source

HEAD = "from feasigrasp.models.compiled import compiled\n"
CALLEE = HEAD + "\n@compiled\ndef f(x):\n    return x + {}\n"
CALLER = HEAD + "from arms.inner import f\n\n@compiled\ndef g(x):\n    return 10 * f(x)\n"
OTHER = HEAD + "\n@compiled\ndef h(x):\n    return -x\n"


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


def called(package, callers=("outer",), **environment):
    """g(1) and h(1) in a process of their own, and how often each was loaded from the cache."""
    code = (
        "from importlib import import_module; from arms.other import h;"
        f"all = [*(import_module('arms.' + name).g for name in {callers}), h];"
        "print(*(f(1) for f in all), *(sum(f.stats.cache_hits.values()) for f in all))"
    )
    path = f"{package.parent}:{Path(feasigrasp.__file__).parents[1]}"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": path} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_an_edit_of_a_callee_counts(package):
    assert called(package) == ["20", "-1", "0", "0"]
    assert called(package) == ["20", "-1", "1", "1"]
    (package / "inner.py").write_text(CALLEE.format(2))
    assert called(package) == ["30", "-1", "0", "1"]
    assert called(package) == ["30", "-1", "1", "1"]


def test_however_it_is_imported(package):
    ways = {
        "by_module": "import arms.inner\nf = arms.inner.f\n",
        "by_package": "from arms import inner\nf = inner.f\n",
        "on_lines": "from arms.inner import (\n    f,\n)\n",
    }
    for name, text in ways.items():
        caller = CALLER.replace("from arms.inner import f\n", text)
        (package / f"{name}.py").write_text(caller)
    assert called(package, [*ways])[:4] == ["20", "20", "20", "-1"]
    (package / "inner.py").write_text(CALLEE.format(2))
    assert called(package, [*ways]) == ["30", "30", "30", "-1", "0", "0", "0", "1"]


def test_an_edit_behind_a_module_without_kernels_counts(package):
    (package / "constants.py").write_text("MORE = 1\n")
    inner = HEAD + "from arms.constants import MORE\n\n@compiled\ndef f(x):\n    return x + MORE\n"
    (package / "inner.py").write_text(inner)
    assert called(package)[:2] == ["20", "-1"]
    (package / "constants.py").write_text("MORE = 2\n")
    assert called(package) == ["30", "-1", "0", "1"]


def test_a_cache_elsewhere(package, tmp_path):
    elsewhere = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    called(package, **elsewhere)
    assert called(package, **elsewhere) == ["20", "-1", "1", "1"]
    assert not list(package.rglob("*.nbi"))
    (package / "inner.py").write_text(CALLEE.format(2))
    assert called(package, **elsewhere) == ["30", "-1", "0", "1"]


def test_a_source_that_was_only_touched_is_not_compiled_again(package):
    called(package)
    os.utime(package / "outer.py", (0, 0))
    assert called(package) == ["20", "-1", "1", "1"]


def test_a_file_that_was_cut_off_is_none(package):
    called(package)
    for suffix, kept in product(("nbi", "nbc"), (0, 20)):
        for file in package.rglob(f"*.{suffix}"):
            file.write_bytes(file.read_bytes()[:kept])
        assert called(package) == ["20", "-1", "0", "0"], (suffix, kept)
        assert called(package) == ["20", "-1", "1", "1"], (suffix, kept)


def test_a_type_that_has_moved_is_no_obstacle(package):
    """The index of a function names the types that it was compiled for."""
    pair = "from typing import NamedTuple\n\nclass Pair(NamedTuple):\n    a: int\n    b: int\n"
    take = HEAD + "\n@compiled\ndef take(pair):\n    return pair.a + pair.b\n"
    (package / "inner.py").write_text(take)
    call = (
        "from arms.inner import take\nfrom arms.{} import Pair\n\n"
        "def g(x):\n    return take(Pair(x, 1))\n"
    )
    for name in ("one", "other_one"):
        (package / f"{name}.py").write_text(pair)
        (package / "outer.py").write_text(call.format(name) + "\ng.stats = take.stats\n")
        assert called(package)[:2] == ["2", "-1"]
        (package / f"{name}.py").unlink()


def test_all_imports_of_the_package_are_found():
    """By syntax trees: those behind comments, in functions and over several lines, too."""
    root = Path(feasigrasp.__file__).parents[1]
    for file in (*root.glob("feasigrasp/**/*.py"), *root.glob("feasigrasp_lab/**/*.py")):
        names = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                names |= {node.module, *(f"{node.module}.{a.name}" for a in node.names)}
            elif isinstance(node, ast.Import):
                names |= {a.name for a in node.names}
        paths = [root / name.replace(".", "/") for name in names if name.startswith("feasigrasp")]
        there = {f for p in paths for f in (p.with_suffix(".py"), p / "__init__.py") if f.is_file()}
        assert there <= set(_source(file, root, "feasigrasp")[1]), file
