"""``feasigrasp doctor``: what is well is said to be, and what is not comes with its mend."""

import os
import sys
from importlib import metadata
from types import SimpleNamespace

import pytest

from feasigrasp import cli
from feasigrasp.commands import doctor
from feasigrasp.commands.doctor import Finding
from feasigrasp.models import weights_file
from feasigrasp.runs import replay


def found(look):
    (finding,) = look()
    return finding


def test_this_installation_is_well(capsys):
    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert out.endswith("all is well\n") and "problem " not in out
    for name in ("drake", "numba", "torch"):
        assert f"ok       {name} {metadata.version(name)}\n" in out
    for word in (
        "rendering",
        "threads",
        "compiled code",
        "hidden_side.npz",
        "manifold3d",
        "scenario: ",
    ):
        assert word in out


def test_a_problem_is_counted(monkeypatch, capsys):
    def breaks():
        yield Finding("ok", "first")
        raise ImportError("no such thing")

    fine = [lambda: iter([Finding("without", "an extra")])]
    monkeypatch.setattr(doctor, "LOOKS", (*fine, breaks, *fine))
    assert cli.main(["doctor"]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "without  an extra",
        "ok       first",
        "problem  breaks: no such thing",
        "without  an extra",
        "problems: 1",
    ]


def test_a_release_out_of_range_is_a_problem_and_a_part_left_out_is_none(monkeypatch):
    wanted = ["numpy>=99", "drake>=1.51,<1.52", "drake>=1.2", "torch>=2.2"]
    monkeypatch.setattr(doctor, "requires", lambda name: wanted)
    monkeypatch.setattr(doctor, "version", lambda name: "1.58.0")
    monkeypatch.setitem(sys.modules, "torch", None)  # import torch raises ModuleNotFoundError
    _, old, new, fine, left_out = doctor.libraries()
    assert old.health == new.health == "problem"
    assert new.text == "drake 1.58.0 is none of <1.52,>=1.51: pip install 'drake>=1.51,<1.52'"
    assert fine == Finding("ok", "drake 1.58.0")
    assert left_out.health == "without" and "pip install 'torch>=2.2', for" in left_out.text


def test_a_library_that_is_missing_or_broken_is_named(monkeypatch, tmp_path):
    (tmp_path / "brokenlib.py").write_text("raise OSError('libEGL.so.1: no such file')")
    monkeypatch.syspath_prepend(str(tmp_path))
    wanted = ["numpy>=1.26", "absentlib>=2", "brokenlib<3", "pytest; extra == 'dev'"]
    monkeypatch.setattr(doctor, "requires", lambda name: wanted)
    _, numpy, absent, broken = doctor.libraries()
    assert numpy == Finding("ok", f"numpy {metadata.version('numpy')}")
    assert absent.health == broken.health == "problem"
    assert "pip install 'absentlib>=2'" in absent.text
    assert "libEGL.so.1: no such file" in broken.text and "make setup" in broken.text


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("print('depth 0.9')", None),
        ("print('depth 3.0')", "sees a wall at 3.000 m"),
        ("import os; os.abort()", "rendering fails (status -6): install libegl1"),
        ("raise SystemExit('bad X server')", "rendering fails (bad X server)"),
    ],
)
def test_rendering_may_fail_in_any_way(program, says, monkeypatch):
    monkeypatch.setattr(doctor, "_RENDER", program)
    finding = found(doctor.rendering)
    assert finding.health == ("problem" if says else "ok")
    assert (says or "where it is") in finding.text


def test_rendering_really_measures_depth(monkeypatch):
    monkeypatch.setattr(doctor, "_RENDER", doctor._RENDER.replace("0.0, 1.0]", "0.0, 1.2]"))
    assert "at 1.100 m" in found(doctor.rendering).text


def kernels(monkeypatch, folder):
    stats = SimpleNamespace(stats=SimpleNamespace(cache_path=str(folder)))
    module = SimpleNamespace(inverse_kernel=stats)
    monkeypatch.setattr(doctor, "import_module", lambda name: module)


def test_compiled_code_is_weighed(monkeypatch, tmp_path):
    kernels(monkeypatch, tmp_path / "geometry")
    assert "0 MB" in found(doctor.compiled_code).text
    assert "first run compiles" in found(doctor.compiled_code).text
    for name in ("a.nbi", "b.nbc", "c.py"):
        (tmp_path / "geometry").mkdir(exist_ok=True)
        (tmp_path / "geometry" / name).write_bytes(bytes(1_500_000))
    assert found(doctor.compiled_code).text == f"compiled code: 3 MB in {tmp_path}"


def test_compiled_code_that_cannot_be_kept_is_a_problem(monkeypatch, tmp_path):
    kernels(monkeypatch, tmp_path / "geometry")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    finding = found(doctor.compiled_code)
    assert finding.health == "problem" and "NUMBA_CACHE_DIR" in finding.text


def test_a_file_that_is_cut_off_is_named(monkeypatch, tmp_path):
    whole = weights_file.WEIGHTS / "grasp_network.npz"
    (tmp_path / whole.name).write_bytes(whole.read_bytes()[:1000])
    monkeypatch.setattr(weights_file, "WEIGHTS", tmp_path)
    (finding,) = doctor.files()
    assert finding.health == "problem"
    assert "grasp_network.npz is no whole npz file" in finding.text and "git" in finding.text


def test_the_weights_are_all_that_come_with_the_package():
    assert {path.stem for path in weights_file.WEIGHTS.glob("*.npz")} == set(doctor._WEIGHTS)


def test_without_a_browser_there_are_no_pictures(monkeypatch):
    monkeypatch.setattr(replay, "BROWSERS", ("no-such-browser",))
    assert found(doctor.browser).health == "without"
    monkeypatch.setattr(replay, "BROWSERS", (sys.executable,))
    assert found(doctor.browser) == Finding(
        "ok", f"browser for pictures of replays: {sys.executable}"
    )


@pytest.mark.parametrize(
    ("before", "says"),
    [
        ("import pydrake.systems.analysis as a; del a.ApplySimulatorConfig", "cannot import name"),
        (
            "import feasigrasp.systems.dynamic_grasp as d\n"
            "def broken(*_): raise TypeError('no publish_every_time_step')\n"
            "d.make_camera = d.add_station = d.DiagramBuilder = broken",
            "no publish_every_time_step",
        ),
        ("import sys; print('broke off (solver)'); sys.exit(1)", "broke off (solver)"),
        ("import os; os.abort()", "status -6"),
    ],
)
def test_a_scenario_that_does_not_run_is_told_in_one_line_with_a_mend(before, says, monkeypatch):
    monkeypatch.setattr(doctor, "_RUN", before + doctor._RUN)
    finding = found(doctor.scenario)
    assert finding.health == "problem"
    assert says in finding.text and "\n" not in finding.text
    assert "pip install --force-reinstall 'drake" in finding.text
