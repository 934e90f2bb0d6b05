"""What is compiled ahead is what runs call; it is kept where it can be, and compiled once."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import feasigrasp
from feasigrasp import cli
from feasigrasp.commands import warm_up as command
from feasigrasp.warm_up.kernels import GROUPS, all_callees, load_kernels, parse_signature
from tools.make_kernels import RUNS, called_by

PACKAGE = Path(feasigrasp.__file__).parent
KERNELS = {
    "feasigrasp.models.robot.kinematics": {
        "pose_jacobian_kernel": {
            "(array(float64, 2, 'C', 'readonly'), array(float64, 1, 'C'), array(float64, 2, 'C'), "
            "array(float64, 2, 'C'), none, )": ["task"]
        }
    },
    "feasigrasp.models.geometry.se3_kernels": {
        "inverse_kernel": {"(array(float64, 2, 'C'), )": ["task"]},
        "no_such_kernel": {"(float64, )": ["task"]},
        "log_kernel": {"(array(float64, 2, 'C'), )": ["joint"]},
    },
}
SCRIPT = """
import sys
from pathlib import Path
from feasigrasp.warm_up import is_warm, kernels, warm_up
kernels.FILE = sys.modules["feasigrasp.warm_up.warm_up"].FILE = Path(sys.argv[1])
told = []
print(is_warm(["task"]))
print(warm_up(["task"], told.append))
print(is_warm(["task"]), is_warm(["joint"]))
print(told[-1])
"""


def in_a_process(*arguments, **environment):
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        env=os.environ | {name: str(value) for name, value in environment.items()},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()


@pytest.mark.parametrize(("run", "group"), [*zip(RUNS, GROUPS, strict=True)])
def test_runs_call_what_is_compiled_ahead(run, group):
    """If this fails: ``python tools/make_kernels.py``."""
    ahead = {(kernel.module, kernel.name, kernel.signature) for kernel in load_kernels([group])}
    called = set(map(tuple, called_by([*run.split(), "--controller", group, "--duration", "1"])))
    assert len(called) > 30
    assert not called - ahead


def test_every_kernel_is_there():
    kernels = load_kernels()
    assert len(kernels) > len(load_kernels(["task"])) > 50
    for kernel in kernels:
        assert parse_signature(kernel.signature)
        assert kernel.function().py_func.__name__ == kernel.name


def test_callees_are_found_through_several_calls():
    from feasigrasp.models.control.horizon.density import density_kernel

    names = {name.rpartition(".")[2] for name in all_callees(density_kernel)}
    assert {"density_kernel", "standoff_kernel", "_angle_between", "inverse_kernel"} <= names


def test_it_compiles_once_and_says_what_it_cannot(tmp_path):
    file, cache = tmp_path / "kernels.json", tmp_path / "cache"
    file.write_text(json.dumps(KERNELS))
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    here = {"NUMBA_CACHE_DIR": cache, "PYTHONPATH": PACKAGE.parent}
    before, failures, after, told = in_a_process(script, file, **here)
    assert (before, after) == ("False", "True False")
    assert re.fullmatch(r"compiled (\d+) of \1 functions, about 0 s left", told)
    assert "no_such_kernel" in failures and failures.count("Error") == 1
    compiled = {path.name: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    for name in ("pose_jacobian_kernel", "inverse_kernel"):
        assert any(name in file for file in compiled)
    assert in_a_process(script, file, **here)[0] == "True"
    assert compiled == {path.name: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    # Sources that have changed are another matter.
    file.write_text(json.dumps(KERNELS, indent=1))
    assert in_a_process(script, file, **here)[0] == "False"


def test_a_compiling_process_ends_in_silence_when_nobody_reads_its_answers():
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "feasigrasp.warm_up.worker"],
        input="feasigrasp.errors\tno_such_kernel\t()\n" * 3,
        stdout=writing,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(PACKAGE.parent)},
        text=True,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_package_that_cannot_be_written_to_is_compiled_into_the_users_cache(tmp_path):
    """Files in the place of ``__pycache__`` keep even root from writing there."""
    package = tmp_path / "site" / "feasigrasp"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__", "*.npz"))
    for folder in [package, *filter(Path.is_dir, package.rglob("*"))]:
        (folder / "__pycache__").touch()
    script = tmp_path / "show.py"
    script.write_text("from feasigrasp.warm_up.warm_up import cache_folder; print(cache_folder())")
    here = {"HOME": tmp_path, "XDG_CACHE_HOME": tmp_path / "user", "PYTHONPATH": package.parent}
    (folder,) = in_a_process(script, **here)
    assert Path(folder).is_relative_to(tmp_path / "user" / "numba")
    (folder,) = in_a_process(script, **here, NUMBA_CACHE_DIR=tmp_path / "own")
    assert Path(folder).is_relative_to(tmp_path / "own")


def test_a_run_compiles_first_only_if_it_must(monkeypatch, capsys):
    warmed = []
    monkeypatch.setattr("feasigrasp.commands.run.compile_in_advance", warmed.append)
    monkeypatch.setattr("feasigrasp.commands.run.run", lambda *a, **k: pytest.fail("as expected"))
    for warm, expected in ((True, []), (False, [{"joint"}])):
        monkeypatch.setattr("feasigrasp.commands.run.is_warm", lambda groups, warm=warm: warm)
        with pytest.raises(pytest.fail.Exception, match="as expected"):
            cli.main(["run", "ReachCircularMocap", "--controller", "joint"])
        assert warmed == expected


def test_the_command_says_what_failed(monkeypatch, capsys):
    monkeypatch.setattr(command, "is_warm", lambda groups: False)
    monkeypatch.setattr(command, "warm_up", lambda groups, report: ["a.b: TypingError: bad"])
    assert cli.main(["warm-up", "task"]) == 1
    assert "not compiled: a.b: TypingError: bad" in capsys.readouterr().err
    monkeypatch.setattr(command, "warm_up", lambda groups, report: [])
    assert cli.main(["warm-up"]) == 0
    monkeypatch.setattr(command, "is_warm", lambda groups: True)
    monkeypatch.setattr(command, "warm_up", lambda groups, report: pytest.fail("not again"))
    assert cli.main(["warm-up"]) == 0
    assert "is compiled" in capsys.readouterr().out
    assert cli.main(["warm-up", "tusk"]) == 2
    assert "no controller 'tusk'; give task or joint" in capsys.readouterr().err
