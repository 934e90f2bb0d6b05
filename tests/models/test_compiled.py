"""Compiled functions give the same bits whoever compiled them first, and whatever was loaded."""

import os
import pickle
import pkgutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
from numba.core.dispatcher import Dispatcher

import feasigrasp
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.vectors import cross, dot
from feasigrasp.warm_up.kernels import callees

#: What numba takes from a caller where a function does not say it.
INHERITED = {"fastmath", "error_model", "forceinline"}
#: In a process of its own: numba would let ``inner`` have the fastmath of ``loose``.
FIRST = """
import numpy as np
from numba import njit
from feasigrasp.models.compiled import compiled

def plain(x):
    big = 6755399441055744.0
    return (x + big) - big

inner = compiled(plain) if {ours} else njit(plain)

@njit(fastmath=True)
def loose(x):
    return inner(x)

@njit
def strict(x):
    return inner(x)

first, second = (loose, strict) if {loose_first} else (strict, loose)
first(0.25), second(0.25)
print(strict(0.25))
"""


def all_functions():
    """All compiled functions of the package."""
    found = {}
    for module in pkgutil.walk_packages(feasigrasp.__path__, "feasigrasp."):
        if not module.name.endswith("__main__"):
            for value in vars(import_module(module.name)).values():
                if isinstance(value, Dispatcher):
                    found[name(value)] = value
    return found


def name(function):
    return f"{function.py_func.__module__}.{function.py_func.__qualname__}"


def is_inlined(function):
    options = function.targetoptions
    return bool(options.get("forceinline")) or options.get("inline") == "always"


def is_fast_math(function):
    """Whether the compiler may choose its last bits, by itself or by what is inlined into it."""
    inlined = (f for f in callees(function.py_func) if is_inlined(f))
    return bool(function.targetoptions.get("fastmath")) or any(map(is_fast_math, inlined))


def shared_fast_math(functions):
    """Functions that are in several pieces of machine code, which may differ."""
    called = {name(f) for g in functions for f in callees(g.py_func)}
    return [
        name(f) for f in functions if name(f) in called and is_fast_math(f) and not is_inlined(f)
    ]


FUNCTIONS = all_functions()


def test_they_are_found():
    assert len(FUNCTIONS) > 200
    assert sum(map(is_fast_math, FUNCTIONS.values())) > 20


def test_nothing_is_left_to_the_caller():
    assert not [key for key, f in FUNCTIONS.items() if not set(f.targetoptions) >= INHERITED]


def test_what_is_relaxed_is_in_one_piece_of_machine_code():
    assert shared_fast_math(FUNCTIONS.values()) == []


@compiled(fastmath=True)
def _fast_math(x):
    return x + 1.0


@compiled(forceinline=True)
def _between(x):
    return 2.0 * _inlined(x)


@compiled(forceinline=True, fastmath=True)
def _inlined(x):
    return x + 1.0


@compiled
def _holder(x):
    return _between(x)


@compiled
def _caller(x):
    return _fast_math(x) + _holder(x)


def test_what_would_be_in_several_is_found():
    found = shared_fast_math([_caller, _fast_math, _between, _inlined, _holder])
    assert [text.rpartition(".")[2] for text in found] == ["_fast_math", "_holder"]


def printed(loose_first, *, ours):
    code = FIRST.format(ours=ours, loose_first=loose_first)
    code = code.replace("compiled(plain)", "compiled(plain, cache=False)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def test_the_first_caller_decides_nothing():
    """Rounding to whole numbers, which a compiler that may reorder sums takes for nothing."""
    assert printed(True, ours=False) == 0.25, "numba has mended it: `compiled` can go"
    assert printed(True, ours=True) == printed(False, ours=True) == 0.0


def test_division_by_zero_gives_infinity():
    @compiled(cache=False)
    def inverse(x):
        return 1.0 / x

    assert inverse(0.0) == np.inf


def test_products_of_vectors():
    a, b = np.random.default_rng(0).standard_normal((2, 3))
    np.testing.assert_allclose(dot(tuple(a), tuple(b)), a @ b, rtol=1e-14)
    np.testing.assert_allclose(cross(tuple(a), tuple(b)), np.cross(a, b), rtol=1e-13)


def test_the_exponential_survives_a_hasty_caller(tmp_path):
    """Compiled for the first time, into an empty cache, by a caller that may reorder sums."""
    code = """
import numpy as np
from numba import njit
from feasigrasp.models.numerics.fast_math import exp2_of_minus

@njit(fastmath=True)
def f(r, out):
    for i in range(len(r)):
        out[i] = exp2_of_minus(r[i])

r = np.linspace(0.0, 20.0, 1000)
out = np.empty_like(r)
f(r, out)
print(np.abs(out * 2.0**r - 1.0).max())
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert float(done.stdout) < 1e-13


def test_where_nothing_can_be_written_it_is_compiled_without_a_cache(tmp_path):
    """Files in the place of folders keep even root from writing there."""
    (tmp_path / "__pycache__").touch()
    (tmp_path / "cache").touch()
    script = tmp_path / "script.py"
    script.write_text(
        "from feasigrasp.models.compiled import compiled\n"
        "@compiled\ndef twice(x):\n    return 2.0 * x\n\nprint(twice(1.5))\n"
    )
    environment = os.environ | {
        "HOME": str(tmp_path / "cache"),
        "XDG_CACHE_HOME": str(tmp_path / "cache" / "user"),
        "PYTHONPATH": str(Path(feasigrasp.__file__).parents[1]),
    }
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, str(script)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("3.0\n", 0), done.stderr


#: The folder last: where it stands nothing can be written.
DAMAGES = (("nbi", "empty"), *(("nbc", how) for how in ("cut", "changed", "other", "folder")))


def test_damaged_cache_files_are_compiled_anew(tmp_path):
    """Emptied, cut off, with one bit changed, or with something else in them."""
    script = tmp_path / "script.py"
    script.write_text(
        "from feasigrasp.models.compiled import compiled\n"
        "@compiled\ndef twice(x):\n    return 2.0 * x\n\n"
        "print(twice(1.5), sum(twice.stats.cache_hits.values()))\n"
    )
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": str(Path(feasigrasp.__file__).parents[1]),
    }

    def run():
        command = [sys.executable, str(script)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    assert run() == ["3.0", "0"] and run() == ["3.0", "1"]
    for suffix, damage in DAMAGES:
        (file,) = (tmp_path / "cache").rglob(f"*.{suffix}")
        data = file.read_bytes()
        if damage == "folder":
            file.unlink()
            file.mkdir()
        else:
            middle = len(data) // 2
            changed = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
            contents = {"empty": b"", "cut": data[:middle], "changed": changed}
            file.write_bytes(contents.get(damage, pickle.dumps(0)))
        assert run() == ["3.0", "0"], damage
        if damage != "folder":
            assert run() == ["3.0", "1"], damage
