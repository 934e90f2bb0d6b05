"""One command at a time works in a folder."""

import os
import subprocess
import sys
import time

from feasigrasp.outputs import LOCK, only_one_in

HOLD = """
import sys, time
from pathlib import Path
from feasigrasp.outputs import only_one_in
with only_one_in(Path(sys.argv[1])):
    print("in", flush=True)
    time.sleep(float(sys.argv[2]))
"""


def hold(folder, seconds):
    command = [sys.executable, "-c", HOLD, folder, str(seconds)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "in\n"
    return process


def test_a_second_command_waits_and_says_for_whom(tmp_path, capsys):
    first = hold(tmp_path, 1.0)
    started = time.monotonic()
    with only_one_in(tmp_path):
        assert time.monotonic() - started > 0.3
    assert f"another command (process {first.pid}) works in {tmp_path}" in capsys.readouterr().err
    first.wait()


def test_a_killed_command_leaves_no_lock(tmp_path, capsys):
    first = hold(tmp_path, 60.0)
    first.kill()
    first.wait()
    with only_one_in(tmp_path):
        assert (tmp_path / LOCK).read_text() == str(os.getpid())
    assert capsys.readouterr().err == ""
