"""What is written is whole, and outputs that cannot be written are refused before the work."""

import os
import runpy
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from feasigrasp import cli, outputs
from feasigrasp.errors import OutputError


def test_a_full_disk_leaves_the_old_file_and_no_part(tmp_path, full_disk):
    file = tmp_path / "full.json"
    with open(file, "wb") as old:
        old.write(b"old")
    with pytest.raises(OutputError, match="full.json cannot be written .No space left on device"):
        outputs.write_text(file, "new and longer")
    assert file.read_bytes() == b"old" and os.listdir(tmp_path) == ["full.json"]


def test_an_error_or_interruption_while_writing_leaves_the_old_file(tmp_path):
    file = tmp_path / "a.txt"
    outputs.write_text(file, "old")
    for error in (KeyboardInterrupt, ValueError):
        with pytest.raises(error), outputs.replacing(file) as target:
            target.write(b"half")
            raise error
    assert file.read_text() == "old" and os.listdir(tmp_path) == ["a.txt"]


def test_figures_take_the_format_of_their_suffix(tmp_path):
    figure = Figure()
    outputs.save_figure(figure, tmp_path / "deep" / "a.png")
    outputs.save_figure(figure, tmp_path / "a.pdf")
    assert (tmp_path / "deep" / "a.png").read_bytes()[1:4] == b"PNG"
    assert (tmp_path / "a.pdf").read_bytes()[:4] == b"%PDF"
    with pytest.raises(OutputError, match="a.xyz: end it in .png"):
        outputs.save_figure(figure, tmp_path / "a.xyz")


def test_outputs_are_tried_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    new = tmp_path / "new" / "a.json"
    outputs.check_outputs({"--results": new, "--replay": None})
    assert not new.parent.exists()  # nothing is made yet
    for options, message in (
        ({"--results": tmp_path}, "is a folder; give a file"),
        ({"--results": tmp_path / "file" / "a.json"}, "--results: nothing can be written"),
        ({"--results": Path("/proc/a/b.json")}, "--results: nothing can be written"),
        ({"--results": new, "--replay": new}, "--results and --replay are both"),
    ):
        with pytest.raises(OutputError, match=message):
            outputs.check_outputs(options)


def test_what_is_read_is_not_written_over(tmp_path):
    mesh = tmp_path / "rod.stl"
    mesh.write_text("solid")
    with pytest.raises(OutputError, match=r"--results would overwrite .*rod\.stl, which --object"):
        outputs.check_outputs({"--results": mesh}, {"--object": str(mesh), "--scenario-file": None})
    outputs.check_outputs({"--results": tmp_path / "new.json"}, {"--object": "new.json"})


@pytest.mark.parametrize("option", ["--results", "--replay", "--graphviz"])
def test_the_diagram_refuses_an_output_before_it_runs(
    option, tmp_path, repository, monkeypatch, capsys
):
    script = str(repository / "diagrams/dynamic_grasp.py")
    monkeypatch.setattr(sys, "argv", [script, option, str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(script, run_name="__main__")
    assert ended.value.code == 2
    told = f"error: {option} {tmp_path} is a folder; give a file in it"
    err = capsys.readouterr().err
    assert err.splitlines()[-1] == told and "Traceback" not in err


def test_commands_refuse_a_folder_that_cannot_be_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert cli.main(["evaluate", "dynamic", "--out", str(tmp_path / "file" / "out")]) == 2
    assert "--out: nothing can be written" in capsys.readouterr().err


def test_what_is_no_regular_file_is_written_into(tmp_path):
    """Devices and pipes stay what they are; of a link, the file that it names is replaced."""
    master, slave = os.openpty()  # where no file can be made: old code must not replace a device
    terminal = Path(os.ttyname(slave))
    outputs.check_outputs({"--html": terminal})
    outputs.write_text(terminal, "text")
    assert os.read(master, 4) == b"text" and terminal.is_char_device()

    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    outputs.check_outputs({"--html": pipe})
    outputs.write_text(pipe, "text")
    reader.join()
    assert read == ["text"] and pipe.is_fifo()

    (tmp_path / "there").mkdir()
    for name, target in (("link", tmp_path / "there" / "file"), ("dangling", tmp_path / "new")):
        if name == "link":
            target.write_text("old")
        link = tmp_path / name
        link.symlink_to(target)
        outputs.write_text(link, "text")
        assert link.is_symlink() and target.read_text() == "text"
    assert sorted(p.name for p in (tmp_path / "there").iterdir()) == ["file"]


def test_an_output_to_the_console_goes_through_whatever_it_is_redirected_to(tmp_path):
    script = "from feasigrasp.outputs import write_text; write_text('/proc/self/fd/1', 'text')"
    with (tmp_path / "file").open("wb") as file:
        subprocess.run([sys.executable, "-c", script], stdout=file, check=True)
    assert (tmp_path / "file").read_text() == "text"
